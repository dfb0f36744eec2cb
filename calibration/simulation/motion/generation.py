"""Motions that calibrate well: every sensor sees every pose, the images are covered, some views partial, from a seed.

Poses are drawn in front of the cameras; those that every sensor sees and that run into nothing are
candidates; of them the motion takes one after the other the one that leaves the calibrated transforms
the least uncertain, as the engine's own covariance tells. A motion is written with few digits and
played from those, so that the last bits of a machine's arithmetic do not show.
"""

from pathlib import Path

import numpy as np

from calibration.errors import InputError, UndeterminedError
from calibration.estimation.design import choose
from calibration.geometry.types import Array
from calibration.simulation.motion.candidates import Candidates, find_candidates
from calibration.simulation.motion.information import information
from calibration.simulation.motion.sequence import GENERATE, Motion, pose_count, read_motion
from calibration.simulation.placement import Placement, place
from calibration.simulation.system import System


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
