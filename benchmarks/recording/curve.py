"""A measured quantity over one property of a recording."""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Curve:
    """Measured quantity over one property of a recording."""

    name: str
    """Name of the curve in the rows of the benchmark."""
    title: str
    property_name: str
    """The property that is varied, with its unit."""
    unit: str
    """Name of the measured quantity, with its unit."""
    x: Sequence[float]
    y: Sequence[float]
    """Infinite where nothing could be determined or found."""
    recommended: tuple[float, float]
    """Range of the property that docs/recording.md recommends."""
