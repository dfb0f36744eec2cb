"""Derivatives of tasks, against a robot that carries them out with each parameter off."""

from collections.abc import Callable

import numpy as np
import pytest

from calibration.base.arrays import Array
from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.covariance.fixed_inputs import LINK_KIND
from calibration.engine.estimation.covariance.result import Solution
from calibration.engine.estimation.options import Options
from calibration.engine.geometry.transforms import retract, translation
from calibration.engine.tasks.placed_task import UNIT_PER_SI, PlacedTask, place_task
from calibration.engine.tasks.robot_task import RobotTask
from calibration.engine.tasks.task_errors import errors_of_robot, task_jacobian
from tests.engine.estimation import systems

STEP = 1e-6
NEAR = ((0.1, -0.1, 1.2), (-0.2, 0.15, 2.0))
Case = tuple[Callable[[], Dataset], Options, RobotTask]
CASES: dict[str, Case] = {
    "hand and eye": (
        lambda: systems.eye_in_hand(pixel_noise=0.2).dataset(),
        Options(),
        RobotTask("a", seen_by=("cam",), frame="flange", distance=0.7),
    ),
    "over the world": (
        lambda: systems.eye_in_hand(pixel_noise=0.2).dataset(),
        Options(),
        RobotTask("a", seen_by=("cam",), frame="world", points_in="cam", points=NEAR, collections=("001", "004")),
    ),
    "stereo": (
        lambda: systems.stereo(pixel_noise=0.2).dataset(),
        Options(),
        RobotTask("a", seen_by=("left", "right"), distance=2.0),
    ),
    "in an image, free intrinsics": (
        lambda: systems.covering(pixel_noise=0.2).dataset(),
        Options(intrinsics=("all",)),
        RobotTask("a", seen_by=("c0",), image="c1", distance=1.5),
    ),
    "LiDAR in an image": (
        lambda: systems.camera_and_lidar(pixel_noise=0.2, range_noise=0.01).dataset(),
        Options(),
        RobotTask("a", seen_by=("lidar",), image="cam", distance=20.0),
    ),
    "direction": (
        lambda: systems.camera_and_lidar(pixel_noise=0.2, range_noise=0.01).dataset(),
        Options(),
        RobotTask("a", seen_by=("lidar",), frame="cam", points=((0.3, 0.2, 9.0),), limit_deg=0.1),
    ),
    "tip of an arm with joints": (
        lambda: systems.jointed_arm(
            free={"j3": ("origin_yaw", "position_bias")[:1], "j5": ("position_bias",)}
        ).dataset(),
        Options(),
        RobotTask("a", of="j6", frame="base", box=None, points=((0.0, 0.02, 0.2),)),
    ),
    "ground": (
        lambda: systems.eye_to_hand(pixel_noise=0.2).dataset(),
        Options(),
        RobotTask("a", seen_by=("cam",), plane="base", points=((0.2, 0.1, 0.0), (0.0, 0.3, 0.0))),
    ),
    "board in the hand": (
        lambda: systems.eye_to_hand(pixel_noise=0.2).dataset(),
        Options(),
        RobotTask("a", of="board_link", frame="world", points=((0.1, 0.0, 0.0),)),
    ),
}


def stepped(solution: Solution, placed: PlacedTask, column: int, by: float) -> tuple[Dataset, Array | None]:
    """What the robot uses if one parameter is off; None for one that no task depends on."""
    problem, dataset = solution.setup.problem, solution.dataset
    for block, at in problem.shared_parameters.items():
        if at.start <= column < at.stop:
            own, edge = problem.blocks[block], problem.blocks[block].edge
            d = by * np.eye(at.stop - at.start)[column - at.start]
            if own.intrinsics is not None:
                camera = dataset.sensors[own.intrinsics.sensor].camera
                assert camera
                moved = camera.with_intrinsics(own.intrinsics.moved(camera.intrinsics, d))
                return dataset.with_cameras({own.intrinsics.sensor: moved}), None
            assert edge
            if own.joint is not None:
                name = next(name for name, joint in dataset.joints.items() if joint.edge == edge)
                return dataset.with_joints({name: own.joint.moved(dataset.joints[name].values, d)}), None
            centre = next((p.centre for p in dataset.patterns.values() if p.edge == edge), np.zeros(3))
            T = retract(dataset.transforms[edge] @ translation(centre), d) @ translation(-centre)
            return dataset.with_transforms({edge: T}), None
    cause, at = next(each for each in solution.model.placed() if each[1].start <= column < each[1].stop)
    if cause.kind == LINK_KIND:
        edge = next(edge for edge in dataset.transforms if "-".join(edge) == cause.subject)
        d = by * np.eye(6)[column - at.start]
        return dataset.with_transforms({edge: retract(dataset.transforms[edge], d)}), None
    changes = {} if callable(cause.effect) else {name: w for (_, name), w in cause.effect[column - at.start].items()}
    sensor = dataset.sensors.get(cause.subject)
    if sensor is None or not changes:
        return dataset, None
    if sensor.camera is None:
        (pose, _), dataset_T = placed.at, dataset.transform(sensor.frame, placed.frame, placed.collections)
        p = np.einsum("nij,nj->ni", dataset_T[pose][:, :3, :3], placed.places) + dataset_T[pose][:, :3, 3]
        far, turned = np.linalg.norm(p, axis=-1, keepdims=True), np.zeros_like(p)
        if "elevation" in changes:  # beams that are lower than the robot believes
            flat = np.hypot(p[:, 0], p[:, 1])
            angle = np.arctan2(p[:, 2], flat) + by * changes["elevation"]
            turned = (
                far * np.stack([np.cos(angle) * p[:, 0] / flat, np.cos(angle) * p[:, 1] / flat, np.sin(angle)], -1) - p
            )
        return dataset, turned - by * (changes.get("bias", 0.0) * p / far + changes.get("scale", 0.0) * p)
    if not set(changes) <= set(sensor.camera.parameters):
        return dataset, None
    values = sensor.camera.intrinsics + by * np.array([changes.get(name, 0.0) for name in sensor.camera.parameters])
    return dataset.with_cameras({sensor.name: sensor.camera.with_intrinsics(values)}), None


@pytest.mark.parametrize("case", CASES)
def test_derivatives_are_those_of_a_robot(case: str) -> None:
    """By every calibrated parameter, by intrinsics, links and ranges that are held."""
    make, options, task = CASES[case]
    solution = calibrate(make(), options).solution
    placed = place_task(solution.dataset, task)
    J = task_jacobian(solution, placed)
    kinds = {LINK_KIND, "camera_info", "focal length", "range bias", "range scale", "beam elevation"}
    columns = list(range(solution.model.shared))
    held = [each for each in solution.model.placed() if each[0].kind in kinds and " and " not in each[0].subject]
    columns += [k for _, at in held for k in range(at.start, at.stop)]
    checked = 0
    for column in columns:
        scale = STEP / max(1e-3, float(np.abs(J[:, :, column]).max()) / UNIT_PER_SI[task.unit])
        both = [
            errors_of_robot(placed, solution.dataset, *stepped(solution, placed, column, sign * scale))
            for sign in (1, -1)
        ]
        numeric = UNIT_PER_SI[task.unit] * (both[0] - both[1]) / (2 * scale)
        size = max(1.0, float(np.abs(numeric).max()))
        np.testing.assert_allclose(J[:, :, column], numeric, atol=2e-4 * size, err_msg=str(column))
        checked += bool(np.abs(numeric).max() > 1e-9)
    assert checked >= 6
