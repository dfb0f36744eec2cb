"""Metrics of a repository's code, and a grade of them."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath

from calibration.addons.analysis.analysers.analyser import arguments, module, run_program
from calibration.addons.analysis.analysers.code import CPP_SUFFIXES
from calibration.addons.analysis.copies import Copy
from calibration.addons.analysis.results import CodeFinding, Metrics
from calibration.base import InfrastructureError
from calibration.ci.report.badge import BAD, FAIR, GOOD, drawn_badge

BADGE_FILE = "badge.svg"
_WEIGHT_OF_SEVERITY = {"error": 5.0, "warning": 1.0, "note": 0.2}
"""Weights of findings by severity."""
_MAX_WEIGHT_OF_GRADE = (("A", 1.0), ("B", 5.0), ("C", 10.0), ("D", 20.0), ("E", 40.0))
"""Grades, each with the largest weight of findings in a thousand lines; F beyond them."""
_MAX_COMPLEX_PERCENT, _MAX_DUPLICATE_PERCENT = 10.0, 10.0
"""Limits in percent, beyond each of which the grade is one worse."""
_TOTALS_OF_OUTPUT = re.compile(
    r"^Total nloc .*\n-+\n\s*(\d+)\s+[\d.]+\s+([\d.]+)\s+[\d.]+\s+(\d+)\s+(\d+)\s", re.MULTILINE
)
_DUPLICATE_RATE = re.compile(r"^Total duplicate rate: ([\d.]+)%", re.MULTILINE)
_COLOUR_OF_GRADE = {"A": GOOD, "B": GOOD, "C": FAIR, "D": FAIR}


@dataclass(frozen=True)
class CodeMetrics:
    """Metrics of code."""

    functions: int = 0
    mean_complexity: float = 0.0
    complex_functions: int = 0
    duplicate_percent: float = 0.0

    def graded(self, findings: Sequence[CodeFinding], lines: int) -> Metrics:
        """Return the metrics with the grade of findings in so many lines that are not empty."""
        weight = 1000 * sum(_WEIGHT_OF_SEVERITY[each.severity] for each in findings) / max(lines, 1)
        complex_percent = 100 * self.complex_functions / max(self.functions, 1)
        return Metrics(
            functions=self.functions,
            mean_complexity=self.mean_complexity,
            complex_percent=round(complex_percent, 1),
            duplicate_percent=self.duplicate_percent,
            weighted_findings=round(weight, 2),
            grade=grade_of(weight, complex_percent, self.duplicate_percent),
        )


def measure(copy: Copy, paths: Sequence[str], seconds: float) -> CodeMetrics:
    """Measure the files of a copy that are in Python, C or C++.

    Raises:
        InfrastructureError: lizard fails, or takes too long.
    """
    code = [path for path in paths if PurePosixPath(path).suffix.lower() in (*CPP_SUFFIXES, ".py")]
    if not code:
        return CodeMetrics()
    command = [*module("lizard"), "-Eduplicate", *arguments(code)]
    output = run_program("lizard", command, copy.root, seconds, (0, 1)).output  # 1: there are complex functions
    totals, share = _TOTALS_OF_OUTPUT.search(output), _DUPLICATE_RATE.search(output)
    if totals is None or share is None:
        raise InfrastructureError("lizard: its totals were expected at the end of its output, found none")
    return CodeMetrics(int(totals[3]), float(totals[2]), int(totals[4]), float(share[1]))


def grade_of(weight: float, complex_percent: float, duplicate_percent: float) -> str:
    """Return the grade, A to F.

    Args:
        weight: of the findings in a thousand lines: 5 for an error, 1 for a warning, 0.2 for a note.
        complex_percent: share of functions that are too complex.
        duplicate_percent: share of duplicate code.
    """
    grades = [name for name, _ in _MAX_WEIGHT_OF_GRADE] + ["F"]
    place = sum(weight > most for _, most in _MAX_WEIGHT_OF_GRADE)
    place += (complex_percent > _MAX_COMPLEX_PERCENT) + (duplicate_percent > _MAX_DUPLICATE_PERCENT)
    return grades[min(place, len(grades) - 1)]


def grade_badge(grade: str) -> str:
    """Return the badge of a grade as SVG."""
    return drawn_badge("static analysis", grade, _COLOUR_OF_GRADE.get(grade, BAD))
