"""Motion of a block by its parameters: the directions in which uncertainty is reported."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Motion:
    """Translation or rotation of a pose, or the effect of one parameter of a joint or a camera."""

    kind: Literal["translation", "rotation", "ray"]
    """"ray": of a camera's intrinsics."""
    length: int = 1
    """Number of its parameters: the three axes of a pose, or one."""
    parameter: str = ""
    """Name of the parameter; empty for a pose."""
    unit: float = 1.0
    """Unit of the parameters: the size of the pattern (m), 1 rad, or a camera's own."""
    extent: float = 1.0
    """Displacement of the block by one unit, m or rad."""
