"""What was made of the latest of several keys, of which many in a row are often the same."""

from collections.abc import Callable
from typing import Generic, TypeVar

_Key = TypeVar("_Key")
_Made = TypeVar("_Made")


class Latest(Generic[_Key, _Made]):
    """What was made of the latest key."""

    def __init__(self, same: Callable[[_Key, _Key], bool]) -> None:
        """Begin with nothing; ``same`` returns whether two keys lead to the same."""
        self._same = same
        self._kept: tuple[_Key, _Made] | None = None

    def of(self, key: _Key, make: Callable[[], _Made]) -> _Made:
        """Return what was made of the latest key if this one is the same, else make it; an error is not kept."""
        if self._kept is not None and self._same(self._kept[0], key):
            return self._kept[1]
        made = make()
        self._kept = key, made
        return made
