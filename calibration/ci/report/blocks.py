"""Blocks of a report, each of which can be formatted for the log and as Markdown."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from calibration.base.text import one_line
from calibration.ci.workflow.markdown import code_block, escape_markdown

MOST_LINES = 1000
"""Default limit of lines or rows of a block; files of results contain all."""


def cut(lines: Sequence[str], most: int, rest: str) -> tuple[str, ...]:
    """Return the first lines, and one with the number of the remaining lines and the file that contains them."""
    return tuple(lines) if len(lines) <= most else (*lines[:most], f"and {len(lines) - most} more, see {rest}")


@dataclass(frozen=True, kw_only=True)
class Block(ABC):
    """Part of a report, shown in the log, the summary, or both."""

    title: str = ""
    folded: bool = False
    """Whether the summary shows only the title until a reader opens it."""
    only: Literal["log", "summary"] | None = None
    """The only place that shows it; None for both."""
    brief: bool = False
    """Whether a comment on a pull request shows it too; tables only."""

    @abstractmethod
    def plain(self) -> str:
        """Return it as lines for the log, without the title; empty if there is nothing to show."""

    @abstractmethod
    def markdown(self) -> str:
        """Return it as Markdown, without the title; empty if there is nothing to show."""


@dataclass(frozen=True)
class Text(Block):
    """A paragraph."""

    text: str

    def plain(self) -> str:
        """Return the paragraph on one line."""
        return one_line(self.text)

    def markdown(self) -> str:
        """Return the paragraph, escaped."""
        return f"{escape_markdown(self.text)}\n" if self.text else ""


@dataclass(frozen=True)
class Lines(Block):
    """A list of lines."""

    lines: tuple[str, ...]
    most: int = MOST_LINES
    """Maximum number of lines that are shown."""
    rest: str = "results.json"
    """File that contains the remaining lines."""

    def plain(self) -> str:
        """Return the lines, each safe to print."""
        return "\n".join(map(one_line, cut(self.lines, self.most, self.rest)))

    def markdown(self) -> str:
        """Return a list."""
        return "".join(f"- {escape_markdown(line)}\n" for line in cut(self.lines, self.most, self.rest))


@dataclass(frozen=True)
class Code(Block):
    """Output of a program, or commands to copy."""

    text: str

    def plain(self) -> str:
        """Return the text, with each line safe to print."""
        return "\n".join(map(one_line, self.text.splitlines()))

    def markdown(self) -> str:
        """Return a fenced code block."""
        return code_block(self.text) if self.text else ""
