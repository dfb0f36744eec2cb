"""Analyser cppcheck: C and C++."""

from collections.abc import Sequence
from pathlib import PurePosixPath

from calibration.addons.analysis.analysers.analyser import Analyser, arguments, in_repository
from calibration.addons.analysis.copies import Copy
from calibration.addons.analysis.finding import Category, CodeFinding, Severity
from calibration.addons.analysis.programs import program, run_program

CPP_SUFFIXES = (".c", ".cc", ".cpp", ".cxx", ".h", ".hh", ".hpp", ".hxx")
_RULES_OF_MISSING_HEADERS = ("unknownMacro", "syntaxError", "internalAstError", "preprocessorErrorDirective")
"""Errors of cppcheck due to missing headers: the code itself need not be wrong."""
_UNUSED_CODE = (
    "unreadVariable",
    "unusedVariable",
    "unusedFunction",
    "unusedPrivateFunction",
    "unusedStructMember",
)
_CATEGORY_OF_KIND: dict[str, Category] = {
    "performance": "performance",
    "portability": "compatibility",
    "style": "style",
}


class Cppcheck(Analyser):
    """Errors of C and C++ that are visible without building."""

    name = "cppcheck"
    at_once = 20

    def wants(self, path: str, copy: Copy) -> bool:
        """Select C and C++ files by suffix."""
        return PurePosixPath(path).suffix.lower() in CPP_SUFFIXES

    def findings(self, copy: Copy, files: Sequence[str], seconds: float) -> list[CodeFinding]:
        """Run cppcheck and parse its standard error, one finding per line."""
        command = [program("cppcheck"), "--quiet", "--enable=warning,performance,portability", "--inline-suppr"]
        command += ["--max-configs=2", r"--template={file}\t{line}\t{severity}\t{id}\t{message}"]
        result = run_program(self.name, [*command, *arguments(files)], copy.root, seconds, (0,))
        parts = [line.split("\t", 4) for line in result.errors.splitlines()]
        return [_finding_of_line(each, copy) for each in parts if len(each) == 5 and each[0] and each[1].isdigit()]


def _finding_of_line(parts: list[str], copy: Copy) -> CodeFinding:
    file, line, kind, rule, message = parts
    severity: Severity = "error" if kind == "error" else "warning" if kind == "warning" else "note"
    category: Category = "unused code" if rule in _UNUSED_CODE else _CATEGORY_OF_KIND.get(kind, "error-prone")
    if rule in _RULES_OF_MISSING_HEADERS:
        severity = "note"
    return CodeFinding(in_repository(file, copy), max(int(line), 1), f"cppcheck/{rule}", category, severity, message)
