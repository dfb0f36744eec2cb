"""A bundle made of the results of a run: which systems are in it, its manifest, its files and its signature."""

import hashlib
import json
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

from calibration import __version__
from calibration.addons.delivery.attestation import (
    ATTESTATION_ENDING,
    MAX_KEY_BYTES,
    parse_signing_key,
    signed_envelope,
    statement_of,
    test_result,
)
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
    pack_files,
    unpack_files,
)
from calibration.addons.delivery.results import KEY_VARIABLE, BundleResults, DeliverySettings
from calibration.base import InputError, read_bytes, shorten, write_atomically
from calibration.base.arrays import Array
from calibration.base.documents import MAX_BYTES
from calibration.base.verdict import worst_verdict
from calibration.ci.git import Repository
from calibration.ci.report import remove_results
from calibration.engine.baseline.calibration_document import CalibrationDocument
from calibration.engine.baseline.comparison import compare
from calibration.engine.baseline.document import MAX_BASELINE_BYTES, Baseline, read_baseline
from calibration.engine.baseline.quality import BaselineSettings, SameData
from calibration.engine.baseline.verdict import exceeds
from calibration.engine.dataset.model import Dataset, Edge
from calibration.engine.geometry.rotations import to_quaternion
from calibration.pipeline.matrix.cell_result import CellResult
from calibration.pipeline.matrix.matrix import judge_results
from calibration.pipeline.results import PipelineResults, own_details
from calibration.pipeline.stages import calibrated_dataset, files_for_robot
from calibration.pipeline.system import Exports, System, chosen_systems
from calibration.robot.exports import calibrated

EPOCH_VARIABLE = "SOURCE_DATE_EPOCH"
MAX_DESCRIPTION_BYTES = 16 * 1024**2


@dataclass(frozen=True)
class Bundle:
    """A bundle."""

    manifest: Manifest
    content: bytes

    def with_version(self, version: str) -> "Bundle":
        """Return the bundle with another version."""
        manifest = replace(self.manifest, version=version)
        files = {**unpack_files(self.content), MANIFEST_FILE: manifest.text.encode()}
        return Bundle(manifest, pack_files(files))

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
    refusals: list[str] = []
    whole_run, baseline = list(_reasons_beside_cells(run.results)), read_baseline(run.baseline.file)
    for system in chosen_systems(run.systems, settings.systems):
        calibrated_system = _calibrated_system(system, run, baseline)
        marks = (*whole_run, *calibrated_system.marks(run.baseline.same_data))
        cell = calibrated_system.cell_to_bundle
        if cell is None or (marks and although is None):
            why = marks[0] if marks else "it keeps no calibrated dataset (datasets: none)"
            left_out.append(SystemLeftOut(system.name, shorten(why, 300)))
            advice = "; 'calibration bundle --although why' bundles and marks it" if cell else ""
            refusals.append(f"{system.name}: not bundled: {why}{advice}")
            continue
        dataset = calibrated_dataset(system, cell, run.output)
        exported, _ = files_for_robot(dataset, system.exports or Exports(), cell, run.output)
        files |= {f"{system.name}/{name}": content for name, content in exported.items()}
        bundled.append(_bundled_system(calibrated_system, dataset, marks))
    if left_out and (settings.systems or not bundled):
        raise InputError(refusals[0])
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


@dataclass(frozen=True)
class _CalibratedSystem:
    """A system, and what a run and the baseline have of it."""

    system: System
    cells: tuple[CellResult, ...]
    now: CalibrationDocument | None
    """Calibration of our engine on its data, which is what is accepted."""
    accepted: CalibrationDocument | None

    @property
    def cell_to_bundle(self) -> CellResult | None:
        """The first cell that passed, else the first that converged; None if none has a calibrated dataset."""
        cells = [cell for cell in self.cells if cell.converged and cell.dataset]
        return next((cell for cell in cells if cell.passes), cells[0] if cells else None)

    def marks(self, same_data: SameData) -> tuple[str, ...]:
        """Return why it is bundled only if asked for: it is red, undecided or not accepted."""
        if not self.cells:
            return ("it has no result: calibration run",)
        failed = next((cell for cell in self.cells if not cell.passes), None)
        if failed is not None:
            return (f"{failed.verdict}: {shorten((*failed.all_reasons, 'it has not converged')[0], 300)}",)
        if self.accepted is None:
            return ("it is not accepted: calibration accept",)
        if self.now is None:
            return ("it has no calibration that could be accepted",)
        found = compare(self.accepted, self.now)
        if not found.same_data:
            return ("it is of other data than the accepted calibration: calibration accept",)
        changed = [each.name for each in found.changes if each.kind in ("added", "removed") or exceeds(each, same_data)]
        return (f"{changed[0]} differs from the accepted calibration: calibration accept",) if changed else ()


def _calibrated_system(system: System, run: RunToBundle, baseline: Baseline | None) -> _CalibratedSystem:
    cells = tuple(cell for cell in run.results.cells if cell.system == system.name)
    references = [cell for cell in run.results.comparisons if cell.system == system.name and not cell.by_other_method]
    details = (cell.details or own_details(cell, run.output) for cell in (*cells, *references) if cell.converged)
    now = next((each.snapshot for each in details if each is not None and each.snapshot is not None), None)
    return _CalibratedSystem(system, cells, now, baseline.systems.get(system.name) if baseline else None)


def _bundled_system(of_run: _CalibratedSystem, dataset: Dataset, marks: tuple[str, ...]) -> BundledSystem:
    system, now, accepted, of = of_run.system, of_run.now, of_run.accepted, calibrated(dataset)
    description = system.exports.robot_description if system.exports else None
    content = read_bytes(description, MAX_DESCRIPTION_BYTES, "a robot description") if description else None
    return BundledSystem(
        name=system.name,
        verdict=worst_verdict(cell.verdict for cell in of_run.cells),
        reasons=tuple(dict.fromkeys(reason for cell in of_run.cells for reason in cell.all_reasons)),
        marks=marks,
        starts=tuple(JudgedStart(cell.name, cell.verdict) for cell in of_run.cells),
        labels=now.data if now else None,
        inputs=now.inputs if now else {},
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
                K=tuple(camera.K.ravel().tolist()),
                D=tuple(camera.distortion.coefficients.tolist()),
            )
            for name, camera in of.cameras.items()
        ),
    )


def _bundled_transform(edge: Edge, T: Array, *, joint: bool) -> BundledTransform:
    trans, quat = (tuple((values + 0.0).tolist()) for values in (T[:3, 3], to_quaternion(T[:3, :3])))  # no -0
    return BundledTransform(parent=edge[0], child=edge[1], trans=trans, quat=quat, joint=joint)


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


BUNDLE_FOLDER = "bundle"
"""In the output folder of a run."""
PREDICATE_ENDING = ".predicate.json"
"""After the name of a bundle: its test results, for a tool that makes and signs the statement itself."""


def write_bundle(
    bundle: Bundle, output: Path, key_file: Path | None, environment: Mapping[str, str] = os.environ
) -> BundleResults:
    """Write a bundle, its predicate, and its attestation if there is a key; an older attestation is removed.

    Args:
        bundle: the bundle.
        output: output folder of a run, whose folder `BUNDLE_FOLDER` gets the files.
        key_file: file with the private key; None for that of `KEY_VARIABLE`, if it is set.
        environment: variables.

    Raises:
        InputError: the key is none.
        InfrastructureError: a file cannot be written, or cryptography is not installed.
    """
    text, where = environment.get(KEY_VARIABLE, ""), KEY_VARIABLE
    if key_file is not None:
        where, text = str(key_file), read_bytes(key_file, MAX_KEY_BYTES, "a private key").decode("utf-8", "replace")
    key = parse_signing_key(text, where) if text.strip() or key_file is not None else None
    manifest = bundle.manifest
    name = f"{BUNDLE_FOLDER}/{manifest.file_name}"
    attestation, predicate = name + ATTESTATION_ENDING, name + PREDICATE_ENDING
    remove_results(output, [name, attestation, predicate])
    write_atomically(output / name, bundle.content)
    write_atomically(output / predicate, json.dumps(test_result(manifest), indent=1) + "\n")
    if key is not None:
        envelope = signed_envelope(statement_of(bundle.content, manifest.file_name, manifest), key)
        write_atomically(output / attestation, envelope)
    return BundleResults(
        name=manifest.name,
        version=manifest.version,
        file=name,
        digest=f"sha256:{bundle.digest}",
        attestation=attestation if key else None,
        predicate=predicate,
        systems=tuple(system.name for system in manifest.systems),
        left_out=manifest.left_out,
        marks=manifest.marks,
        uncommitted=manifest.uncommitted,
    )
