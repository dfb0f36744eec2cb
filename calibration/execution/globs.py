"""Patterns for paths as a shell has them: ``*``, ``?``, ``[...]``, and ``**`` for any number of folders."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fnmatch import translate
from functools import cached_property

_WILDCARD = re.compile(r"[*?\[]")


@dataclass(frozen=True)
class Glob:
    """A path in a container that may have wildcards."""

    path: str
    """Absolute, without ``.`` and ``..``."""

    @cached_property
    def source(self) -> str:
        """What has to be read to find it: the path itself, or the last folder before a wildcard."""
        fixed = self._parts if self._split == len(self._parts) else self._parts[: self._split]
        return "/" + "/".join(fixed)

    def landing(self, inside: Sequence[str]) -> tuple[str, ...] | None:
        """Where something below :attr:`source` lands, relative to the last folder without a wildcard.

        Args:
            inside: its path relative to `source`, in parts; none for `source` itself.

        Returns:
            None for what is not asked for. A folder stands for all that is in it.
        """
        if self._split == len(self._parts):
            return (*self._parts[-1:], *inside)
        return tuple(inside) if self._matches(inside) else None

    @cached_property
    def _parts(self) -> tuple[str, ...]:
        return tuple(part for part in self.path.split("/") if part)

    @cached_property
    def _split(self) -> int:
        """How many parts there are before the first with a wildcard."""
        return next((i for i, part in enumerate(self._parts) if _WILDCARD.search(part)), len(self._parts))

    @cached_property
    def _patterns(self) -> tuple[re.Pattern[str] | None, ...]:
        """An expression for each part from the first wildcard on; None for ``**``."""
        parts = self._parts[self._split :]
        parts += ("*",) if parts[-1] == "**" else ()  # at the end it stands for files too
        return tuple(None if part == "**" else _pattern(part) for part in parts)

    def _matches(self, inside: Sequence[str]) -> bool:
        """Whether the path, or a folder that it is in, is what the pattern names."""
        # Every number of patterns that may be used up after each part: linear, however many ** there are.
        states = self._past_stars({0})
        for part in inside:
            if len(self._patterns) in states:
                return True
            states = self._past_stars({after for state in states for after in self._step(state, part)})
        return len(self._patterns) in states

    def _step(self, state: int, part: str) -> Iterator[int]:
        pattern = self._patterns[state]
        if pattern is None:
            if not part.startswith("."):
                yield state  # ** takes this folder too
        elif pattern.match(part):
            yield state + 1

    def _past_stars(self, states: set[int]) -> set[int]:
        for state in sorted(states):
            following = state
            while following < len(self._patterns) and self._patterns[following] is None:
                following += 1
                states.add(following)
        return states


def _pattern(part: str) -> re.Pattern[str]:
    # as in a shell, a wildcard at the beginning does not stand for the dot of a hidden file
    hidden = "" if part.startswith(".") else r"(?!\.)"
    return re.compile(hidden + translate(part))
