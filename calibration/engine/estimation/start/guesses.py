"""Initial values of a problem by its dataset's own transforms, as other software starts."""

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.solve.options import Options
from calibration.engine.estimation.start.build import Setup, build_with
from calibration.engine.estimation.start.linear_start import (
    LinearStart,
    linear_start,
    pattern_poses,
    place_gauge_patterns,
)
from calibration.engine.geometry.transforms import translation


def guess_of_dataset(setup: Setup) -> Values:
    """Return the transforms of the first collection, and the nominal parameters of joints and intrinsics.

    Patterns have no pose yet, unless they are fixed.
    """
    dataset, joints = setup.dataset, {joint.edge: joint.values for joint in setup.dataset.joints.values()}
    values: list[Array] = []
    for block in setup.problem.blocks:
        pattern = dataset.patterns.get(block.name)
        if block.intrinsics:
            values.append(block.intrinsics.camera.intrinsics)
        elif pattern and (not block.held or pattern.name in setup.gauge_patterns):
            shape = (setup.problem.collections, 4, 4) if block.per_collection else (4, 4)
            values.append(np.broadcast_to(np.eye(4), shape).copy())
        elif block.edge in joints:
            values.append(joints[block.edge])
        elif block.edge:
            T = dataset.transforms[block.edge] if block.per_collection else dataset.transform(*block.edge)[0]
            values.append(T @ translation(pattern.centre) if pattern else T)
    return place_gauge_patterns(setup, tuple(values))


def linear_problem(dataset: Dataset, options: Options) -> tuple[Setup, LinearStart]:
    """Build the problem of a dataset, and its linear start; what the labels leave open of that is the dataset's.

    Raises:
        UndeterminedError: as `build` and `linear_start`.
        InputError: likewise.
    """
    setup = build_with(dataset, options)
    return setup, linear_start(setup, guess_of_dataset(setup))


def guess_with_patterns(setup: Setup) -> Values:
    """Return the dataset's guess, with the patterns, as in ATOM, where the cameras see them from there.

    Raises:
        InputError: no camera sees a fixed pattern.
    """
    return pattern_poses(setup, guess_of_dataset(setup))
