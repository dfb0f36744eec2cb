"""Notes of a conversion: every setting that is dropped or changed is reported."""

import enum
import re
from collections.abc import Iterator
from dataclasses import dataclass, field

from calibration.base.text import one_line, shorten

MARKED_TEXT = re.compile("\ue000[VSD]([^\ue001]*)\ue001")
"""Mark of a variable or of data in a text that is not written yet: see `substitution`."""


class NoteKind(enum.StrEnum):
    """Outcome for a part of the Rigelfile."""

    LOST = "not carried over"
    CHANGED = "works otherwise here"
    TO_DO = "to do"


@dataclass(frozen=True)
class Note:
    """Note for the user about one part of the Rigelfile."""

    kind: NoteKind
    where: str
    """Position in the Rigelfile: ``jobs.build.with.load``."""
    text: str

    def __str__(self) -> str:
        return f"{self.where}: {self.text}"


@dataclass
class Notes:
    """Notes of a conversion, without duplicates."""

    found: list[Note] = field(default_factory=list)

    def __iter__(self) -> Iterator[Note]:
        return iter(self.found)

    def lost(self, where: str, why: str) -> None:
        """Note a setting that cannot be converted."""
        self._add_note(NoteKind.LOST, where, why)

    def changed(self, where: str, how: str) -> None:
        """Note a setting that is converted with a different meaning."""
        self._add_note(NoteKind.CHANGED, where, how)

    def to_do(self, where: str, what: str) -> None:
        """Note a setting that the user has to add, because the Rigelfile does not contain it."""
        self._add_note(NoteKind.TO_DO, where, what)

    def _add_note(self, kind: NoteKind, where: str, text: str) -> None:
        where, text = (MARKED_TEXT.sub(r"${\1}", part) for part in (where.removeprefix("."), text))
        note = Note(kind, shorten(one_line(where), 160), shorten(one_line(text), 400))
        if note not in self.found:
            self.found.append(note)
