"""Analysers that are programs, and the metrics of code with their grade.

Python: ruff; C and C++: cppcheck; shells: shellcheck; functions that are too complex: lizard; YAML: yamllint; workflows
and actions of GitHub: zizmor.
"""

import csv
import io
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath

import yaml

from calibration.addons.analysis.analysers.analyser import (
    ProgramAnalyser,
    ProgramFinding,
    ProgramResult,
    arguments,
    failure_of,
    json_output,
    module,
    program,
    run_program,
)
from calibration.addons.analysis.copies import Copy
from calibration.addons.analysis.results import Category, CodeFinding, Metrics, Severity
from calibration.addons.analysis.ros.tree import CPP_SUFFIXES
from calibration.base import InfrastructureError
from calibration.ci.report.blocks import BAD, FAIR, GOOD, drawn_badge

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


_WORKFLOWS_AND_ACTIONS = re.compile(r"\.github/workflows/[^/]+\.ya?ml|(.*/)?action\.ya?ml")
_SEVERITY_OF_ZIZMOR_LEVEL: dict[str, Severity] = {"High": "error", "Medium": "warning"}


class Zizmor(ProgramAnalyser):
    """Security of workflows and composite actions, offline."""

    name = "zizmor"
    settings = ("zizmor.yml", "zizmor.yaml")

    def wants(self, path: str, copy: Copy) -> bool:
        """Select workflows and actions; invalid YAML is reported by yamllint."""
        return bool(_WORKFLOWS_AND_ACTIONS.fullmatch(path)) and _is_mapping(copy.text(path))

    def runs(self, copy: Copy, files: Sequence[str]) -> Iterator[tuple[list[str], Sequence[str]]]:
        """Yield the command."""
        command = [program("zizmor"), "--offline", "--no-exit-codes", "--no-progress", "--quiet"]
        yield [*command, "--format", "json-v1", "--"], files

    def parsed(self, result: ProgramResult) -> Iterator[ProgramFinding]:
        """Parse the list of findings."""
        for entry in json.loads(result.output or "[]"):
            if entry.get("ignored"):
                continue
            places = entry["locations"]
            primary = next((each for each in places if each["symbolic"].get("kind") == "Primary"), places[0])
            path = primary["symbolic"]["key"]["Local"]["verbatim_path"]
            line = primary["concrete"]["location"]["start_point"]["row"] + 1
            severity = _SEVERITY_OF_ZIZMOR_LEVEL.get(entry["determinations"]["severity"], "note")
            message = f"{entry['desc']}: {primary['symbolic'].get('annotation', '')}"
            yield path, line, entry["ident"], "security", severity, message


def _is_mapping(text: str) -> bool:
    try:
        events = yaml.parse(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))  # the other one takes minutes
        return any(isinstance(event, yaml.MappingStartEvent) for event in list(events)[:3])
    except (yaml.YAMLError, RecursionError):
        return False


_LINE_OF_YAMLLINT = re.compile(r"(.+?):(\d+):(\d+): \[(error|warning)\] (.*?)(?: \(([a-z-]+)\))?")
_DEFAULT_CONFIGURATION = "{extends: relaxed, rules: {line-length: disable, new-line-at-end-of-file: disable}}"
_YAML_RULES_OF_ERRORS = ("syntax", "key-duplicates", "anchors")
"""Rules of errors that change the meaning; the others are style."""


class Yamllint(ProgramAnalyser):
    """Syntax, duplicate keys, and style of YAML; the team's settings select the rules, if there are any."""

    name = "yamllint"
    settings = (".yamllint", ".yamllint.yml", ".yamllint.yaml")
    codes = (0, 1)

    def wants(self, path: str, copy: Copy) -> bool:
        """Select YAML files by suffix, if they are UTF-8."""
        return path.endswith((".yml", ".yaml")) and copy.is_utf8(path)

    def runs(self, copy: Copy, files: Sequence[str]) -> Iterator[tuple[list[str], Sequence[str]]]:
        """Yield the command."""
        own = any((copy.root / name).is_file() for name in self.settings)
        rules = [] if own else ["--config-data", _DEFAULT_CONFIGURATION]
        yield [*module("yamllint"), "--format", "parsable", *rules, "--"], files

    def parsed(self, result: ProgramResult) -> Iterator[ProgramFinding]:
        """Parse the output, one finding per line."""
        if "Traceback" in result.errors:  # 1 is also the exit code of a Python program that crashes
            raise failure_of(self.name, result)
        for match in filter(None, map(_LINE_OF_YAMLLINT.fullmatch, result.output.splitlines())):
            rule = match[6] or "syntax"
            is_error = rule in _YAML_RULES_OF_ERRORS
            category: Category = "error-prone" if is_error else "style"
            yield match[1], int(match[2]), rule, category, "error" if is_error else "note", match[5]


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
