"""The poses that a motion may choose from: every sensor sees them, and they run into nothing."""

import math
from dataclasses import dataclass

import numpy as np

from calibration.dataset.pattern import Pattern
from calibration.geometry.types import Array, BoolArray
from calibration.simulation.motion.clearance import is_clear
from calibration.simulation.motion.drawing import draw_motion
from calibration.simulation.motion.sequence import Motion, joined
from calibration.simulation.motion.views import (
    camera_views,
    centred,
    depth_camera_detects,
    lidar2d_detects,
    lidar_detects,
)
from calibration.simulation.placement import Placement, place
from calibration.simulation.random_streams import stream
from calibration.simulation.system import System

_FOR_EACH = 12  # candidates for each pose of the motion
_AT_LEAST = 120  # candidates for a short motion
_DRAWN = 20  # poses in a round for each pose of the motion; most have a sensor that does not see them
_ROUNDS = 20  # after which a system that seldom sees enough of its pattern makes do


@dataclass(frozen=True, eq=False)
class Candidates:
    """N poses, and what the cameras see at each."""

    motion: Motion
    """Through all of them."""
    partial: Array
    """(N,): the share of the cameras that see only a part of the pattern."""
    cells: BoolArray
    """(N, C): in which cells of the cameras' images, one camera's after the other's, there are corners."""

    def __len__(self) -> int:
        return len(self.partial)


def find_candidates(system: System, pattern: Pattern, count: int, seed: int) -> Candidates:
    """Poses for a motion of so many to choose from, of those seen whole and of those seen in part as it needs them.

    Poses are drawn in rounds until there are enough. There may be fewer, or none.

    Raises:
        InputError: nothing moves the pattern before a camera.
    """
    wanted = max(_FOR_EACH * count, _AT_LEAST)
    share = 0.0 if pattern.kind == "chessboard" else system.motion.partial  # which is found whole or not at all
    found: list[Candidates] = []
    missing = {True: math.ceil(share * wanted), False: math.ceil((1 - share) * wanted)}  # seen in part, or not
    for number in range(_ROUNDS):
        drawn = draw_motion(system, pattern, max(_DRAWN * count, _AT_LEAST), stream(seed, "motion", number))
        seen = _seen(system, pattern, drawn)
        kept: list[int] = []
        for in_part in missing:
            some = np.flatnonzero((seen.partial > 0) == in_part)[: missing[in_part]]
            missing[in_part] -= len(some)
            kept += some.tolist()
        found.append(_take(seen, sorted(kept)))
        if not any(missing.values()):
            break
    return Candidates(
        joined([each.motion for each in found]),
        np.concatenate([each.partial for each in found]),
        np.concatenate([each.cells for each in found]),
    )


def _seen(system: System, pattern: Pattern, motion: Motion) -> Candidates:
    """The poses of a motion that every sensor sees and that run into nothing; what is quick to tell goes first."""
    motion, placement = _only(system, motion, centred(system, pattern.name, place(system, motion)))
    motion, placement = _only(system, motion, is_clear(system, pattern, placement))
    for lidar in system.lidars:
        motion, placement = _only(system, motion, lidar_detects(system, lidar, pattern.name, placement))
    for lidar in system.lidars2d:
        motion, placement = _only(system, motion, lidar2d_detects(system, lidar, pattern.name, placement))
    for depth_camera in system.depth_cameras:
        motion, placement = _only(system, motion, depth_camera_detects(system, depth_camera, pattern.name, placement))
    views = {name: camera_views(system, name, pattern.name, placement) for name in system.cameras}
    seen = Candidates(
        motion,
        np.mean([view.partial for view in views.values()], axis=0),
        np.concatenate([view.cells(system.cameras[name].camera) for name, view in views.items()], -1),
    )
    return _take(seen, np.flatnonzero(np.all([view.detectable for view in views.values()], axis=0)).tolist())


def _only(system: System, motion: Motion, which: BoolArray) -> tuple[Motion, Placement]:
    """Some of the poses of a motion, and where everything stands there."""
    some = motion.take(np.flatnonzero(which))
    return some, place(system, some)


def _take(candidates: Candidates, index: list[int]) -> Candidates:
    return Candidates(candidates.motion.take(index), candidates.partial[index], candidates.cells[index])
