"""Datasets of a system's motion with exact labels, or with Gaussian noise in them; nothing is rendered."""

from dataclasses import replace

import numpy as np

from calibration.engine.dataset.model import CornerLabels, Dataset, Labels
from calibration.robot.simulation.kinematics import place, stream
from calibration.robot.simulation.motion_generation import draw_motion, generate_motion
from calibration.robot.simulation.motion_information import expected_dataset
from calibration.robot.simulation.sensors.camera import CORNER_NOISE
from calibration.robot.simulation.system import System


def exact_labels(system: System, seed: int = 1) -> Dataset:
    """The exact labels of a motion, and the true transforms and joints."""
    if len(system.sensors) > 2 and system.moved_pattern:  # no pose is seen by all of many cameras around a pattern
        motion = draw_motion(system, system.moved_pattern, 40, stream(seed))
    else:
        motion = generate_motion(system, 20, seed)
    return expected_dataset(system, place(system, motion))


def as_designed(dataset: Dataset, system: System) -> Dataset:
    """The dataset with the joints of the description, as it would be collected."""
    return dataset.with_joints({name: system.nominal.movable[name].values() for name in dataset.joints})


def noisy(dataset: Dataset, system: System, seed: int) -> Dataset:
    """The dataset with noise in corners and ranges."""
    rng = np.random.default_rng(seed)

    def moved(sensor: str, labels: Labels) -> Labels:
        if isinstance(labels, CornerLabels):
            return replace(labels, pixels=labels.pixels + CORNER_NOISE * rng.normal(size=labels.pixels.shape))
        ranges = np.linalg.norm(labels.points, axis=-1)
        error = system.sensors[sensor].noise * rng.normal(size=len(ranges))
        return replace(labels, points=labels.points * (1 + error / ranges)[:, None])

    collections = tuple(
        replace(c, labels={(pattern, sensor): moved(sensor, label) for (pattern, sensor), label in c.labels.items()})
        for c in dataset.collections
    )
    return replace(dataset, collections=collections)
