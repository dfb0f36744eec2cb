"""Shell patterns for paths: ``*``, ``?``, ``[...]``, and ``**`` for any number of folders."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fnmatch import translate
from functools import cached_property

_ANY_WILDCARD = r"[*?\[]"


@dataclass(frozen=True)
class Glob:
    """A path in a container that may contain wildcards."""

    path: str
    """Absolute, without ``.`` and ``..``."""

    @cached_property
    def source(self) -> str:
        """Path to read: the path itself, or its last folder without a wildcard."""
        fixed = (
            self._path_parts
            if self._parts_before_wildcard == len(self._path_parts)
            else self._path_parts[: self._parts_before_wildcard]
        )
        return "/" + "/".join(fixed)

    def landing(self, inside: Sequence[str]) -> tuple[str, ...] | None:
        """Return the target of a path below :attr:`source`, relative to the last folder without a wildcard.

        Args:
            inside: parts of the path relative to `source`; empty for `source` itself.

        Returns:
            None if the pattern does not match. A folder matches with all its content.
        """
        if self._parts_before_wildcard == len(self._path_parts):
            return (*self._path_parts[-1:], *inside)
        return tuple(inside) if self._matches_inside(inside) else None

    @cached_property
    def _path_parts(self) -> tuple[str, ...]:
        return tuple(part for part in self.path.split("/") if part)

    @cached_property
    def _parts_before_wildcard(self) -> int:
        """Number of parts before the first wildcard."""
        return next(
            (i for i, part in enumerate(self._path_parts) if re.search(_ANY_WILDCARD, part)), len(self._path_parts)
        )

    @cached_property
    def _part_patterns(self) -> tuple[re.Pattern[str] | None, ...]:
        """A pattern for each part from the first wildcard; None for ``**``."""
        parts = self._path_parts[self._parts_before_wildcard :]
        parts += ("*",) if parts[-1] == "**" else ()  # at the end it matches files too
        return tuple(None if part == "**" else _pattern_of_part(part) for part in parts)

    def _matches_inside(self, inside: Sequence[str]) -> bool:
        """Return whether the pattern matches the path, or a folder that contains it."""
        # Simulates the states of a nondeterministic automaton: linear in the length, for any number of **.
        states = self._past_stars({0})
        for part in inside:
            if len(self._part_patterns) in states:
                return True
            states = self._past_stars({after for state in states for after in self._next_states(state, part)})
        return len(self._part_patterns) in states

    def _next_states(self, state: int, part: str) -> Iterator[int]:
        pattern = self._part_patterns[state]
        if pattern is None:
            if not part.startswith("."):
                yield state  # ** also matches this folder
        elif pattern.match(part):
            yield state + 1

    def _past_stars(self, states: set[int]) -> set[int]:
        for state in sorted(states):
            following = state
            while following < len(self._part_patterns) and self._part_patterns[following] is None:
                following += 1
                states.add(following)
        return states


def _pattern_of_part(part: str) -> re.Pattern[str]:
    # as in a shell, a leading wildcard does not match the dot of a hidden file
    hidden = "" if part.startswith(".") else r"(?!\.)"
    return re.compile(hidden + translate(part))
