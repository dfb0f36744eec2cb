"""Generate a first ``calibration.yml`` for a dataset, with a table and the limits of a good robot of its kind."""

import json
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations, product
from pathlib import Path
from typing import Any

import yaml

from calibration.base import InputError
from calibration.engine.dataset.model import ROUGH_KEY, Dataset
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.diagnosis.limits import DEFAULT_LIMIT_SIGMAS, MIN_DEFAULT_LIMIT, Limits, allowed, stated
from calibration.engine.diagnosis.projection import projection_limit
from calibration.engine.estimation.covariance.error_bars import MAX_NOISE
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.options import Options
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.engine.estimation.start.lens_choice import LensChoice, with_chosen_lenses
from calibration.engine.estimation.start.single_views import noise_inside_views
from calibration.engine.evaluation.specification import TABLE_KINDS, Suggestion
from calibration.pipeline.matrix.cell_result import Cell, CellResult
from calibration.pipeline.matrix.loaded_system import load
from calibration.pipeline.matrix.running_cell import calibrate_cell
from calibration.pipeline.system import System

MIN_SHARED_COLLECTIONS = 3
"""Minimum of collections in which two sensors see a pattern, for a table of both."""
OF_GUARD_BAND = 2 / 3
"""Share of a default limit that a cause may move a sensor by: two of the three standard deviations of a good robot."""
UNITS_OF_LIMITS = ("mm", "deg")
ROUND_MANTISSAS = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
"""Mantissas of rounded limits."""
HEAD_COMMENT = """\
# Written by `calibration init`: the checks of this recording, and of later ones in its place.
# Change the limits to what your robot needs; `calibration run` checks them.
"""
ALTHOUGH_COMMENT = "# This recording does not pass, and was to be written although it does not:"
_PLAIN_SCALAR = re.compile(r"[A-Za-z_./][\w./:-]*")


@dataclass(frozen=True, eq=False)
class FirstConfiguration:
    """First configuration of a dataset."""

    name: str
    text: str
    """Content of calibration.yml."""
    reasons: tuple[str, ...]
    """Reasons why the recording is no base of a configuration; empty if it passes."""
    undecided: tuple[str, ...] = ()
    """Limits that it cannot decide."""
    found: tuple[str, ...] = ()
    """All else that was found: causes, warnings, notes."""
    missing: tuple[str, ...] = ()
    """Omitted data, because the files are missing."""


def first_configuration(path: Path, root: Path) -> FirstConfiguration:
    """Calibrate a dataset, judge it without limits, and generate its configuration.

    Its limits are what a good robot of this kind could be told with: what is wrong with this recording does not widen
    them.

    Args:
        path: the dataset's folder, in ``root``.
        root: the folder of calibration.yml.

    Raises:
        InputError: the dataset is wrong, outside of ``root``, or cannot be calibrated.
    """
    if not path.resolve().is_relative_to(root.resolve()):
        raise InputError(f"{path}: expected a dataset in the folder of calibration.yml, {root}, which is checked out")
    dataset = read_dataset(path)
    evaluate, why = _choose_table(dataset)
    options = _options_for(dataset)
    lenses = with_chosen_lenses(dataset, options).choices
    options = replace(options, lens={name: each.chosen.name for name, each in lenses.items()})
    system = System(dataset.name, path, evaluate=evaluate, options=options)
    first, calibration = _calibrate_system(system)
    named = any(each.kind == "convention" for each in first.findings)
    if calibration is None or first.error is not None or not first.converged:
        why = "; ".join(first.reasons) or "no optimum was found"
        raise InputError(f"{path}: cannot be calibrated: {why}{'' if named else _other_mounting(dataset)}")
    limits, comments = _default_limits(calibration) if first.sigma else _limits_of_cameras(dataset)
    judged, _ = _calibrate_system(replace(system, limits=limits))
    found_here = (
        () if named else (*_reasons_of_noisy_corners(calibration), *_causes_that_move_sensors(calibration, first))
    )
    reasons = (*first.reasons, *found_here) or judged.reasons
    lines = [
        *(_printable_text(f"{ALTHOUGH_COMMENT} {each}") for each in reasons),
        "",
        "systems:",
        f"  {_yaml_scalar(system.name)}:",
        _yaml_line("dataset", path.resolve().relative_to(root.resolve()).as_posix(), _seen_collections(dataset)),
        *_option_lines(system.options, lenses),
        *([_yaml_line("evaluate", evaluate, why)] if evaluate else []),
        "    limits:",
        *(f"      {key}: {value:g}   # {comments[key]}" for key, value in _given_limits(limits).items()),
    ]
    others = (each for each in first.findings if each.severity != "undecided" and each.text not in reasons)
    found = tuple(f"{each.severity}: {each.text}" for each in others)
    missing = tuple(map(dataset.missing_files_of, dataset.missing_files))
    return FirstConfiguration(
        system.name, HEAD_COMMENT + "\n".join(lines) + "\n", reasons, judged.undecided, found, missing
    )


def _reasons_of_noisy_corners(calibration: Calibration) -> Iterator[str]:
    """Yield a reason for each camera whose corners are worse than a detector's, where they place a sensor."""
    if calibration.of_cameras_alone:
        return
    most = MAX_NOISE["pixel"]
    for name, noise in noise_inside_views(calibration.solution.setup.problem, calibration.solution.values).items():
        if noise > most:
            yield (
                f"the corners of '{name}' are off by {noise:.2g} px within single views, a detector errs by {most:g} px"
                f" at most: look at focus, light and exposure; is the lens's distortion known, and is the board flat "
                f"and as it is described?"
            )


def _causes_that_move_sensors(calibration: Calibration, first: CellResult) -> Iterator[str]:
    """Yield the causes that move a sensor by more than the error bar of collections that agree."""
    for each in first.findings:
        if each.kind != "suspect" or each.severity == "red" or each.moves_mm is None or each.moves_deg is None:
            continue
        limits = [allowed(calibration, Limits(), sensor) for sensor in each.sensors]
        if any(one.exceeded(each.moves_mm / OF_GUARD_BAND, each.moves_deg / OF_GUARD_BAND) for one in limits):
            yield each.text


def _other_mounting(dataset: Dataset) -> str:
    """Return the question whether sensor and pattern are exchanged, where one of them is on an arm; else nothing."""
    if len(dataset.sensors) > 1 or not all(pattern.fixed for pattern in dataset.patterns.values()):
        return ""
    (sensor,), (pattern, *_) = dataset.sensors, dataset.patterns
    return f"; or are '{sensor}' and '{pattern}' mounted the other way round ('parent' in import.yml)?"


def _options_for(dataset: Dataset) -> Options:
    """Return the options for what an imported dataset says of itself: rough poses, cameras without intrinsics.

    Of one camera before a pattern that moves freely nothing but its intrinsics can be calibrated.
    """
    metadata = dataset.document["_metadata"]
    cameras = dataset.guessed_cameras
    if len(dataset.sensors) == 1 and not any(pattern.fixed for pattern in dataset.patterns.values()):
        cameras = tuple(name for name, sensor in dataset.sensors.items() if sensor.modality.has_corners)
    return Options(description="rough" if metadata.get(ROUGH_KEY) is True else "trusted", intrinsics=cameras)


def _option_lines(options: Options, lenses: Mapping[str, LensChoice]) -> Iterator[str]:
    if options.description == "rough":
        yield _yaml_line(
            "description", "rough", "the sensors' true poses are unknown: there is no comparison with a truth"
        )
    if options.intrinsics:
        why = "of these none were given: they are calibrated with the rest"
        if not options.lens:
            why = "nothing else can be calibrated of one camera before a pattern that moves freely"
        yield _yaml_line("intrinsics", list(options.intrinsics), why)
    if options.lens:
        yield "    lens:"
        for name, model in options.lens.items():
            yield f"  {_yaml_line(name, model, lenses[name].reason)}"


def nice(number: float) -> float:
    """Return the next larger round number."""
    power = 10.0 ** math.floor(math.log10(number))
    return float(f"{next(step for step in ROUND_MANTISSAS if step * power >= number * (1 - 1e-9)) * power:.6g}")


def _calibrate_system(system: System) -> tuple[CellResult, Calibration | None]:
    return calibrate_cell(Cell(system.name, StartingNoise()), load(system))


def _choose_table(dataset: Dataset) -> tuple[str | None, str]:
    """Return the table that covers most of the dataset, a description; None if no sensors see a pattern together."""
    suggested = [(name, kind.suggestion) for name, kind in TABLE_KINDS.items() if kind.suggestion is not None]
    for name, suggestion in sorted(suggested, key=lambda entry: -len(entry[1].families)):  # of two sensors first
        if (chosen := _names_for(suggestion, dataset)) is not None:
            names, counted = chosen
            return ":".join((name, *names)), suggestion.reason.format(*names) + counted
    return None, ""


def _names_for(suggestion: Suggestion, dataset: Dataset) -> tuple[tuple[str, ...], str] | None:
    """Return the sensors and the pattern that a table fits best, and what both have; None if it fits none."""
    of_family = [
        [name for name, sensor in dataset.sensors.items() if sensor.modality.family == family]
        for family in suggestion.families
    ]
    if len(of_family) == 1:
        sensors = of_family[0][:1]
        if suggestion.by_arm:
            alone = len(of_family[0]) == 1 and any(pattern.fixed for pattern in dataset.patterns.values())
            sensors = 2 * sensors if alone else []
        return ((*sensors, *_most_shared(dataset, sensors[0], sensors[0])[1]), "") if sensors else None
    first, second = of_family
    pairs = combinations(first, 2) if first == second else product(first, second)
    shared = {pair: _most_shared(dataset, *pair) for pair in pairs}
    best = max(shared, key=lambda pair: shared[pair][0], default=("", ""))
    count, pattern = shared.get(best, (0, ()))
    return ((*best, *pattern), f"; {count} collections have both") if count >= MIN_SHARED_COLLECTIONS else None


def _most_shared(dataset: Dataset, first: str, second: str) -> tuple[int, tuple[str, ...]]:
    """Return in how many collections two sensors see the same pattern, and, of several, the one most seen."""
    counts = {
        pattern: sum({(pattern, first), (pattern, second)} <= each.labels.keys() for each in dataset.collections)
        for pattern in dataset.patterns
    }
    most = max(counts, key=counts.__getitem__)
    return counts[most], (most,) if len(counts) > 1 else ()


def _collections_of(dataset: Dataset, sensor: str) -> set[int]:
    """Return the collections in which a sensor sees a pattern."""
    return {i for i, each in enumerate(dataset.collections) if any(name == sensor for _, name in each.labels)}


def _seen_collections(dataset: Dataset) -> str:
    counts = [f"{name} sees it in {len(_collections_of(dataset, name))}" for name in dataset.sensors]
    return f"{len(dataset.collections)} collections; {', '.join(counts)}"


def _default_limits(calibration: Calibration) -> tuple[Limits, dict[str, str]]:
    """Return the default limits, of the least precise sensor and joint, rounded up, with the reason of each."""
    sensors = [name for name in stated(calibration) if name not in calibration.joints]
    values: dict[str, Any] = {}
    comments: dict[str, str] = {}
    for of, word in ((sensors, ("translation_mm", "rotation_deg")), (calibration.joints, ("joint_mm", "joint_deg"))):
        each = {name: allowed(calibration, Limits(), name) for name in of}
        for i, key in enumerate(word if each else ()):
            numbers = {name: (limit.translation_mm, limit.rotation_deg)[i] for name, limit in each.items()}
            name = max(numbers, key=lambda one: numbers[one])
            values[key] = nice(numbers[name])
            comments[key.replace("_", "-")] = _reason_of_limit(
                numbers[name], stated(calibration)[name][i], MIN_DEFAULT_LIMIT[i], UNITS_OF_LIMITS[i]
            )
    return Limits(**values), comments


def _limits_of_cameras(dataset: Dataset) -> tuple[Limits, dict[str, str]]:
    """Return the limit of cameras alone, which does not depend on the recording, with its reason."""
    most = min(projection_limit(each.camera, Limits()) for each in dataset.sensors.values() if each.camera)
    why = (
        "at the pattern's distance; 0.4 % of the image's longer side: a focal length that is 0.8 % off moves its "
        "border so"
    )
    return Limits(projection_px=nice(most)), {"projection-px": why}


def _reason_of_limit(limit: float, sigma: float, least: float, unit: str) -> str:
    """Return the reason of a limit."""
    what = f"{DEFAULT_LIMIT_SIGMAS:g} standard deviations of a good robot that sees this: {limit:.2g} {unit}"
    if limit <= least:
        what = (
            f"the least that is asked for, more than {DEFAULT_LIMIT_SIGMAS:g} standard deviations of a good "
            "robot that sees this"
        )
    return f"{what}; this recording states {sigma:.2g} {unit} in all"


def _given_limits(limits: Limits) -> Mapping[str, float]:
    keys = ("translation-mm", "rotation-deg", "joint-mm", "joint-deg", "projection-px")
    found = {key: getattr(limits, key.replace("-", "_")) for key in keys}
    return {key: value for key, value in found.items() if value is not None}


def _yaml_line(key: str, value: Any, why: str) -> str:
    shown = f"[{', '.join(map(_yaml_scalar, value))}]" if isinstance(value, list) else _yaml_scalar(value)
    return f"    {_yaml_scalar(key)}: {shown}   # {_printable_text(why)}"


def _printable_text(text: str) -> str:
    return "".join(c if c.isprintable() else "?" for c in text)


def _yaml_scalar(text: str) -> str:
    """Format a text as a YAML scalar on one line, quoted if necessary."""
    plain = _PLAIN_SCALAR.fullmatch(text) is not None and not text.endswith(":") and yaml.safe_load(text) == text
    return text if plain else json.dumps(text)
