"""Analyser yamllint: YAML."""

import re
from collections.abc import Sequence

from calibration.addons.analysis.analysers.analyser import Analyser, arguments, in_repository
from calibration.addons.analysis.copies import Copy
from calibration.addons.analysis.finding import Category, CodeFinding, Severity
from calibration.addons.analysis.programs import module, run_program

_LINE_OF_OUTPUT = re.compile(r"(.+?):(\d+):(\d+): \[(error|warning)\] (.*?)(?: \(([a-z-]+)\))?")
_DEFAULT_CONFIGURATION = "{extends: relaxed, rules: {line-length: disable, new-line-at-end-of-file: disable}}"
_RULES_OF_ERRORS = ("syntax", "key-duplicates", "anchors")
"""Rules of errors that change the meaning; the others are style."""


class Yamllint(Analyser):
    """Syntax, duplicate keys, and style of YAML; the team's settings select the rules, if there are any."""

    name = "yamllint"
    settings = (".yamllint", ".yamllint.yml", ".yamllint.yaml")

    def wants(self, path: str, copy: Copy) -> bool:
        """Select YAML files by suffix, if they are UTF-8."""
        return path.endswith((".yml", ".yaml")) and copy.is_utf8(path)

    def findings(self, copy: Copy, files: Sequence[str], seconds: float) -> list[CodeFinding]:
        """Run yamllint and parse its output."""
        own = any((copy.root / name).is_file() for name in self.settings)
        command = [
            *module("yamllint"),
            "--format",
            "parsable",
            *([] if own else ["--config-data", _DEFAULT_CONFIGURATION]),
        ]
        # 1 is also the exit code of a Python program that crashes: then there is a traceback
        result = run_program(self.name, [*command, "--", *arguments(files)], copy.root, seconds, (0, 1))
        if "Traceback" in result.errors:
            run_program(self.name, [*command, "--", *arguments(files)], copy.root, seconds, (0,))
        found = (_LINE_OF_OUTPUT.fullmatch(line) for line in result.output.splitlines())
        return [_finding_of_line(match, copy) for match in found if match]


def _finding_of_line(match: re.Match[str], copy: Copy) -> CodeFinding:
    rule = match[6] or "syntax"
    category: Category = "error-prone" if rule in _RULES_OF_ERRORS else "style"
    severity: Severity = "error" if rule in _RULES_OF_ERRORS else "note"
    return CodeFinding(in_repository(match[1], copy), int(match[2]), f"yamllint/{rule}", category, severity, match[5])
