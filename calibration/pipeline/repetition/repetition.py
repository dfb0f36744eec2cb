"""One of several runs of the same work: how often it is done, and what is compared with the others."""

import hashlib
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from dataclasses import field as dataclass_field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

from calibration.base import ExitCode
from calibration.base.addons import of_addons
from calibration.base.arrays import Array
from calibration.base.records import between, field, one_of, record, value_of
from calibration.base.verdict import MAX_REPETITIONS, Verdict
from calibration.ci.report import FILES, Outcome, Report
from calibration.ci.report.report import BRIEF_FILE
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.diagnosis.limits import Limit
from calibration.engine.geometry.transforms import from_quaternion
from calibration.pipeline.matrix.cell_result import CellResult, Details
from calibration.pipeline.results import PAGE_FILE, Collected, PipelineResults
from calibration.robot.simulation.proof import Proof

_SPREAD_KEYS = ("rms-px", "translation-mm", "rotation-deg")


@record(rules=(one_of(*_SPREAD_KEYS, why=f"expected a limit: {', '.join(_SPREAD_KEYS)}"),))
class MaxSpread:
    """Largest standard deviations of results over repeated runs; None for no limit."""

    rms_px: Limit | None = field("Of every result in pixels, such as the RMS of a cell.", default=None, unit="px")
    translation_mm: Limit | None = field(
        "Of every calibrated transform, and of the errors against the truth.", default=None, unit="mm"
    )
    rotation_deg: Limit | None = field("Likewise.", default=None, unit="degrees")

    @property
    def limit_of_unit(self) -> Mapping[str, float]:
        """The limits that are set, by the unit of results: px, mm and deg."""
        limits = {"px": self.rms_px, "mm": self.translation_mm, "deg": self.rotation_deg}
        return {unit: limit for unit, limit in limits.items() if limit is not None}


@record
class Repetitions:
    """How often a run is repeated, and how much its repetitions may differ."""

    repeat: Annotated[int, between(1, MAX_REPETITIONS)] = field(
        "Number of runs, one after the other, each kept in run-1, run-2, ...; what does not always pass is flaky.",
        default=1,
        option="Number of runs, each kept in run-1, run-2, ... of output; what does not always pass is flaky (1).",
    )
    max_flake_rate: Annotated[float, between(0, 1)] | None = field(
        "Largest share of the repeated runs in which something may fail that passes in others (none).", default=None
    )
    max_spread: MaxSpread | None = field(
        "Largest standard deviations of results over the repeated runs.", default=None, option=False
    )


if TYPE_CHECKING:  # needs OpenCV, which a run that collects nothing does without
    from calibration.pipeline.collection.results import CollectionResults

Outputs: TypeAlias = Mapping[str, Mapping[str, str]]
"""Hashes of what each stage has left, by stage, in their order, and name."""
UNHASHED_FOLDERS = ("logs", "messages")
"""Folders of a collection that are no part of its dataset, and have times."""
_UNHASHED_FILES = (*FILES, BRIEF_FILE, PAGE_FILE)
_SHOWN_UNITS = {"m": (1e3, "mm"), "rad": (180 / math.pi, "deg")}
"""Factor and unit by which a parameter is shown, as limits are given."""


@dataclass(frozen=True, kw_only=True)
class Repetition:
    """One run, complete or cut short."""

    folder: Path
    verdict: Verdict = "fail"
    sentence: str = ""
    seconds: Mapping[str, float] = dataclass_field(default_factory=dict)
    """Duration of each stage."""
    whole_seconds: float = 0.0
    outcomes: tuple[Outcome, ...] = ()
    """Units of work, each of which passes or fails."""
    numbers: Mapping[tuple[str, str], float] = dataclass_field(default_factory=dict)
    """Results, by name and unit."""
    poses: Mapping[str, Array] = dataclass_field(default_factory=dict)
    """Calibrated transforms, 4x4, by cell and frames."""
    outputs: Outputs = dataclass_field(default_factory=dict)
    cut_short: str | None = None
    """Why it ended early; None if it is complete."""
    error: ExitCode | None = None
    """2 or 3 if it failed because of bad input or infrastructure."""


def outcomes_of_stages(results: PipelineResults) -> Iterator[Outcome]:
    """Yield the outcomes of what is no cell and no collection: the baseline, exports, and stages of add-ons."""
    if results.baseline is not None:
        yield Outcome(name="baseline", reasons=tuple(results.baseline.reasons))
    for each in results.exports:
        yield Outcome(name=f"exports of {each.system}", reasons=each.reasons)
    for section, found in vars(results.of_stages).items():
        if found is not None:
            yield Outcome(name=section, reasons=found.reasons)


def numbers_of_run(results: PipelineResults) -> dict[tuple[str, str], float]:
    """Return the RMS, errors and calibrated parameters of every cell and collection, by name and unit."""
    found: dict[tuple[str, str], float | None] = {}
    for cell in results.cells:
        found[f"{cell.name}: RMS", "px"] = cell.rms_px
        for what, each in (("error", cell.truth), ("error of the table", cell.poses)):
            found[f"{cell.name}: {what}", "mm"] = each.translation_mm if each else None
            found[f"{cell.name}: {what}", "deg"] = each.rotation_deg if each else None
        details = cell.details or Details()
        for parameter in (*details.joints, *details.intrinsics, *details.lags):
            scale, unit = _SHOWN_UNITS.get(parameter.unit, (1.0, parameter.unit))
            found[f"{cell.name}: {parameter.name} {parameter.parameter}", unit] = scale * parameter.value
    for collected in results.collections:
        found |= _numbers_of_dataset(collected.name, collected.corner_rms_px, collected)
    return {key: value for key, value in found.items() if value is not None}


def repetition_of_collection(results: "CollectionResults", report: Report, folder: Path, seconds: float) -> Repetition:
    """Return the run of a collection alone.

    Args:
        results: of the collection.
        report: of the collection.
        folder: folder of the dataset.
        seconds: its duration.
    """
    numbers = _numbers_of_dataset(results.system, results.corner_rms, results.proof)
    return Repetition(
        folder=folder,
        verdict=results.verdict,
        sentence=report.sentence,
        seconds={"collect": seconds},
        outcomes=(Outcome(name=results.system, reasons=tuple(results.reasons), error=results.error),),
        numbers={key: value for key, value in numbers.items() if value is not None},
        outputs={"collect": {results.system: _hash_of_dataset(folder) if results.kept else ""}},
        error=results.error,
    )


def _numbers_of_dataset(
    name: str, corner_rms_px: float | None, found: Collected | Proof | None
) -> dict[tuple[str, str], float | None]:
    return {
        (f"{name}: corner error", "px"): corner_rms_px,
        (f"{name}: RMS", "px"): found.rms_px if found else None,
        (f"{name}: error", "mm"): found.translation_mm if found else None,
        (f"{name}: error", "deg"): found.rotation_deg if found else None,
    }


def poses_of_run(results: PipelineResults, output: Path, given: Mapping[str, Dataset]) -> dict[str, Array]:
    """Return the calibrated transforms of every cell, by our engine or the team's software.

    Args:
        results: the results.
        output: folder of the run.
        given: the given datasets, by system.

    Raises:
        InputError: a dataset cannot be read.
    """
    return {
        f"{cell.name}: {name}": T
        for cell in results.cells
        for name, T in _poses_of_cell(cell, output, given.get(cell.system)).items()
    }


def _poses_of_cell(cell: CellResult, output: Path, given: Dataset | None) -> dict[str, Array]:
    if not cell.converged:
        return {}
    if cell.details is not None:
        transforms = cell.details.transforms
        return {f"{each.parent} to {each.child}": from_quaternion(each.trans, each.quat) for each in transforms}
    if cell.dataset is None:
        return {}
    dataset = read_dataset(output / cell.dataset, data=given.path.parent if given else None)
    edges = {sensor.edge for sensor in dataset.sensors.values()}
    return {" to ".join(edge): dataset.transforms[edge][0] for edge in sorted(edges)}


def outputs_of_run(results: PipelineResults, output: Path) -> Outputs:
    """Return the hashes of what each stage has left: the image, datasets, tables, verdicts, exports."""
    image = results.image
    of_stages = {
        name: getattr(results.of_stages, stage.section) for name, stage in of_addons(lambda addon: addon.stages).items()
    }
    return {
        "build": {} if image is None else {image.reference: image.digest or image.key},
        "collect": {
            each.name: _hash_of_dataset(output / each.dataset) if each.dataset else "" for each in results.collections
        },
        "calibrate": {cell.name: _hash_of_cell(cell, output) for cell in results.cells},
        "introspect": {cell.name: _hash_of(cell.verdict, cell.all_reasons) for cell in results.cells},
        "export": {
            each.system: _hash_of_files(output / each.folder / name for name in each.files) for each in results.exports
        },
        **{name: {name: _hash_of(value_of(found))} for name, found in of_stages.items() if found is not None},
    }


def _hash_of_dataset(folder: Path) -> str:
    """Return the hash of a collected dataset, with its images, without logs and reports."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    inside = (path for path in files if path.relative_to(folder).parts[0] not in (*UNHASHED_FOLDERS, *_UNHASHED_FILES))
    return _hash_of_files(inside)


def _hash_of_cell(cell: CellResult, output: Path) -> str:
    files = _hash_of_files(output / name for name in (cell.table, cell.dataset) if name is not None)
    return _hash_of(files, cell.rms_px, value_of(cell.details.transforms if cell.details else ()))


def _hash_of(*parts: object) -> str:
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def _hash_of_files(paths: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for path in paths:
        with path.open("rb") as file:
            digest.update(f"{path.name}:{hashlib.file_digest(file, 'sha256').hexdigest()};".encode())
    return digest.hexdigest()
