"""Generate a first ``calibration.yml`` for a dataset, with a table and limits that suit its calibration."""

import json
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations, product
from pathlib import Path
from typing import Any

import yaml

from calibration.dataset.model import Dataset
from calibration.dataset.reading import read_dataset
from calibration.diagnosis.limits import SMALLEST, Limits
from calibration.diagnosis.projection import projection_limit
from calibration.errors import InputError
from calibration.estimation.chosen_lenses import with_chosen_lenses
from calibration.estimation.lens_choice import LensChoice
from calibration.estimation.options import Options
from calibration.estimation.starting_noise import StartingNoise
from calibration.evaluation.measured_poses import COLUMNS
from calibration.importing.document import ROUGH
from calibration.pipeline.matrix.cell import Cell
from calibration.pipeline.matrix.cell_result import CellResult
from calibration.pipeline.matrix.matrix import load
from calibration.pipeline.matrix.running_cell import run_cell
from calibration.pipeline.system import System
from calibration.temporary_folder import temporary_folder

SHARED = 3
"""Minimum of collections in which two sensors see a pattern, for a table of both."""
ROOM = 1.5
"""Limit of the RMS, in multiples of the current one."""
LEAST_RMS = 0.5
"""Lower bound of that limit, px: corners of a good camera in bad light."""
LEAST_POSE = 1e-3
"""Lower bound of the limit for measured poses, mm and deg: the resolution of their decimals."""
SIGMAS = 4.0
"""Limits in reported standard deviations: those of a later recording may be twice as large, and the guard band of two
still holds. Between halves of recordings of an arm they differ by up to a factor of two.
"""
STEPS = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
"""Mantissas of rounded limits."""
HEAD = """\
# Written by `calibration init`: the checks of this recording, and of later ones in its place.
# Change the limits to what your robot needs; `calibration run` checks them.
"""
_PLAIN = re.compile(r"[A-Za-z_./][\w./:-]*")


@dataclass(frozen=True, eq=False)
class FirstConfiguration:
    """First configuration of a dataset."""

    name: str
    text: str
    """Content of calibration.yml."""
    reasons: tuple[str, ...]
    """Reasons why the dataset fails; empty if it passes."""
    missing: tuple[str, ...] = ()
    """Omitted data, because the files are missing."""


def first_configuration(path: Path, root: Path) -> FirstConfiguration:
    """Calibrate a dataset, and generate its configuration.

    Args:
        path: the dataset's folder, in ``root``.
        root: the folder of calibration.yml.

    Raises:
        InputError: the dataset is wrong, outside of ``root``, or cannot be calibrated.
    """
    if not path.resolve().is_relative_to(root.resolve()):
        raise InputError(f"{path}: expected a dataset in the folder of calibration.yml, {root}, which is checked out")
    dataset = read_dataset(path)
    evaluate, why = _table(dataset)
    options = _options(dataset)
    lenses = with_chosen_lenses(dataset, options).choices
    options = replace(options, lens={name: each.chosen.name for name, each in lenses.items()})
    system = System(dataset.name, path, evaluate=evaluate, options=options)
    first = _calibrated(system)
    if first.error is not None or not first.converged:
        why = "; ".join(first.reasons) or "no optimum was found"
        raise InputError(f"{path}: cannot be calibrated: {why}{_other_mounting(dataset)}")
    limits, comments = _limits(first) if first.sigma else _limits_of_cameras(dataset)
    judged = _calibrated(replace(system, limits=limits))
    lines = [
        f"  {_scalar(system.name)}:",
        _line("dataset", path.resolve().relative_to(root.resolve()).as_posix(), _seen(dataset)),
        *_option_lines(system.options, lenses),
        *([_line("evaluate", evaluate, why)] if evaluate else []),
        *_rule_lines(evaluate, first),
        "    limits:",
        *(f"      {key}: {value:g}   # {comments[key]}" for key, value in _set(limits).items()),
    ]
    missing = tuple(map(dataset.missing_files_of, dataset.missing_files))
    reasons = (*judged.reasons, *judged.undecided)
    return FirstConfiguration(system.name, f"{HEAD}\nsystems:\n" + "\n".join(lines) + "\n", reasons, missing)


def _other_mounting(dataset: Dataset) -> str:
    """Return the question whether sensor and pattern are exchanged, where one of them is on an arm; else nothing."""
    if len(dataset.sensors) > 1 or not all(pattern.fixed for pattern in dataset.patterns.values()):
        return ""
    (sensor,), (pattern, *_) = dataset.sensors, dataset.patterns
    return f"; or are '{sensor}' and '{pattern}' mounted the other way round ('parent' in import.yml)?"


def _options(dataset: Dataset) -> Options:
    """Return the options for what an imported dataset says of itself: rough poses, cameras without intrinsics.

    Of one camera before a pattern that moves freely nothing but its intrinsics can be calibrated.
    """
    metadata = dataset.document["_metadata"]
    cameras = dataset.guessed_cameras
    if len(dataset.sensors) == 1 and not any(pattern.fixed for pattern in dataset.patterns.values()):
        cameras = tuple(name for name, sensor in dataset.sensors.items() if sensor.modality.has_corners)
    return Options(description="rough" if metadata.get(ROUGH) is True else "trusted", intrinsics=cameras)


def _option_lines(options: Options, lenses: Mapping[str, LensChoice]) -> Iterator[str]:
    if options.description == "rough":
        yield _line("description", "rough", "the sensors' true poses are unknown: there is no comparison with a truth")
    if options.intrinsics:
        why = "of these none were given: they are calibrated with the rest"
        if not options.lens:
            why = "nothing else can be calibrated of one camera before a pattern that moves freely"
        yield _line("intrinsics", list(options.intrinsics), why)
    if options.lens:
        yield "    lens:"
        for name, model in options.lens.items():
            yield f"  {_line(name, model, lenses[name].reason)}"


def _rule_lines(evaluate: str | None, result: CellResult) -> Iterator[str]:
    """Yield the rules over a table, with some room above the averages of this recording."""
    if evaluate and result.rms_px is not None and "-to-rgb:" in evaluate:
        most = nice(max(ROOM * result.rms_px, LEAST_RMS))
        why = f"{result.rms_px:.3g} px in this recording, times {ROOM:g}; {_least(LEAST_RMS, 'px')}"
        yield "    rules:"
        yield f"      - {{column: RMS (pix), row: Averages, max: {most:g}}}   # {why}"
    if result.poses is not None:
        yield "    rules:"
        for column, value in zip(COLUMNS, (result.poses.translation_mm, result.poses.rotation_deg), strict=True):
            rule = f"- {{column: {column}, row: Averages, max: {nice(max(ROOM * value, LEAST_POSE)):g}}}"
            yield f"      {rule}   # {value:.3g} in this recording, times {ROOM:g}"


def nice(number: float) -> float:
    """Return the next larger round number."""
    power = 10.0 ** math.floor(math.log10(number))
    return float(f"{next(step for step in STEPS if step * power >= number * (1 - 1e-9)) * power:.6g}")


def _calibrated(system: System) -> CellResult:
    with temporary_folder() as folder:
        return run_cell(Cell(system.name, StartingNoise()), load(system), folder)


def _table(dataset: Dataset) -> tuple[str | None, str]:
    """Return the table that covers most of the dataset, a description; None if no sensors see a pattern together."""
    kinds = {name: sensor.modality.family for name, sensor in dataset.sensors.items()}
    cameras = [name for name, kind in kinds.items() if kind == "camera"]
    pairs_of = {
        "rgb": combinations(cameras, 2),
        "lidar": product((name for name, kind in kinds.items() if kind == "lidar"), cameras),
        "depth": product((name for name, kind in kinds.items() if kind == "depth camera"), cameras),
    }
    seen = {name: _collections_of(dataset, name) for name in dataset.sensors}
    for word, pairs in pairs_of.items():
        shared = {pair: len(seen[pair[0]] & seen[pair[1]]) for pair in pairs}
        one, other = best = max(shared, key=shared.__getitem__, default=("", ""))
        if shared.get(best, 0) >= SHARED:
            what = f"the corners that {one} sees, in" if word == "rgb" else f"the points of {one} against"
            return f"{word}-to-rgb:{one}:{other}", f"{what} the images of {other}; {shared[best]} collections have both"
    if len(cameras) == 1 and any(pattern.fixed for pattern in dataset.patterns.values()):
        only = cameras[0]
        return f"inter-collection-rgb-to-rgb:{only}:{only}", "each view of the pattern carried to all others by the arm"
    if trackers := [name for name, kind in kinds.items() if kind == "tracker"]:
        return f"measured-poses:{trackers[0]}", "the poses as they were measured, against those of the result"
    return None, ""


def _collections_of(dataset: Dataset, sensor: str) -> set[int]:
    """Return the collections in which a sensor sees a pattern."""
    return {i for i, each in enumerate(dataset.collections) if any(name == sensor for _, name in each.labels)}


def _seen(dataset: Dataset) -> str:
    counts = [f"{name} sees it in {len(_collections_of(dataset, name))}" for name in dataset.sensors]
    return f"{len(dataset.collections)} collections; {', '.join(counts)}"


def _limits(result: CellResult) -> tuple[Limits, dict[str, str]]:
    """Derive limits from the reported standard deviations, with the reason of each."""
    sigma = result.sigma
    if sigma is None:
        raise AssertionError("a calibration states its standard deviations")
    stated = {
        "translation-mm": (sigma.translation_mm, SMALLEST[0], "mm"),
        "rotation-deg": (sigma.rotation_deg, SMALLEST[1], "deg"),
        "joint-mm": (sigma.joint_mm, SMALLEST[0], "mm"),
        "joint-deg": (sigma.joint_deg, SMALLEST[1], "deg"),
    }
    values, comments = {}, {}
    for key, (one, least, unit) in stated.items():
        if one is None:
            continue
        values[key.replace("-", "_")] = nice(max(SIGMAS * one, least))
        comments[key] = f"{SIGMAS:g} x {one:.2g} {unit}, this recording's standard deviation; {_least(least, unit)}"
    return Limits(**values), comments


def _limits_of_cameras(dataset: Dataset) -> tuple[Limits, dict[str, str]]:
    """Return the limit of cameras alone, which does not depend on the recording, with its reason."""
    most = min(projection_limit(each.camera, Limits()) for each in dataset.sensors.values() if each.camera)
    why = (
        "at the pattern's distance; 0.4 % of the image's longer side: a focal length that is 0.8 % off moves its "
        "border so"
    )
    return Limits(projection_px=nice(most)), {"projection-px": why}


def _least(number: float, unit: str) -> str:
    return f"no less than {number:g} {unit}"


def _set(limits: Limits) -> Mapping[str, float]:
    keys = ("translation-mm", "rotation-deg", "joint-mm", "joint-deg", "projection-px")
    found = {key: getattr(limits, key.replace("-", "_")) for key in keys}
    return {key: value for key, value in found.items() if value is not None}


def _line(key: str, value: Any, why: str) -> str:
    shown = f"[{', '.join(map(_scalar, value))}]" if isinstance(value, list) else _scalar(value)
    printable = "".join(c if c.isprintable() else "?" for c in why)
    return f"    {_scalar(key)}: {shown}   # {printable}"


def _scalar(text: str) -> str:
    """Format a text as a YAML scalar on one line, quoted if necessary."""
    plain = _PLAIN.fullmatch(text) is not None and not text.endswith(":") and yaml.safe_load(text) == text
    return text if plain else json.dumps(text)
