"""Analyser ruff: Python."""

import json
from collections.abc import Sequence
from pathlib import PurePosixPath

from calibration.addons.analysis.analysers.analyser import Analyser, arguments, in_repository
from calibration.addons.analysis.copies import Copy
from calibration.addons.analysis.finding import Category, CodeFinding, Severity
from calibration.addons.analysis.programs import module, run_program

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
        if not _has_settings(copy):
            command += ["--select", _SELECTED_RULES, "--ignore", _IGNORED_RULES]
        result = run_program(self.name, [*command, "--", *arguments(files)], copy.root, seconds, (0,))
        return [_finding_of_entry(entry, copy) for entry in json.loads(result.output or "[]")]


def _has_settings(copy: Copy) -> bool:
    for path in ("ruff.toml", ".ruff.toml"):
        if (copy.root / path).is_file():
            return True
    return (copy.root / "pyproject.toml").is_file() and "[tool.ruff" in copy.text("pyproject.toml")


def _finding_of_entry(entry: dict[str, object], copy: Copy) -> CodeFinding:
    code = str(entry.get("code") or "invalid-syntax")
    place = entry.get("location")
    line = int(place.get("row", 1)) if isinstance(place, dict) else 1
    path = in_repository(str(entry["filename"]), copy)
    category = _category_of_rule(code)
    severity: Severity = (
        "error" if code.startswith(_PREFIXES_OF_ERRORS) else "note" if category == "style" else "warning"
    )
    return CodeFinding(path, line, f"ruff/{code}", category, severity, str(entry["message"]))


def _category_of_rule(code: str) -> Category:
    for begins, category in _CATEGORY_OF_PREFIX:
        if code.startswith(begins):
            return category
    return "style"
