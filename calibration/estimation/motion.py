"""A motion that parameters of a block make together: what directions of uncertainty are told in."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Motion:
    """A translation or rotation of a pose, or what one parameter of a joint or a camera does."""

    kind: Literal["translation", "rotation", "ray"]
    """"ray": of a camera's intrinsics."""
    length: int = 1
    """How many parameters make it: the three axes of a pose, or one."""
    parameter: str = ""
    """The name of the parameter; empty for a pose."""
    unit: float = 1.0
    """The change of the parameters that counts as one: the size of the pattern (m), 1 rad, or what a camera has."""
    extent: float = 1.0
    """How far that moves the block, m or rad."""
