"""The usual mistakes, planted in good recordings of others: is each red, and named by the first reason?

``python -m benchmarks.trust.mistakes`` prints every one. A recording is a line in `recordings.RECORDINGS`, a mistake
one in `usual.MISTAKES`.
"""

from collections.abc import Iterator
from dataclasses import dataclass

from benchmarks.rows import Bar, Row
from benchmarks.trust.mistakes.judging import Told, told
from benchmarks.trust.mistakes.recordings import RECORDINGS, Document, missing
from benchmarks.trust.mistakes.usual import MISTAKES, Mistake


@dataclass(frozen=True)
class Case:
    """A recording with a mistake, or without one, and what is said of it."""

    recording: str
    mistake: Mistake | None
    told: Told

    @property
    def is_right(self) -> bool:
        """Whether the verdict is the right one: a mistake is red and named first, a good recording is green."""
        if self.mistake is None:
            return self.told.verdict == "green"
        return self.told.verdict != "green" and any(word in self.told.reason for word in self.mistake.words)

    def line(self) -> str:
        """The row of the table of all cases."""
        name = self.mistake.name if self.mistake else "none"
        right = "right" if self.is_right else "WRONG"
        return f"{name:48} {self.recording:22} {self.told.verdict:8} {right}  {self.told.reason[:150]}"


def cases(quick: bool = False, only: str = "") -> Iterator[Case]:
    """Judge every recording as it is, and with each mistake that can be made in it."""
    for name, (kind, read) in RECORDINGS.items():
        document: Document = read()
        fitting = [each for each in MISTAKES if kind in each.kinds and (not each.only or name in each.only)]
        for mistake in [None, *fitting[:: 4 if quick else 1]]:
            if only in f"{mistake.name if mistake else 'none'} {name}":
                yield Case(name, mistake, told(mistake.plant(document) if mistake else document))


def rows(quick: bool) -> Iterator[Row]:
    """Good recordings that are red, mistakes that are green, and those that the first reason names."""
    if reason := missing():
        yield Row("trust/usual mistakes", skipped=reason)
        return
    found = list(cases(quick))
    good, wrong = ([each for each in found if (each.mistake is None) == is_good] for is_good in (True, False))
    accused = [each for each in good if not each.is_right]
    green = [each for each in wrong if each.told.verdict == "green"]
    unnamed = [each for each in wrong if not each.is_right]
    named = 1 - len(unnamed) / len(wrong)
    yield Row("trust/good recordings red", len(accused), f"of {len(good)}", Bar(high=0), _listed(accused))
    yield Row("trust/usual mistakes green", len(green), f"of {len(wrong)}", Bar(high=0), _listed(green))
    yield Row("trust/usual mistakes named first", named, f"of {len(wrong)}", Bar(low=0.9), _listed(unnamed))


def _listed(some: list[Case]) -> str:
    return "; ".join(f"{each.mistake.name if each.mistake else each.told.reason}, {each.recording}" for each in some)
