"""Analyser lizard: functions that are too complex, in Python, C and C++."""

import csv
import io
from collections.abc import Sequence
from pathlib import PurePosixPath

from calibration.addons.analysis.analysers.analyser import Analyser, arguments, in_repository
from calibration.addons.analysis.analysers.cpp import CPP_SUFFIXES
from calibration.addons.analysis.copies import Copy
from calibration.addons.analysis.finding import CodeFinding
from calibration.addons.analysis.programs import module, run_program

MAX_COMPLEXITY = 15
"""Limit of a function's cyclomatic complexity, lizard's default."""


class Lizard(Analyser):
    """Cyclomatic complexity of functions."""

    name = "lizard"

    def wants(self, path: str, copy: Copy) -> bool:
        """Select Python, C and C++ files by suffix."""
        return PurePosixPath(path).suffix.lower() in (*CPP_SUFFIXES, ".py")

    def findings(self, copy: Copy, files: Sequence[str], seconds: float) -> list[CodeFinding]:
        """Run lizard and parse its output."""
        result = run_program(self.name, [*module("lizard"), "--csv", *arguments(files)], copy.root, seconds, (0,))
        found = []
        for row in csv.reader(io.StringIO(result.output)):
            if len(row) >= 10 and row[1].isdigit() and int(row[1]) > MAX_COMPLEXITY:
                message = f"{row[7]} has a cyclomatic complexity of {row[1]}, at most {MAX_COMPLEXITY} was expected"
                path = in_repository(row[6], copy)
                found.append(CodeFinding(path, int(row[9]), "lizard/complexity", "complexity", "warning", message))
        return found
