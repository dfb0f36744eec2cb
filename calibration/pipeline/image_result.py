"""The image of a run, as its results tell of it."""

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class ImageResult:
    """What the stages build and promote did."""

    reference: str
    """What the containers of this run were made from."""
    key: str
    """The hash of everything that goes into it."""
    built: bool
    """False where it was found, and nothing was built."""
    digest: str | None = None
    """In the registry; None where it was not pushed."""
    seconds: float = 0.0
    promoted: tuple[str, ...] = ()
    """The tags that the digest got because the verdict was pass."""

    @property
    def document(self) -> dict[str, Any]:
        """Its entry in ``results.json``."""
        return {**vars(self), "promoted": list(self.promoted)}

    @classmethod
    def of_document(cls, entry: dict[str, Any]) -> "ImageResult":
        """The result of an entry in ``results.json``.

        Raises:
            KeyError, TypeError: it is none.
        """
        return cls(**{**entry, "promoted": tuple(entry["promoted"])})
