"""Annotation: a message at a file and line of the commit."""

import enum
from dataclasses import dataclass
from pathlib import Path


class Level(enum.StrEnum):
    """Severity of an annotation."""

    ERROR = "error"
    WARNING = "warning"
    NOTICE = "notice"


@dataclass(frozen=True)
class Annotation:
    """Message of an annotation, with its file and line if it has them."""

    message: str
    level: Level = Level.ERROR
    file: str | Path | None = None
    line: int | None = None
    """Line number, the first is 1."""
    title: str | None = None
