"""``results.json`` of a sweep, its tables, and its verdict."""

import csv
import io
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from calibration.errors import ExitCode, exit_code_of
from calibration.introspection.numbers import number_text
from calibration.pipeline.collection.results import Check
from calibration.pipeline.convergence.convergence_map import ConvergenceMap, Noise, Pair
from calibration.pipeline.matrix.cell import noise_text
from calibration.pipeline.system import NoiseGrid
from calibration.report import Outcome

SCHEMA = Path(__file__).with_name("convergence.schema.json")
FILE, SUMMARY_FILE, JUNIT_FILE = "results.json", "summary.md", "junit.xml"
TABLE_FILE, LARGEST_FILE = "convergence.csv", "largest-noise.csv"
PNG_FILE, SVG_FILE = "convergence.png", "convergence.svg"
FILES = (FILE, SUMMARY_FILE, JUNIT_FILE, TABLE_FILE, LARGEST_FILE, PNG_FILE, SVG_FILE)
"""Everything that a sweep leaves, but for what the team's software does."""


@dataclass(frozen=True)
class Minimums:
    """The noise up to which every start has to converge; None where nothing is asked."""

    translation: float | None = None
    """m, with no rotation noise."""
    rotation: float | None = None
    """rad, with no translation noise."""


@dataclass(frozen=True)
class ConvergenceResults:
    """What came of a sweep."""

    noise: NoiseGrid
    maps: tuple[ConvergenceMap, ...]
    minimums: Minimums = Minimums()
    notes: tuple[str, ...] = ()
    """What could not be made beside the results."""

    @property
    def judged(self) -> list[ConvergenceMap]:
        """The maps that have a part in the verdict."""
        return [each for each in self.maps if each.judged]

    @property
    def checks(self) -> list[Check]:
        """The largest noises against what is asked."""
        return [check for each in self.judged for check in _checks(each, self.minimums)]

    @property
    def reasons(self) -> list[str]:
        """Why the verdict is fail; nothing where it is pass."""
        lost = [reason for each in self.judged if (reason := without_noise(each))]
        failed = [cell for each in self.judged for pair in each.pairs.values() for cell in pair.cells]
        world = [f"{cell.name}: {cell.reasons[0]}" for cell in failed if cell.error == ExitCode.WORLD]
        return [*lost, *world, *(str(check) for check in self.checks if not check.passed)]

    @property
    def verdict(self) -> Literal["pass", "fail"]:
        """Pass when every map converges without noise, and as far as is asked."""
        return "fail" if self.reasons or not self.judged else "pass"

    @property
    def exit_code(self) -> ExitCode:
        """2 or 3 where something could not be done because of bad input or a failing world, else the verdict's."""
        return exit_code_of(self.verdict == "pass", (each.error for each in self.judged))

    @property
    def largest_translation(self) -> float | None:
        """The largest noise up to which every start of every map converges, m; None where one does not without."""
        return least([each.largest.translation for each in self.judged])

    @property
    def largest_rotation(self) -> float | None:
        """The same in rad."""
        return least([each.largest.rotation for each in self.judged])

    @property
    def largest_diagonal(self) -> Noise | None:
        """The same of both at once."""
        found = [each.largest.diagonal for each in self.judged]
        translation = least([noise[0] if noise else None for noise in found])
        rotation = least([noise[1] if noise else None for noise in found])
        return None if translation is None or rotation is None else (translation, rotation)


def least(values: Sequence[float | None]) -> float | None:
    """The smallest of the values; None where one of them is missing, or all."""
    known = [value for value in values if value is not None]
    return min(known) if known and len(known) == len(values) else None


def without_noise(of: ConvergenceMap) -> str:
    """Why a map does not even converge from the start without noise; empty where it does."""
    pair = of.pairs[0.0, 0.0]
    if pair.always:
        return ""
    return f"{of.name}: the start without noise does not converge: {pair.reason or 'for no reason that is known'}"


def _checks(of: ConvergenceMap, minimums: Minimums) -> list[Check]:
    asked = (
        ("translation", of.largest.translation, minimums.translation, "m"),
        ("rotation", of.largest.rotation, minimums.rotation, "rad"),
    )
    return [
        Check(f"{of.name}: largest {what} noise that always converges", found, minimum, at_least=True, unit=unit)
        for what, found, minimum, unit in asked
        if minimum is not None
    ]


def document(results: ConvergenceResults) -> dict[str, Any]:
    """The content of ``results.json``. No times: the same input gives the same bytes."""
    return {
        "schema": 1,
        "verdict": results.verdict,
        "reasons": results.reasons,
        "grid": {
            "translation_noise": list(results.noise.translations),
            "rotation_noise": list(results.noise.rotations),
            "seeds": list(results.noise.seeds),
        },
        "largest": _largest(results.largest_translation, results.largest_rotation, results.largest_diagonal),
        "maps": [_map(each) for each in results.maps],
        "checks": [{**asdict(check), "passed": check.passed} for check in results.checks],
        "figures": [] if results.notes else [PNG_FILE, SVG_FILE],
        "notes": list(results.notes),
    }


def json_text(results: ConvergenceResults) -> str:
    """``results.json``."""
    return json.dumps(document(results), indent=1, allow_nan=False) + "\n"


def _largest(translation: float | None, rotation: float | None, diagonal: Noise | None) -> dict[str, Any]:
    both = None if diagonal is None else {"translation_noise": diagonal[0], "rotation_noise": diagonal[1]}
    return {"translation_noise": translation, "rotation_noise": rotation, "diagonal": both}


def _map(of: ConvergenceMap) -> dict[str, Any]:
    largest = of.largest
    return {
        "system": of.system,
        "method": of.method,
        "start": of.start,
        "judged": of.judged,
        "largest": _largest(largest.translation, largest.rotation, largest.diagonal),
        "pairs": [_pair(noise, pair) for noise, pair in of.pairs.items()],
    }


def _pair(noise: Noise, pair: Pair) -> dict[str, Any]:
    return {
        "translation_noise": noise[0],
        "rotation_noise": noise[1],
        "starts": len(pair.cells),
        "converged": pair.converged,
        "share": _rounded_down(pair.share),
        "lost": [
            {"seed": cell.seed, "reasons": list(cell.reasons), "error": cell.error}
            for cell in pair.cells
            if cell.verdict == "fail"
        ],
    }


def _rounded_down(share: float) -> float:
    """A share that is 1 only where it is."""
    return math.floor(share * 1e6) / 1e6


def table(results: ConvergenceResults) -> str:
    """``convergence.csv``: a row for each map and pair of noises."""
    rows = [
        (
            f"{each.name}, {noise_text(*noise)}",
            *(each.system, each.method, each.start),
            *map(number_text, noise),
            len(pair.cells),
            pair.converged,
            number_text(_rounded_down(pair.share)),
            " ".join(map(str, pair.lost)),
            pair.reason,
        )
        for each in results.maps
        for noise, pair in each.pairs.items()
    ]
    header = ("Cell", "System", "Method", "Start", "Translation noise (m)", "Rotation noise (rad)")
    return _csv((*header, "Starts", "Converged", "Share", "Lost seeds", "First reason"), rows)


def largest_table(results: ConvergenceResults) -> str:
    """``largest-noise.csv``: a row for each map; empty, which no rule lets pass, where nothing converges."""

    def shown(value: float | None) -> str:
        return "" if value is None else number_text(value)

    rows = []
    for each in results.maps:
        largest = each.largest
        diagonal = largest.diagonal or (None, None)
        rows.append((each.name, *map(shown, (largest.translation, largest.rotation, *diagonal))))
    header = ("Map", "Translation noise (m)", "Rotation noise (rad)")
    return _csv((*header, "Diagonal translation noise (m)", "Diagonal rotation noise (rad)"), rows)


def _csv(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()


def junit(results: ConvergenceResults) -> str:
    """The verdict as JUnit XML: each map without noise, and each check."""
    from calibration.report.junit import junit_xml  # XML is slow to import

    def without(each: ConvergenceMap) -> Outcome:
        why = without_noise(each)
        if each.error is not None and not why:
            why = "a start could not be run: see results.json"
        name = f"{each.name}: converges without noise"
        return Outcome(name=name, group=each.system, reasons=(why,) if why else (), error=each.error)

    outcomes = [without(each) for each in results.judged]
    outcomes += [
        Outcome(name=c.name, group="convergence", reasons=() if c.passed else (str(c),)) for c in results.checks
    ]
    return junit_xml({"convergence": outcomes})
