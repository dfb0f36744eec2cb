"""A measured quantity over one property of a recording."""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Curve:
    """Measured quantity over one property of a recording."""

    name: str
    """Of the picture's file, and of the rows."""
    title: str
    property_name: str
    """What is varied, with its unit."""
    unit: str
    """Of the measured quantity."""
    x: Sequence[float]
    y: Sequence[float]
    """Infinite where nothing could be determined or found."""
    recommended: tuple[float, float]
    """Range of the property that docs/recording.md recommends."""
