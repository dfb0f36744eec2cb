"""Call by which work reports its progress."""

from typing import Protocol


class Advance(Protocol):
    """Called after each step."""

    def __call__(self, done: int, total: int, line: str, *, important: bool = False) -> None:
        """Report the number of finished steps, and a message about the last one, which may contain untrusted text."""
