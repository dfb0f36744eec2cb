"""What whoever converts a Rigelfile has to know: nothing is dropped in silence."""

import enum
import re
from collections.abc import Iterator
from dataclasses import dataclass, field

from calibration.workflow.text import one_line, shorten

MARK = re.compile("\ue000[VSD]([^\ue001]*)\ue001")
"""What stands for a variable or for data in a text that is not written yet: see `substitution`."""


class Kind(enum.StrEnum):
    """What came of a part of the Rigelfile."""

    LOST = "not carried over"
    CHANGED = "works otherwise here"
    TO_DO = "to do"


@dataclass(frozen=True)
class Note:
    """One thing to know."""

    kind: Kind
    where: str
    """In the Rigelfile: ``jobs.build.with.load``."""
    text: str

    def __str__(self) -> str:
        return f"{self.where}: {self.text}"


@dataclass
class Notes:
    """The notes of a conversion, each once."""

    found: list[Note] = field(default_factory=list)

    def __iter__(self) -> Iterator[Note]:
        return iter(self.found)

    def lost(self, where: str, why: str) -> None:
        """Something has no place here."""
        self._add(Kind.LOST, where, why)

    def changed(self, where: str, how: str) -> None:
        """Something is carried over, and does not mean quite the same."""
        self._add(Kind.CHANGED, where, how)

    def to_do(self, where: str, what: str) -> None:
        """Something that nobody can know from the Rigelfile."""
        self._add(Kind.TO_DO, where, what)

    def _add(self, kind: Kind, where: str, text: str) -> None:
        where, text = (MARK.sub(r"${\1}", part) for part in (where.removeprefix("."), text))
        note = Note(kind, shorten(one_line(where), 160), shorten(one_line(text), 400))
        if note not in self.found:
            self.found.append(note)
