"""Analysers of code: ruff (Python), cppcheck (C and C++), lizard (functions that are too complex), shellcheck."""

import csv
import io
import json
import re
from collections.abc import Iterator, Sequence
from pathlib import PurePosixPath

from calibration.addons.analysis.analysers.analyser import (
    ProgramAnalyser,
    ProgramFinding,
    ProgramResult,
    json_output,
    module,
    program,
)
from calibration.addons.analysis.copies import Copy
from calibration.addons.analysis.results import Category, Severity

CPP_SUFFIXES = (".c", ".cc", ".cpp", ".cxx", ".h", ".hh", ".hpp", ".hxx")
_RULES_OF_MISSING_HEADERS = ("unknownMacro", "syntaxError", "internalAstError", "preprocessorErrorDirective")
"""Errors of cppcheck due to missing headers: the code itself need not be wrong."""
_RULES_OF_UNUSED_CODE = re.compile(r"unreadVariable|unused(Variable|Function|PrivateFunction|StructMember)")
_CATEGORY_OF_KIND: dict[str, Category] = {
    "performance": "performance",
    "portability": "compatibility",
    "style": "style",
}
_SEVERITY_OF_LEVEL: dict[str, Severity] = {"error": "error", "warning": "warning"}
"""Severities by the levels of cppcheck and shellcheck; others are notes."""


class Cppcheck(ProgramAnalyser):
    """Errors of C and C++ that are visible without building."""

    name = "cppcheck"
    at_once = 20
    suffixes = CPP_SUFFIXES

    def runs(self, copy: Copy, files: Sequence[str]) -> Iterator[tuple[list[str], Sequence[str]]]:
        """Yield the command."""
        command = [program("cppcheck"), "--quiet", "--enable=warning,performance,portability", "--inline-suppr"]
        yield [*command, "--max-configs=2", r"--template={file}\t{line}\t{severity}\t{id}\t{message}"], files

    def parsed(self, result: ProgramResult) -> Iterator[ProgramFinding]:
        """Parse the standard error, one finding per line."""
        for parts in (line.split("\t", 4) for line in result.errors.splitlines()):
            if len(parts) == 5 and parts[0] and parts[1].isdigit():
                file, line, kind, rule, message = parts
                is_unused = _RULES_OF_UNUSED_CODE.fullmatch(rule)
                category: Category = "unused code" if is_unused else _CATEGORY_OF_KIND.get(kind, "error-prone")
                level = "note" if rule in _RULES_OF_MISSING_HEADERS else kind
                yield file, int(line), rule, category, _SEVERITY_OF_LEVEL.get(level, "note"), message


MAX_COMPLEXITY = 15
"""Limit of a function's cyclomatic complexity, lizard's default."""


class Lizard(ProgramAnalyser):
    """Cyclomatic complexity of functions."""

    name = "lizard"
    suffixes = (*CPP_SUFFIXES, ".py")

    def runs(self, copy: Copy, files: Sequence[str]) -> Iterator[tuple[list[str], Sequence[str]]]:
        """Yield the command."""
        yield [*module("lizard"), "--csv"], files

    def parsed(self, result: ProgramResult) -> Iterator[ProgramFinding]:
        """Parse the table of functions."""
        for row in csv.reader(io.StringIO(result.output)):
            if len(row) >= 10 and row[1].isdigit() and int(row[1]) > MAX_COMPLEXITY:
                message = f"{row[7]} has a cyclomatic complexity of {row[1]}, at most {MAX_COMPLEXITY} was expected"
                yield row[6], int(row[9]), "complexity", "complexity", "warning", message


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


class Ruff(ProgramAnalyser):
    """Lint, security and bugs of Python; the team's settings select the rules, if there are any."""

    name = "ruff"
    settings = ("ruff.toml", ".ruff.toml", "pyproject.toml")

    def wants(self, path: str, copy: Copy) -> bool:
        """Select Python files by suffix, or by the first line of a script."""
        if path.endswith((".py", ".pyi")):
            return True
        return not PurePosixPath(path).suffix and "python" in copy.first_line(path)

    def runs(self, copy: Copy, files: Sequence[str]) -> Iterator[tuple[list[str], Sequence[str]]]:
        """Yield the command of ``ruff check``."""
        own = [name for name in self.settings if (copy.root / name).is_file()]
        if own == ["pyproject.toml"] and "[tool.ruff" not in copy.text("pyproject.toml"):
            own = []
        rules = [] if own else ["--select", _SELECTED_RULES, "--ignore", _IGNORED_RULES]
        command = [*module("ruff"), "check", "--no-cache", "--no-fix", "--exit-zero", "--force-exclude"]
        yield [*command, "--output-format", "json", *rules, "--"], files

    def parsed(self, result: ProgramResult) -> Iterator[ProgramFinding]:
        """Parse the list of findings."""
        for entry in json.loads(result.output or "[]"):
            code = str(entry.get("code") or "invalid-syntax")
            line = int((entry.get("location") or {}).get("row", 1))
            found = (category for begins, category in _CATEGORY_OF_PREFIX if code.startswith(begins))
            category: Category = next(found, "style")
            level: Severity = "note" if category == "style" else "warning"
            severity: Severity = "error" if code.startswith(_PREFIXES_OF_ERRORS) else level
            yield str(entry["filename"]), line, code, category, severity, str(entry["message"])


_SHELL_IN_FIRST_LINE = re.compile(r"#!.*\b(sh|bash|dash|ksh)\b")


class Shellcheck(ProgramAnalyser):
    """Errors of sh, bash, dash and ksh."""

    name = "shellcheck"
    settings = (".shellcheckrc", "shellcheckrc")
    codes = (0, 1)

    def wants(self, path: str, copy: Copy) -> bool:
        """Select shell scripts by suffix, or by their first line."""
        suffix = PurePosixPath(path).suffix
        return suffix in (".sh", ".bash") or (not suffix and bool(_SHELL_IN_FIRST_LINE.match(copy.first_line(path))))

    def runs(self, copy: Copy, files: Sequence[str]) -> Iterator[tuple[list[str], Sequence[str]]]:
        """Yield the commands; files whose first line names no shell are checked as bash."""
        named = [file for file in files if copy.first_line(file).startswith("#!")]
        command = [program("shellcheck"), "--format=json1"]
        yield [*command, "--"], named
        yield [*command, "--shell=bash", "--"], [file for file in files if file not in named]

    def parsed(self, result: ProgramResult) -> Iterator[ProgramFinding]:
        """Parse the list of findings."""
        for entry in json_output(self.name, result)["comments"]:
            level, code = str(entry["level"]), int(entry["code"])
            compatibility: Category = "compatibility" if 3000 <= code < 4000 else "error-prone"
            category: Category = "style" if level == "style" else "unused code" if code == 2034 else compatibility
            severity = _SEVERITY_OF_LEVEL.get(level, "note")
            yield str(entry["file"]), int(entry["line"]), f"SC{code}", category, severity, str(entry["message"])
