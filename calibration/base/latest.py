"""Cache of one entry, for keys of which many in a row are often equivalent."""

from collections.abc import Callable
from typing import Generic, TypeVar

_Key = TypeVar("_Key")
_Value = TypeVar("_Value")


class Latest(Generic[_Key, _Value]):
    """Cache of one entry: the latest key and its value."""

    def __init__(self, same: Callable[[_Key, _Key], bool]) -> None:
        """Begin empty; ``same`` returns whether two keys have the same value."""
        self._same = same
        self._kept: tuple[_Key, _Value] | None = None

    def of(self, key: _Key, make: Callable[[], _Value]) -> _Value:
        """Return the value of a key: that of the latest one if they are the same, else a new one, which is kept.

        Whatever ``make`` raises is passed on, and leaves the entry as it was.
        """
        if self._kept is not None and self._same(self._kept[0], key):
            return self._kept[1]
        value = make()
        self._kept = key, value
        return value
