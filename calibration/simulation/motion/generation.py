"""Motions that calibrate well: every sensor sees every pose, the images are covered, some views partial, from a seed.

Poses are drawn in front of the cameras; those that every sensor sees and that run into nothing are
candidates; of them the motion takes one after the other the one that leaves the calibrated transforms
the least uncertain, as the engine's own covariance tells. A motion is written with few digits and
played from those, so that the last bits of a machine's arithmetic do not show.
"""

from pathlib import Path

import numpy as np

from calibration.errors import InputError, UndeterminedError
from calibration.geometry.types import Array, BoolArray
from calibration.simulation.motion.candidates import Candidates, find_candidates
from calibration.simulation.motion.information import information
from calibration.simulation.motion.sequence import GENERATE, Motion, pose_count, read_motion
from calibration.simulation.placement import Placement, place
from calibration.simulation.system import System

PRIOR = 0.1
"""What is known before the first pose, as a standard deviation, so that there is a covariance from the start;
in rad and in the length that translations are measured in."""
_DIGITS = 6  # of a score: what differs by less is rounding, and the first of equal ones is taken


def choose(
    information: Array, parameters: int, partial: Array, share: float, cells: BoolArray, count: int
) -> list[int]:
    """The indices of the best poses, one after the other, as many as asked for if there are so many.

    Each next pose is the one after which the calibrated parameters have the least variance (the
    trace of their covariance: A-optimality, F. Pukelsheim, "Optimal design of experiments", 1993)
    among those with partial views or those without, as the share of partial views so far asks for;
    and among those that show the pattern where no pose has shown it, while there are any.

    Args:
        information: (N, D, D), what each pose tells about D parameters, in units that compare.
        parameters: how many of the D are calibrated; the others, after them, come along.
        partial: (N,), the share of each pose's views that are partial.
        share: that of the motion.
        cells: (N, C), the places where each pose shows the pattern.
        count: how many poses are wanted.
    """
    chosen: list[int] = []
    in_part = partial > 0
    left = np.ones(len(information), bool)
    shown = np.zeros(cells.shape[1], bool)
    known = np.eye(information.shape[-1]) / PRIOR**2
    while len(chosen) < count and left.any():
        wanted_in_part = bool(partial[chosen].sum() < share * len(chosen))
        pool = _narrowed(left, in_part == wanted_in_part)
        pool = _narrowed(pool, np.any(cells & ~shown, axis=-1))
        index = np.flatnonzero(pool)
        best = int(index[_variance(known + information[index], parameters).argmin()])
        chosen.append(best)
        left[best] = False
        shown |= cells[best]
        known = known + information[best]
    return chosen


def _narrowed(pool: BoolArray, wish: BoolArray) -> BoolArray:
    """Those of the pool (N,) that fulfil a wish (N,); all of it where none does."""
    some: BoolArray = pool & wish
    return some if some.any() else pool


def _variance(information: Array, parameters: int) -> Array:
    """The sum of the variances (N,) of the first parameters, to so many digits that machines agree."""
    variance = np.linalg.inv(information).diagonal(axis1=1, axis2=2)[:, :parameters].sum(-1)
    unit = 10.0 ** (np.floor(np.log10(variance)) + 1 - _DIGITS)
    rounded: Array = np.round(variance / unit) * unit
    return rounded


def generate_motion(system: System, count: int, seed: int) -> Motion:
    """A motion of so many poses, each seen by every sensor.

    Raises:
        InputError: the system has no camera, nothing in it moves, or too few poses were found.
    """
    if not system.cameras:
        raise InputError(f"a motion of {system.name} cannot be generated: it has no camera")
    candidates = find_candidates(system, count, seed)
    best = _best(system, candidates, count) if len(candidates) >= count else range(len(candidates))
    if len(best) < count:
        raise InputError(
            f"found {len(best)} poses of {system.name} that every sensor sees, expected {count}; "
            "widen distance_m, tilt_deg or roll_deg under motion in its simulation.yml"
        )
    return candidates.motion.take(best)


def _best(system: System, candidates: Candidates, count: int) -> list[int]:
    """The indices of the candidates that make the motion.

    Where the engine can calibrate nothing of the system, they cover the images and are random otherwise.
    """
    placement = place(system, candidates.motion)
    try:
        found = information(system, placement)
    except UndeterminedError:
        nothing = np.zeros((len(candidates), 1, 1))
        return choose(nothing, 1, candidates.partial, system.motion.partial, candidates.cells, count)
    unit = found.units(_distance(system, placement))
    chosen = choose(
        unit[:, None] * found.each * unit,
        found.calibrated,
        candidates.partial[found.poses],
        system.motion.partial,
        candidates.cells[found.poses],
        count,
    )
    best: list[int] = found.poses[chosen].tolist()
    return best


def _distance(system: System, placement: Placement) -> float:
    """The mean distance of patterns from the cameras, m: what an angle moves by its sine, a translation moves."""
    distances: list[Array] = [
        np.linalg.norm(placement.pattern_in(camera, pattern)[:, :3, 3], axis=-1)
        for pattern in system.patterns
        for camera in system.cameras
    ]
    return float(np.mean(distances))


def named_motion(name: str, system: System | None, seed: int) -> Motion:
    """The motion of a file, or a generated one where the name is ``generate:N`` and there is a system.

    Raises:
        InputError: the file cannot be read, or too few poses are seen by every sensor.
    """
    if system is None or not name.startswith(GENERATE):
        return read_motion(Path(name))
    return generate_motion(system, pose_count(name), seed)
