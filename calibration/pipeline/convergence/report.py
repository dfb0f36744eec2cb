"""Report of ``convergence``: a table and a figure of each map, translation noise down, rotation noise across."""

import shlex
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from calibration.base.errors import CalibrationError
from calibration.base.tables.numbers import number_text
from calibration.ci.report import FILES, Lines, Outcome, Report, Table, outcome_of_check
from calibration.pipeline.convergence.convergence_map import ConvergenceMap
from calibration.pipeline.convergence.figure import figures
from calibration.pipeline.convergence.results import ConvergenceResults, without_noise
from calibration.pipeline.matrix.cell import noise_text

SCHEMA = Path(__file__).with_name("convergence.schema.json")
TITLE = "convergence"
TABLE_FILE, LARGEST_FILE = "convergence.csv", "largest-noise.csv"
PNG_FILE, SVG_FILE = "convergence.png", "convergence.svg"
ALL_FILES = (*FILES, TABLE_FILE, LARGEST_FILE, PNG_FILE, SVG_FILE)
"""Names of all output files of a sweep, except for those of the team's software."""
LOST_SHOWN = 10
"""Limit of the maps with a named initial guess that does not converge."""


def report(results: ConvergenceResults, output: Path, source: str = "--config calibration.yml") -> Report:
    """Return the report, with its figures if they can be drawn.

    Args:
        results: the results.
        output: the folder for the results.
        source: option that selects the swept systems, for commands to paste.
    """
    notes: tuple[str, ...] = ()
    pictures: dict[str, str | bytes] = {}
    try:
        pictures = dict(zip((PNG_FILE, SVG_FILE), figures(results), strict=True))
    except CalibrationError as error:  # matplotlib is not installed, or there are too many maps
        notes = (str(error),)
    lost = tuple(line for each in results.maps if (line := first_lost(each, source)))
    largest = results.largest
    translation, rotation = largest.diagonal or (None, None)
    return Report(
        title=TITLE,
        verdict=results.verdict,
        error=results.exit_code,
        sentence=_sentence(results),
        reasons=tuple(results.reasons),
        notes=notes,
        blocks=(
            largest_table(results),
            *map(map_table, results.maps),
            Lines(lost, most=LOST_SHOWN, title="Starts that do not converge: one of each map"),
            Lines(notes),
        ),
        suites={TITLE: list(_outcomes(results))},
        results=replace(results, figures=tuple(pictures), notes=notes),
        outputs={
            "largest-translation-noise": largest.translation,
            "largest-rotation-noise": largest.rotation,
            "largest-diagonal-translation-noise": translation,
            "largest-diagonal-rotation-noise": rotation,
            "table": output / TABLE_FILE,
            "figure": output / PNG_FILE if pictures else None,
            "output": output,
        },
        files={TABLE_FILE: starts(results).csv(), LARGEST_FILE: largest_noise(results).csv(), **pictures},
    )


def map_table(of: ConvergenceMap) -> Table:
    """Return the convergence rate in percent of each pair of noises."""
    starts = len(next(iter(of.pairs.values())).cells)
    return Table(
        ("", *(f"{number_text(r)} rad" for r in of.rotations)),
        tuple(
            (f"{number_text(t)} m", *(of.pairs[t, r].percent for r in of.rotations))  # in the format of the noise pairs
            for t in of.translations
        ),
        title=f"{of.name}: starts that converge, % of {starts}",
    )


def largest_table(results: ConvergenceResults) -> Table:
    """Return the largest noise up to which everything converges, a row for each map."""

    def shown(value: float | None, unit: str) -> str:
        return "none" if value is None else f"{number_text(value)} {unit}"

    rows = (
        (
            each.name if each.judged else f"{each.name} (to compare)",
            shown(each.largest.translation, "m"),
            shown(each.largest.rotation, "rad"),
            noise_text(*each.largest.diagonal) if each.largest.diagonal else "none",
        )
        for each in results.maps
    )
    return Table(("Every start converges up to", "Translation alone", "Rotation alone", "Both, up to"), tuple(rows))


def starts(results: ConvergenceResults) -> Table:
    """Return a row for each map and pair of noises, for ``convergence.csv``."""
    header = ("Cell", "System", "Method", "Start", "Translation noise (m)", "Rotation noise (rad)")
    rows = (
        (
            f"{each.name}, {noise_text(*noise)}",
            *(each.system, each.method, each.start),
            *map(number_text, noise),
            str(pair.starts),
            str(pair.converged),
            number_text(pair.share),
            " ".join(map(str, pair.lost)),
            pair.reason,
        )
        for each in results.maps
        for noise, pair in each.pairs.items()
    )
    return Table((*header, "Starts", "Converged", "Share", "Lost seeds", "First reason"), tuple(rows))


def largest_noise(results: ConvergenceResults) -> Table:
    """Return a row for each map, for ``largest-noise.csv``; an empty cell, which fails every rule, if there is none."""
    header = ("Map", "Translation noise (m)", "Rotation noise (rad)")
    rows = []
    for each in results.maps:
        largest = each.largest
        values = (largest.translation, largest.rotation, *(largest.diagonal or (None, None)))
        rows.append((each.name, *("" if value is None else number_text(value) for value in values)))
    return Table((*header, "Diagonal translation noise (m)", "Diagonal rotation noise (rad)"), tuple(rows))


def first_lost(of: ConvergenceMap, source: str) -> str:
    """Return an initial guess with the least noise that does not converge, and its command; empty if all converge.

    Args:
        of: the map.
        source: option that selects the swept systems.
    """
    for (t, r), pair in of.pairs.items():
        if pair.lost:
            which = source if source.startswith("--dataset") else f"{source} --systems {shlex.quote(of.system)}"
            options = f"{which} --translation-noise {number_text(t)} --rotation-noise {number_text(r)}"
            how = f"calibration calibrate-matrix {options} --seed-list {pair.lost[0]} --start {of.start}"
            return f"{of.name}, {noise_text(t, r)}, seed {pair.lost[0]}: {pair.reason}: to look at it, {how}"
    return ""


def _sentence(results: ConvergenceResults) -> str:
    largest = results.largest
    if largest.diagonal is None:
        return "the start without noise does not converge"
    return (
        f"every start converges up to {number_text(largest.translation or 0.0)} m alone, "
        f"{number_text(largest.rotation or 0.0)} rad alone, and {noise_text(*largest.diagonal)} together"
    )


def _outcomes(results: ConvergenceResults) -> Iterable[Outcome]:
    """Return the cases of JUnit: each map without noise, and each check."""
    for each in results.judged:
        why = without_noise(each)
        if each.error is not None and not why:
            why = "a start could not be run: see results.json"
        name = f"{each.name}: converges without noise"
        yield Outcome(name=name, group=each.system, reasons=(why,) if why else (), error=each.error)
    for check in results.checks:
        yield outcome_of_check(check, TITLE)
