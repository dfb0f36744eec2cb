"""Columns of fixed parameters, against poses that are computed with changed parameters."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from calibration.base.arrays import Array
from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.covariance.fixed_inputs import (
    Cause,
    SeenGroup,
    causes,
    joint_axis,
    seen_groups,
    velocities,
)
from calibration.engine.estimation.options import Assumptions
from calibration.engine.estimation.start.build import build
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import from_xyz_rpy, local, retract, transform, translation
from tests.engine.estimation import systems
from tests.engine.estimation.scenes import Scene

STEP = 1e-6


def seen(dataset: Dataset) -> list[SeenGroup]:
    problem = build(dataset).problem
    return seen_groups(
        dataset, problem.groups, [poses(dataset, group.sensor, group.pattern) for group in problem.groups]
    )


def poses(dataset: Dataset, sensor: str, pattern: str) -> Array:
    """``T_sensor_pattern`` of the views, the pattern's frame in the middle of its corners."""
    views = [i for i, _ in dataset.detections(pattern, sensor)]
    T = dataset.transform(dataset.sensors[sensor].frame, dataset.patterns[pattern].link)[views]
    return T @ translation(dataset.patterns[pattern].centre)


def arm_edge(dataset: Dataset) -> tuple[str, str]:
    return next(e for e, T in dataset.transforms.items() if np.abs(T - T[0]).max() > 1e-3)


def of_kind(found: Sequence[Cause], kind: str) -> Cause:
    return next(each for each in found if each.kind == kind)


def moved_by(dataset: Dataset, groups: Sequence[SeenGroup], changed: Array) -> list[Array]:
    """By how much the poses of the views move, as twists in the patterns' frames, with another transform of the arm."""
    other = dataset.with_transforms({arm_edge(dataset): changed})
    moved = []
    for group in groups:
        after = poses(other, group.sensor.name, group.pattern.name)
        moved.append(local(group.T, after) / STEP)
    return moved


@pytest.mark.parametrize("scene", [systems.eye_to_hand, systems.eye_in_hand])
def test_a_link_turns_what_hangs_on_it(scene: Callable[..., Scene]) -> None:
    """The pattern, or the camera: its chain goes against the link."""
    dataset = scene(6, seed=2).dataset(2)
    groups = seen(dataset)
    cause = of_kind(causes(dataset, groups, Assumptions(), {}, {}), "link")
    T = dataset.transforms[arm_edge(dataset)]
    for k in range(6):
        expected = moved_by(dataset, groups, retract(T, STEP * np.eye(6)[k]))
        for group, twist in zip(groups, expected, strict=True):
            assert callable(cause.effect)
            columns = cause.effect(group)
            assert columns is not None
            np.testing.assert_allclose(columns[:, :6, k], twist, atol=1e-4)


@pytest.mark.parametrize("scene", [systems.eye_to_hand, systems.eye_in_hand])
def test_lengths_of_an_arm_scale_its_translations(scene: Callable[..., Scene]) -> None:
    dataset = scene(6, seed=2).dataset(2)
    groups = seen(dataset)
    cause = of_kind(causes(dataset, groups, Assumptions(), {}, {}), "lengths")
    T = dataset.transforms[arm_edge(dataset)].copy()
    T[:, :3, 3] *= 1 + STEP
    for group, twist in zip(groups, moved_by(dataset, groups, T), strict=True):
        assert callable(cause.effect)
        columns = cause.effect(group)
        assert columns is not None
        np.testing.assert_allclose(columns[:, :6, 0], twist, atol=1e-4)


@pytest.mark.parametrize("prismatic", [False, True])
def test_the_axis_of_a_joint_is_found_from_its_motion(prismatic: bool) -> None:
    axis, positions = np.array([0.6, 0.0, 0.8]), np.array([0.3, -0.8, 1.1, 0.0])
    steps = positions[:, None] * axis
    motion = translation(steps) if prismatic else transform(rotations.exp(steps), np.zeros(3))
    found = joint_axis(from_xyz_rpy([0.1, 0.2, 0.3], [0.4, 0.5, 0.6]) @ motion)
    assert found is not None
    twist, q, is_prismatic = found
    sign = np.sign(twist[:3] @ axis + twist[3:] @ axis)
    assert is_prismatic == prismatic
    np.testing.assert_allclose(sign * twist[slice(0, 3) if prismatic else slice(3, 6)], axis, atol=1e-9)
    np.testing.assert_allclose(sign * q, positions - positions.mean(), atol=1e-9)


def test_a_motion_about_several_axes_has_none() -> None:
    turns = np.random.default_rng(1).normal(size=(5, 3))
    assert joint_axis(transform(rotations.exp(turns), np.zeros(3))) is None
    assert joint_axis(np.broadcast_to(np.eye(4), (5, 4, 4))) is None


def test_velocities_carry_a_pose_to_the_next() -> None:
    """A pattern with constant velocity is at the pose predicted by one step."""
    dataset = systems.eye_to_hand(6, seed=2).dataset(2)
    [group] = seen(dataset)
    step = np.array([1e-3, 2e-3, -1e-3, 1e-3, 0.0, 2e-3])
    T = [group.T[0]]
    for _ in range(len(group.T) - 1):
        T.append(retract(T[-1], step))
    even = replace(group, T=np.stack(T))
    along = velocities(even)
    for i in range(len(T) - 1):
        np.testing.assert_allclose(along[i], step, atol=5e-6)
