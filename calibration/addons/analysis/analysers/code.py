"""Analysers of code: ruff (Python), cppcheck (C and C++), lizard (functions that are too complex), shellcheck."""

import csv
import io
import json
import re
from collections.abc import Sequence
from pathlib import PurePosixPath

from calibration.addons.analysis.analysers.analyser import (
    Analyser,
    arguments,
    in_repository,
    json_output,
    module,
    program,
    run_program,
)
from calibration.addons.analysis.copies import Copy
from calibration.addons.analysis.results import Category, CodeFinding, Severity

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
        return [_finding_of_cppcheck(each, copy) for each in parts if len(each) == 5 and each[0] and each[1].isdigit()]


def _finding_of_cppcheck(parts: list[str], copy: Copy) -> CodeFinding:
    file, line, kind, rule, message = parts
    severity: Severity = "error" if kind == "error" else "warning" if kind == "warning" else "note"
    category: Category = "unused code" if rule in _UNUSED_CODE else _CATEGORY_OF_KIND.get(kind, "error-prone")
    if rule in _RULES_OF_MISSING_HEADERS:
        severity = "note"
    return CodeFinding(in_repository(file, copy), max(int(line), 1), f"cppcheck/{rule}", category, severity, message)


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


_SELECTED_RULES = "E,W,F,B,S,PERF,C4,ARG,UP"
_IGNORED_RULES = "S101,E501"
"""Ignored rules: asserts, which tests need; line length, which a formatter decides."""
_CATEGORY_OF_PREFIX: tuple[tuple[tuple[str, ...], Category], ...] = (
    (("S",), "security"),
    (("F401", "F811", "F841", "F842", "ARG", "ERA"), "unused code"),
    (("SIM", "SLF", "SLOT"), "style"),
    (("E9", "F", "B", "PLE", "PLW", "ASYNC", "BLE", "invalid-syntax"), "error-prone"),
    (("PERF", "C4"), "performance"),
    (("C90", "PLR09"), "complexity"),
    (("D",), "documentation"),
    (("UP", "FA", "YTT"), "compatibility"),
)
"""Categories by prefix of the rule; the first match counts, else style."""
_PREFIXES_OF_ERRORS = ("E9", "F5", "F63", "F7", "F82", "PLE", "invalid-syntax")


class Ruff(Analyser):
    """Lint, security and bugs of Python; the team's settings select the rules, if there are any."""

    name = "ruff"
    settings = ("ruff.toml", ".ruff.toml", "pyproject.toml")

    def wants(self, path: str, copy: Copy) -> bool:
        """Select Python files by suffix, or by the first line of a script."""
        if path.endswith((".py", ".pyi")):
            return True
        return not PurePosixPath(path).suffix and "python" in copy.first_line(path)

    def findings(self, copy: Copy, files: Sequence[str], seconds: float) -> list[CodeFinding]:
        """Run ``ruff check`` and parse its output."""
        command = [*module("ruff"), "check", "--no-cache", "--no-fix", "--exit-zero", "--force-exclude"]
        command += ["--output-format", "json"]
        if not _has_ruff_settings(copy):
            command += ["--select", _SELECTED_RULES, "--ignore", _IGNORED_RULES]
        result = run_program(self.name, [*command, "--", *arguments(files)], copy.root, seconds, (0,))
        return [_finding_of_ruff(entry, copy) for entry in json.loads(result.output or "[]")]


def _has_ruff_settings(copy: Copy) -> bool:
    for path in ("ruff.toml", ".ruff.toml"):
        if (copy.root / path).is_file():
            return True
    return (copy.root / "pyproject.toml").is_file() and "[tool.ruff" in copy.text("pyproject.toml")


def _finding_of_ruff(entry: dict[str, object], copy: Copy) -> CodeFinding:
    code = str(entry.get("code") or "invalid-syntax")
    place = entry.get("location")
    line = int(place.get("row", 1)) if isinstance(place, dict) else 1
    path = in_repository(str(entry["filename"]), copy)
    category = _category_of_ruff_rule(code)
    severity: Severity = (
        "error" if code.startswith(_PREFIXES_OF_ERRORS) else "note" if category == "style" else "warning"
    )
    return CodeFinding(path, line, f"ruff/{code}", category, severity, str(entry["message"]))


def _category_of_ruff_rule(code: str) -> Category:
    for begins, category in _CATEGORY_OF_PREFIX:
        if code.startswith(begins):
            return category
    return "style"


_SHELL_IN_FIRST_LINE = re.compile(r"#!.*\b(sh|bash|dash|ksh)\b")
_SEVERITY_OF_LEVEL: dict[str, Severity] = {"error": "error", "warning": "warning"}


class Shellcheck(Analyser):
    """Errors of sh, bash, dash and ksh."""

    name = "shellcheck"
    settings = (".shellcheckrc", "shellcheckrc")

    def wants(self, path: str, copy: Copy) -> bool:
        """Select shell scripts by suffix, or by their first line."""
        suffix = PurePosixPath(path).suffix
        return suffix in (".sh", ".bash") or (not suffix and bool(_SHELL_IN_FIRST_LINE.match(copy.first_line(path))))

    def findings(self, copy: Copy, files: Sequence[str], seconds: float) -> list[CodeFinding]:
        """Run shellcheck; files whose first line names no shell are checked as bash."""
        named = [file for file in files if copy.first_line(file).startswith("#!")]
        found = []
        for options, group in (([], named), (["--shell=bash"], [file for file in files if file not in named])):
            if group:
                command = [program("shellcheck"), "--format=json1", *options, "--", *arguments(group)]
                result = run_program(self.name, command, copy.root, seconds, (0, 1))
                found += [_finding_of_shellcheck(entry, copy) for entry in json_output(self.name, result)["comments"]]
        return found


def _finding_of_shellcheck(entry: dict[str, object], copy: Copy) -> CodeFinding:
    level, code = str(entry["level"]), int(str(entry["code"]))
    category: Category = "unused code" if code == 2034 else "compatibility" if 3000 <= code < 4000 else "error-prone"
    if level == "style":
        category = "style"
    path, line = in_repository(str(entry["file"]), copy), int(str(entry["line"]))
    severity = _SEVERITY_OF_LEVEL.get(level, "note")
    return CodeFinding(path, max(line, 1), f"shellcheck/SC{code}", category, severity, str(entry["message"]))
