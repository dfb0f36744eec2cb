"""Generation of motions that calibrate well, from a seed: every sensor sees every pose, and the images are covered.

Poses are drawn in front of the cameras; those that every sensor sees without collisions are candidates. The
motion is chosen greedily: the next pose is the candidate that reduces the uncertainty of the calibrated
transforms most, by the engine's own covariance. A motion is written with few digits and
played from these, so that rounding errors of the arithmetic have no effect.
"""

from pathlib import Path

import numpy as np

from calibration.base.arrays import Array
from calibration.base.errors import InputError, UndeterminedError
from calibration.engine.estimation.solve.design import choose
from calibration.robot.simulation.motion.candidates import Candidates, find_candidates
from calibration.robot.simulation.motion.information import information
from calibration.robot.simulation.motion.sequence import GENERATED_PREFIX, Motion, pose_count, read_motion
from calibration.robot.simulation.placement import Placement, place
from calibration.robot.simulation.system import System


def generate_motion(system: System, count: int, seed: int) -> Motion:
    """Generate a motion of this many poses, each seen by every sensor.

    Raises:
        InputError: the system has no camera, nothing in it moves, or too few poses were found.
    """
    if not system.cameras:
        raise InputError(f"a motion of {system.name} cannot be generated: it has no camera")
    candidates = find_candidates(system, count, seed)
    best = _best_candidates(system, candidates, count) if len(candidates) >= count else range(len(candidates))
    if len(best) < count:
        raise InputError(
            f"found {len(best)} poses of {system.name} that every sensor sees, expected {count}; "
            "widen distance_m, tilt_deg or roll_deg under motion in its simulation.yml"
        )
    return candidates.motion.take(best)


def _best_candidates(system: System, candidates: Candidates, count: int) -> list[int]:
    """Return the indices of the candidates that make the motion.

    If the engine can calibrate nothing of the system, they cover the images and are random otherwise.
    """
    placement = place(system, candidates.motion)
    try:
        found = information(system, placement)
    except UndeterminedError:
        nothing = np.zeros((len(candidates), 1, 1))
        return choose(nothing, 1, candidates.partial, system.motion.partial, candidates.cells, count)
    unit = found.units(_mean_pattern_distance(system, placement))
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


def _mean_pattern_distance(system: System, placement: Placement) -> float:
    """Return the mean distance of patterns from the cameras, m: it relates rotations to translations."""
    distances: list[Array] = [
        np.linalg.norm(placement.pattern_in(camera, pattern)[:, :3, 3], axis=-1)
        for pattern in system.patterns
        for camera in system.cameras
    ]
    return float(np.mean(distances))


def named_motion(name: str, system: System | None, seed: int) -> Motion:
    """Read a motion from a file, or generate one if the name is ``generate:N`` and there is a system.

    Raises:
        InputError: the file cannot be read, or too few poses are seen by every sensor.
    """
    if system is None or not name.startswith(GENERATED_PREFIX):
        return read_motion(Path(name))
    return generate_motion(system, pose_count(name), seed)
