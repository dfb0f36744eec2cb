"""A solver that is given a rig and a start: its solution, or why there is none."""

from collections.abc import Callable
from dataclasses import dataclass

from benchmarks.rig_arrays import RigArrays
from calibration.base.arrays import Array


@dataclass(frozen=True, eq=False)
class Solution:
    """Result of a solver, and its time."""

    T_camera_world: Array
    T_world_board: Array
    seconds: float
    intrinsics: Array | None = None
    """(C, 9), if they were free."""


class PeerError(Exception):
    """A peer gave no solution."""


Peer = Callable[[RigArrays], Solution]
