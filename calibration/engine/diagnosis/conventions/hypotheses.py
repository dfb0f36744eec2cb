"""All hypotheses, by what they are about. A new one is a function here, or its line in one that is there."""

from collections.abc import Callable, Iterator

from calibration.engine.diagnosis.conventions.arm_hypotheses import joints, other_rotations, robot_poses, scales
from calibration.engine.diagnosis.conventions.hypothesis import Hypothesis
from calibration.engine.diagnosis.conventions.recording import Recording
from calibration.engine.diagnosis.conventions.sensor_hypotheses import (
    exchanged,
    left_handed,
    lenses,
    shifted,
    turned_boards,
)

Hypotheses = Callable[[Recording], Iterator[Hypothesis]]

HYPOTHESES_BY_PRIORITY: tuple[Hypotheses, ...] = (
    robot_poses,
    shifted,
    exchanged,
    scales,
    left_handed,
    turned_boards,
    lenses,
    joints,
)
"""In the order in which equally good ones are named."""
SLOW_HYPOTHESES: tuple[Hypotheses, ...] = (other_rotations,)
"""Tried where none of the others fits."""
