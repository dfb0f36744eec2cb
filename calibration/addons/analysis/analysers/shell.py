"""Analyser shellcheck: shell scripts."""

import re
from collections.abc import Sequence
from pathlib import PurePosixPath

from calibration.addons.analysis.analysers.analyser import Analyser, arguments, in_repository
from calibration.addons.analysis.copies import Copy
from calibration.addons.analysis.finding import Category, CodeFinding, Severity
from calibration.addons.analysis.programs import json_output, program, run_program

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
                found += [_finding_of_entry(entry, copy) for entry in json_output(self.name, result)["comments"]]
        return found


def _finding_of_entry(entry: dict[str, object], copy: Copy) -> CodeFinding:
    level, code = str(entry["level"]), int(str(entry["code"]))
    category: Category = "unused code" if code == 2034 else "compatibility" if 3000 <= code < 4000 else "error-prone"
    if level == "style":
        category = "style"
    path, line = in_repository(str(entry["file"]), copy), int(str(entry["line"]))
    severity = _SEVERITY_OF_LEVEL.get(level, "note")
    return CodeFinding(path, max(line, 1), f"shellcheck/SC{code}", category, severity, str(entry["message"]))
