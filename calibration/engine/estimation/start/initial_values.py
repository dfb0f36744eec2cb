"""Values of all blocks by the dataset, before the patterns' poses are known."""

from collections.abc import Sequence

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.start.build import Setup
from calibration.engine.estimation.start.linear_start import Sight, place_gauge_patterns
from calibration.engine.geometry.transforms import translation


def initial_values(setup: Setup, sights: Sequence[Sight] | None = None) -> Values:
    """Return the transforms of the first collection, and the nominal parameters of joints and intrinsics.

    Patterns have no pose yet, unless they are fixed.

    Args:
        setup: the problem.
        sights: those of the problem (`sights_of`); computed if None.
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
    return place_gauge_patterns(setup, tuple(values), sights)
