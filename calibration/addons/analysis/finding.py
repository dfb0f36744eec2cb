"""Finding of an analyser, in the common form of all analysers."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from calibration.base.records import field, result

Category = Literal[
    "error-prone",
    "security",
    "performance",
    "unused code",
    "complexity",
    "style",
    "documentation",
    "compatibility",
]
CATEGORIES: tuple[Category, ...] = Category.__args__  # type: ignore[attr-defined]
Severity = Literal["error", "warning", "note"]
SEVERITIES: tuple[Severity, ...] = Severity.__args__  # type: ignore[attr-defined]
_FORMATTING_CHARACTERS = re.compile(r"[\s,;()'\"\\]+")
"""Characters that formatters move, add and remove."""


@result
class CodeFinding:
    """Fault at a line of a file."""

    path: str = field("The file, in the repository.")
    line: int = field("The first line of the file is 1.")
    rule: str = field("The analyser and its rule: ruff/F401.")
    category: Category
    severity: Severity
    message: str

    @property
    def place(self) -> str:
        """File and line."""
        return f"{self.path}:{self.line}"


@dataclass(frozen=True)
class Located:
    """Finding with the content of its line, to match it after the line has moved."""

    finding: CodeFinding
    content: str
    """The line, without what formatters change; the message if the line is empty."""


def plain_content(text: str) -> str:
    """Return a text without spaces, line ends, quotes, commas and parentheses."""
    return _FORMATTING_CHARACTERS.sub("", text)


def located(finding: CodeFinding, lines: Sequence[str]) -> Located:
    """Return a finding with the content of its line; ``lines`` are those of its file."""
    text = lines[finding.line - 1] if 1 <= finding.line <= len(lines) else ""
    return Located(finding, plain_content(text) or finding.message)
