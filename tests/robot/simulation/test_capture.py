"""Captures depend on the seed, the pose and the sensor alone; labels match the truth."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.base import InputError
from calibration.engine.dataset.model import CornerLabels
from calibration.engine.geometry.transforms import apply, from_xyz_rpy, inverse
from calibration.robot.labelling.detection import NotDetected
from calibration.robot.labelling.points import PatternPoints
from calibration.robot.simulation import capture as capture_module
from calibration.robot.simulation.capture import Capture, capture
from calibration.robot.simulation.kinematics import Play, place, play
from calibration.robot.simulation.motion import Motion, moving_joints, moving_model
from calibration.robot.simulation.scene import Box, Scene
from calibration.robot.simulation.sensors import SimulatedDepthCamera, lidars
from calibration.robot.simulation.system import System
from tests.robot.simulation.conftest import SYSTEMS, own_motion


def played(system: System, motion: Motion | None = None, seed: int = 5) -> Play:
    return play(system, motion or own_motion(system), seed)


def content(found: Capture) -> list[bytes]:
    """Every number that the sensors made, and that was made of them."""
    arrays = [*found.data.values()]
    for labels in found.labels.values():
        arrays += [labels.ids, labels.pixels] if isinstance(labels, CornerLabels) else []
        arrays += [labels.on_pattern, labels.on_border] if isinstance(labels, PatternPoints) else []
    return [array.tobytes() for array in arrays]


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("name", SYSTEMS)
def test_a_pose_is_the_same_in_any_part_of_the_motion(systems: dict[str, System], name: str) -> None:
    system = systems[name]
    motion = own_motion(system)
    whole = content(capture(played(system, motion), 3))
    assert content(capture(played(system, motion.take(list(range(4)))), 3)) == whole
    assert content(capture(played(system, motion.take([9, 1, 2, 3])), 3)) == whole
    assert content(capture(played(system, motion, seed=6), 3)) != whole


def test_a_sensor_does_not_change_what_another_one_sees(systems: dict[str, System]) -> None:
    system = systems["rlbot"]
    config = system.configuration
    alone = replace(
        system,
        sensors={"rgb_left": system.sensors["rgb_left"]},
        configuration=replace(config, sensors={"rgb_left": config.sensors["rgb_left"]}),
    )
    a, b = capture(played(system), 0), capture(played(alone), 0)
    np.testing.assert_array_equal(a.data["rgb_left"], b.data["rgb_left"])


@pytest.mark.parametrize("name", SYSTEMS)
def test_labels_lie_on_the_truth(systems: dict[str, System], name: str) -> None:
    system = systems[name]
    it = played(system)
    found = capture(it, 0)
    assert not any(isinstance(labels, NotDetected) for labels in found.labels.values())
    for camera in system.cameras:
        pattern, labels = "pattern_1", found.corners(camera)["pattern_1"]
        T_camera_pattern = it.true.pattern_in(camera, pattern)[0]
        true = system.cameras[camera].camera.project(apply(T_camera_pattern, system.patterns[pattern].corners))
        error = labels.pixels - true[labels.ids]
        assert np.sqrt((error**2).sum(-1).mean()) < 0.2
        assert np.abs(T_camera_pattern - found.estimates[pattern, camera]).max() < 0.01
    for (pattern, lidar), points in found.labels.items():
        if not isinstance(points, PatternPoints):
            continue
        flat = apply(inverse(it.true.pattern_in(lidar, pattern)[0]), found.data[lidar][points.on_pattern])
        assert np.abs(flat[:, 2]).max() < 0.05


def with_depth(system: System) -> System:
    """t2rgb, whose left camera measures depths instead."""
    depth = SimulatedDepthCamera(system.cameras["left_camera"].camera)
    return replace(system, sensors={**system.sensors, "left_camera": depth})


def test_labels_of_a_depth_camera_lie_on_the_truth(systems: dict[str, System]) -> None:
    system = with_depth(systems["t2rgb"])
    it = played(system)
    found = capture(it, 0)
    assert found.data["right_camera"].ndim == 3
    points, depth = found.labels["pattern_1", "left_camera"], found.data["left_camera"]
    assert isinstance(points, PatternPoints)
    assert len(points.on_border) > 100
    assert set(points.on_border) <= set(points.on_pattern)
    camera = system.sensors["left_camera"].intrinsics
    assert camera is not None
    v, u = np.divmod(points.on_pattern, camera.width)
    rays = np.column_stack([camera.normalise(np.stack([u, v], -1).astype(float)), np.ones(len(u))])
    T_pattern_camera = inverse(it.true.pattern_in("left_camera", "pattern_1")[0])
    on_board = apply(T_pattern_camera, rays * (depth[v, u] * 1e-4)[:, None])
    assert np.abs(on_board[:, 2]).max() < 0.1
    assert np.sqrt((on_board[:, 2] ** 2).mean()) < 0.02
    low, high = (f(system.patterns["pattern_1"].outline, axis=0) for f in (np.min, np.max))
    assert ((on_board[:, :2] > low - 0.05) & (on_board[:, :2] < high + 0.05)).all()


def test_a_depth_camera_sees_the_same_in_any_part_of_the_motion(systems: dict[str, System]) -> None:
    system = with_depth(systems["t2rgb"])
    motion = own_motion(system)
    whole = content(capture(played(system, motion), 3))
    assert content(capture(played(system, motion.take([9, 1, 2, 3])), 3)) == whole
    assert content(capture(played(system, motion, seed=6), 3)) != whole


def test_a_box_before_a_camera_hides_corners(systems: dict[str, System]) -> None:
    system = systems["t2rgb"]
    motion = own_motion(system).take([0])
    placement = place(system, motion)
    camera, board = placement.sensors["left_camera"][0, :3, 3], placement.patterns["pattern_1"][0]
    centre = board @ np.append(system.patterns["pattern_1"].centre, 1)
    middle = from_xyz_rpy((camera + centre[:3]) / 2, np.zeros(3))
    hiding = replace(system, scene=Scene(boxes=(Box(middle, np.full(3, 0.15)),)))
    before, after = (capture(played(world, motion), 0).labels for world in (system, hiding))
    key = ("pattern_1", "left_camera")
    all_of_it, rest = before[key], after[key]
    assert isinstance(all_of_it, CornerLabels)
    assert isinstance(rest, NotDetected) or len(rest.ids) < len(all_of_it.ids)
    assert isinstance(after["pattern_1", "right_camera"], CornerLabels)


def test_a_lidar_finds_the_pattern_though_its_mount_is_off(systems: dict[str, System]) -> None:
    """The guess comes by the camera through the designed robot; the LiDAR is 3 cm and 2 degrees elsewhere."""
    it = played(bent(systems["rlbot"]))
    found = capture(it, 0)
    points = found.labels["pattern_1", "lidar_right"]
    assert isinstance(points, PatternPoints)
    flat = apply(inverse(it.true.pattern_in("lidar_right", "pattern_1")[0]), found.data["lidar_right"])
    assert np.abs(flat[points.on_pattern, 2]).max() < 0.05
    assert it.nominal is not it.true
    assert np.abs(it.nominal.sensors["lidar_right"] - it.true.sensors["lidar_right"]).max() > 0.01


def test_a_pattern_that_sways_is_elsewhere_for_each_sensor(systems: dict[str, System]) -> None:
    system = systems["t2rgb"]
    motion = own_motion(system).take([0, 1])
    still, swaying = (capture(played(s, motion), 0) for s in (system, replace(system, sway=0.004)))
    assert still.movement == 0
    assert 0.0005 < swaying.movement < 0.03
    assert capture(played(replace(system, sway=0.004), motion), 0).movement == swaying.movement
    arm = systems["riwbot"]
    assert capture(played(replace(arm, sway=0.004)), 0).movement == 0  # nothing holds it but the arm


def test_a_motion_that_does_not_fit(systems: dict[str, System]) -> None:
    joints, model = moving_joints({"elbow_joint": np.zeros(2)}), moving_model(np.eye(4)[None])
    with pytest.raises(InputError, match="found no position and orientation; pattern 'pattern_1' of t2rgb moves"):
        played(systems["t2rgb"], joints)
    with pytest.raises(InputError, match="every pattern of riwbot is fixed; expected joints"):
        played(systems["riwbot"], model)


def test_a_sensor_inside_a_wall(systems: dict[str, System]) -> None:
    system = systems["t2rgb"]
    eye = place(system, own_motion(system)).sensors["left_camera"][0]
    inside = replace(system, scene=Scene(boxes=(Box(eye, np.ones(3)),)))
    with pytest.raises(InputError, match=r"motion\.json: a sensor is in a box or under the ground in pose 1"):
        played(inside)


def bent(system: System) -> System:
    """rlbot with a LiDAR that is elsewhere than it was designed to be, and a camera that is, too."""
    errors = {
        "lidar_right_base_link": from_xyz_rpy([0.02, -0.02, 0.01], [0, 0.02, 0.03]),
        "rgb_left_link": from_xyz_rpy([-0.01, 0.02, 0.0], [0.01, 0, 0.02]),
    }
    joints = tuple(
        replace(joint, T_parent_joint=joint.T_parent_joint @ errors.get(joint.child, np.eye(4)))
        for joint in system.robot.joints
    )
    return replace(system, robot=replace(system.robot, joints=joints))


def test_the_expected_pose_of_the_pattern_is_from_the_camera_and_the_nominal_robot(
    systems: dict[str, System], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[np.ndarray] = []

    def watched(points: np.ndarray, pattern: object, T_sensor_pattern: np.ndarray) -> NotDetected:
        asked.append(T_sensor_pattern)
        return NotDetected("watched")

    monkeypatch.setattr(lidars, "label_points", watched)
    it = played(bent(systems["rlbot"]))
    found = capture(it, 0)
    T_camera_pattern = found.estimates["pattern_1", "rgb_left"]
    nominal = it.nominal.sensors
    np.testing.assert_allclose(
        asked, [inverse(nominal["lidar_right"][0]) @ nominal["rgb_left"][0] @ T_camera_pattern], atol=1e-12
    )


def test_the_expected_pose_is_from_the_camera_with_most_corners(systems: dict[str, System]) -> None:
    it = played(systems["t2rgb"])
    found = capture(it, 0)
    few, many = CornerLabels(np.arange(30), np.zeros((30, 2))), CornerLabels(np.arange(40), np.zeros((40, 2)))
    left, right = ("pattern_1", "left_camera"), ("pattern_1", "right_camera")
    for labels, camera in (({left: few, right: many}, "right_camera"), ({left: many, right: few}, "left_camera")):
        T = capture_module._estimated_pattern_pose(it, 0, "pattern_1", labels, found.estimates)
        np.testing.assert_allclose(T, it.nominal.sensors[camera][0] @ found.estimates["pattern_1", camera])
    unknown = capture_module._estimated_pattern_pose(it, 0, "pattern_1", {left: NotDetected("x")}, {})
    np.testing.assert_array_equal(unknown, it.nominal.patterns["pattern_1"][0])


def test_only_the_pattern_that_is_moved_sways(systems: dict[str, System]) -> None:
    system = systems["t2rgb"]
    config = system.configuration
    fixed = replace(config.patterns["pattern_1"], name="fixed", fixed=True)
    both = replace(
        system,
        sway=0.01,
        patterns={**system.patterns, "fixed": fixed.pattern()},
        configuration=replace(config, patterns={**config.patterns, "fixed": fixed}),
    )
    it = played(system)
    poses = it.true.patterns["pattern_1"]
    it = replace(it, system=both, true=replace(it.true, patterns={"pattern_1": poses, "fixed": poses}))
    moved, still = capture_module._boards_for_sensor(it, 0, "left_camera")
    assert np.abs(moved.T_world_pattern - poses[0]).max() > 1e-4
    np.testing.assert_array_equal(still.T_world_pattern, poses[0])
