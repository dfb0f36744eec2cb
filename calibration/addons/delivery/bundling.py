"""A bundle made of the results of a run: which systems are in it, its manifest and its files."""

import hashlib
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

from calibration import __version__
from calibration.addons.delivery.archive import pack_files
from calibration.addons.delivery.manifest import (
    MANIFEST_FILE,
    MANIFEST_VERSION,
    BundledCamera,
    BundledFile,
    BundledSystem,
    BundledTransform,
    JudgedStart,
    Manifest,
    SystemLeftOut,
)
from calibration.addons.delivery.settings import DeliverySettings
from calibration.base.arrays import Array
from calibration.base.documents import MAX_BYTES
from calibration.base.errors import InputError
from calibration.base.files import read_bytes
from calibration.base.text import shorten
from calibration.base.verdict import worst_verdict
from calibration.ci.git import Repository
from calibration.engine.baseline.calibration_document import CalibrationDocument
from calibration.engine.baseline.comparison import compare
from calibration.engine.baseline.document import MAX_BASELINE_BYTES, read_baseline
from calibration.engine.baseline.quality import BaselineSettings
from calibration.engine.baseline.verdict import exceeds
from calibration.engine.dataset.model import Dataset
from calibration.engine.geometry.rotations import to_quaternion
from calibration.pipeline.matrix.cell_result import CellResult
from calibration.pipeline.matrix.cell_verdict import judge_results
from calibration.pipeline.results import PipelineResults, own_details
from calibration.pipeline.stages.exporting import calibrated_dataset, files_for_robot
from calibration.pipeline.system import Exports, System, chosen_systems
from calibration.robot.exports.calibrated import calibrated

EPOCH_VARIABLE = "SOURCE_DATE_EPOCH"
MAX_DESCRIPTION_BYTES = 16 * 1024**2


@dataclass(frozen=True)
class Bundle:
    """A bundle."""

    manifest: Manifest
    content: bytes

    @property
    def file_name(self) -> str:
        """Name of its file."""
        return f"{self.manifest.name}.calibration.tar"

    @cached_property
    def digest(self) -> str:
        """SHA-256 of its content."""
        return hashlib.sha256(self.content).hexdigest()


@dataclass(frozen=True)
class RunToBundle:
    """Results of a run, and what it was configured with."""

    results: PipelineResults
    systems: tuple[System, ...]
    output: Path
    config: Path
    baseline: BaselineSettings


def make_bundle(
    run: RunToBundle, settings: DeliverySettings, although: str | None, environment: Mapping[str, str] = os.environ
) -> Bundle:
    """Return the bundle of a run.

    Args:
        run: the run.
        settings: name, version, serial number, and which systems.
        although: reason for bundling systems that are red, undecided or not accepted, which are marked; else they are
            left out, or refused if ``settings.systems`` names them.
        environment: variables.

    Raises:
        InputError: no system can be bundled, or none knows when it was made.
        InfrastructureError: git fails.
    """
    run = replace(run, results=judge_results(run.results, run.systems, run.output))
    files: dict[str, bytes] = {}
    bundled: list[BundledSystem] = []
    left_out: list[SystemLeftOut] = []
    whole_run = _reasons_beside_cells(run.results)
    for system in chosen_systems(run.systems, settings.systems):
        marks = [*whole_run, *_marks(system, run)]
        cell = _cell_to_bundle(system, run.results)
        if cell is None or (marks and although is None):
            left_out.append(SystemLeftOut(system.name, shorten(marks[0], 300)))
            continue
        dataset = calibrated_dataset(system, cell, run.output)
        exported, _ = files_for_robot(dataset, system.exports or Exports(), cell, run.output)
        files |= {f"{system.name}/{name}": content for name, content in exported.items()}
        bundled.append(_bundled_system(system, run, dataset, tuple(marks)))
    if left_out and (settings.systems or not bundled):
        name, why = left_out[0].name, left_out[0].why
        raise InputError(f"{name}: not bundled: {why}; 'calibration bundle --although why' bundles and marks it")
    if not bundled:
        raise InputError(f"{run.config}: found no system, expected one to bundle")
    origin = _origin(run, environment)
    manifest = Manifest(
        bundle=MANIFEST_VERSION,
        made=origin.made,
        version=settings.version or time.strftime("%Y%m%d.%H%M%S", time.gmtime(origin.made)),
        commit=origin.commit,
        uncommitted=origin.uncommitted,
        name=settings.name or (bundled[0].name if len(bundled) == 1 else "robot"),
        serial=settings.serial,
        engine=__version__,
        configuration=_sha256(read_bytes(run.config, MAX_BYTES, "a pipeline configuration")),
        although=although if any(system.marks for system in bundled) else None,
        systems=tuple(bundled),
        left_out=tuple(left_out),
        files=tuple(BundledFile(path, len(files[path]), _sha256(files[path])) for path in sorted(files)),
    )
    return Bundle(manifest, pack_files({**files, MANIFEST_FILE: manifest.text.encode()}))


def _reasons_beside_cells(results: PipelineResults) -> Iterator[str]:
    """Yield why a run is red beside its cells: its tests, its requirements, its baseline, its exports."""
    reasons = [*(results.baseline.reasons if results.baseline else ())]
    reasons += [reason for each in results.exports for reason in each.reasons]
    reasons += [reason for stage in results.of_stages.all for reason in stage.reasons]
    reasons += [f"{each.name}: {reason}" for each in results.collections for reason in each.reasons]
    yield from (f"the run is red: {reason}" for reason in reasons)


def _marks(system: System, run: RunToBundle) -> Iterator[str]:
    """Yield why a system is bundled only if asked for."""
    cells = [cell for cell in run.results.cells if cell.system == system.name]
    if not cells:
        yield f"there is no result of it in {run.output}: calibration run"
    for cell in cells:
        if not cell.passes:
            yield f"{cell.verdict}: {shorten((*cell.all_reasons, 'it has not converged')[0], 300)}"
            return
    if cells:
        yield from _why_not_accepted(system, run)


def _why_not_accepted(system: System, run: RunToBundle) -> Iterator[str]:
    accepted = _accepted(system, run)
    now = _snapshot(system, run)
    if accepted is None:
        yield "it is not accepted: calibration accept"
    elif now is None:
        yield "it has no calibration that could be accepted"
    else:
        found = compare(accepted, now)
        changed = [each for each in found.changes if each.kind in ("added", "removed")]
        changed += [each for each in found.changes if exceeds(each, run.baseline.same_data)]
        if not found.same_data:
            yield "it is of other data than the accepted calibration: calibration accept"
        elif changed:
            yield f"{changed[0].name} differs from the accepted calibration: calibration accept"


def _accepted(system: System, run: RunToBundle) -> CalibrationDocument | None:
    baseline = read_baseline(run.baseline.file)
    return baseline.systems.get(system.name) if baseline else None


def _snapshot(system: System, run: RunToBundle) -> CalibrationDocument | None:
    """Return the calibration of our engine on a system's data, which is what is accepted."""
    references = [cell for cell in run.results.comparisons if not cell.by_other_method]
    for cell in (*run.results.cells, *references):
        if cell.system == system.name and cell.converged:
            details = cell.details or own_details(cell, run.output)
            if details is not None and details.snapshot is not None:
                return details.snapshot
    return None


def _cell_to_bundle(system: System, results: PipelineResults) -> CellResult | None:
    """Return the cell whose calibration is bundled: the first that passed, else the first that converged."""
    cells = [cell for cell in results.cells if cell.system == system.name and cell.converged and cell.dataset]
    return next((cell for cell in cells if cell.passes), cells[0] if cells else None)


def _bundled_system(system: System, run: RunToBundle, dataset: Dataset, marks: tuple[str, ...]) -> BundledSystem:
    cells = [cell for cell in run.results.cells if cell.system == system.name]
    snapshot, accepted, of = _snapshot(system, run), _accepted(system, run), calibrated(dataset)
    description = system.exports.robot_description if system.exports else None
    content = read_bytes(description, MAX_DESCRIPTION_BYTES, "a robot description") if description else None
    return BundledSystem(
        name=system.name,
        verdict=worst_verdict(cell.verdict for cell in cells),
        reasons=tuple(dict.fromkeys(reason for cell in cells for reason in cell.all_reasons)),
        marks=marks,
        starts=tuple(JudgedStart(cell.name, cell.verdict) for cell in cells),
        labels=snapshot.data if snapshot else None,
        inputs=snapshot.inputs if snapshot else {},
        description=None if content is None else _sha256(content),
        accepted_although=accepted.although if accepted else None,
        transforms=(
            *(_bundled_transform(edge, T, joint=False) for edge, T in of.transforms.items()),
            *(_bundled_transform(edge, T, joint=True) for edge, T in of.joints.items()),
        ),
        cameras=tuple(
            BundledCamera(
                name=name,
                frame=of.frames[name],
                width=camera.width,
                height=camera.height,
                distortion_model=camera.distortion.ros_name,
                K=tuple(float(value) for value in camera.K.ravel()),
                D=tuple(float(value) for value in camera.distortion.coefficients),
            )
            for name, camera in of.cameras.items()
        ),
    )


def _bundled_transform(edge: Sequence[str], T: Array, *, joint: bool) -> BundledTransform:
    parent, child = edge
    quat = tuple(float(value) + 0.0 for value in to_quaternion(T[:3, :3]))
    return BundledTransform(
        parent=parent, child=child, trans=tuple(float(v) + 0.0 for v in T[:3, 3]), quat=quat, joint=joint
    )


class _Origin(NamedTuple):
    """Where a bundle comes from, as its manifest says."""

    made: int
    commit: str | None
    uncommitted: bool


def _origin(run: RunToBundle, environment: Mapping[str, str]) -> _Origin:
    commit = run.results.commit.hash if run.results.commit else None
    made, uncommitted = None, False
    if commit is not None:
        try:
            repository = Repository.around(run.config.resolve().parent)
            made = repository.commit_time(commit)
            uncommitted = made is None or _is_uncommitted(repository, commit, run.baseline.file)
        except InputError:  # the folder of the configuration has left its repository
            made = None
    if epoch := environment.get(EPOCH_VARIABLE):
        if not (epoch.isascii() and epoch.isdigit() and len(epoch) < 12):
            raise InputError(f"{EPOCH_VARIABLE}: found {shorten(epoch)!r}, expected seconds since 1970")
        made = int(epoch)
    if made is None:
        raise InputError(
            f"{run.config}: found no commit and no {EPOCH_VARIABLE}, expected one: a bundle says when it was made"
        )
    return _Origin(made, commit, uncommitted)


def _is_uncommitted(repository: Repository, commit: str, baseline: Path) -> bool:
    """Return whether files differ from the tested commit, or the accepted calibrations from any commit.

    These are accepted after the test, hence in a later commit.
    """
    path = repository.path(baseline) if baseline.is_file() else None
    if path is None:
        return bool(repository.changed(commit))
    accepted = repository.content("HEAD", path, MAX_BASELINE_BYTES)
    return accepted != baseline.read_bytes() or bool(set(repository.changed(commit)) - {path})


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def with_collected(systems: Sequence[System], collected_folder: Path) -> tuple[System, ...]:
    """Return the systems with the paths of datasets that a run has collected."""
    return tuple(
        system if system.collected is None else replace(system, dataset=collected_folder / system.collected)
        for system in systems
    )
