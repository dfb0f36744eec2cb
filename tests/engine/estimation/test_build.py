"""A dataset as a problem: chains that multiply to the true poses, fixed blocks, the gauge."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.base import InputError, UndeterminedError
from calibration.engine.dataset.modalities import RGB
from calibration.engine.dataset.model import CornerLabels, Labels, PointLabels, Sensor
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.start.build import build
from calibration.engine.geometry.transforms import translation
from tests.engine.estimation.scenes import Scene, board, camera, errors, pose, relabelled, true_values
from tests.engine.estimation.systems import (
    ALL,
    camera_and_lidar,
    eye_in_hand,
    eye_to_hand,
    hand_and_world,
    ring,
    stereo,
    two_bodies,
    two_patterns,
)


@pytest.mark.parametrize("scene", ALL)
def test_the_chains_are_the_ways_from_sensors_to_patterns(scene):
    dataset = ALL[scene]().dataset()
    setup = build(dataset)
    values = true_values(setup)
    seen = 0
    for group in setup.problem.groups:
        pattern = dataset.patterns[group.pattern]
        expected = dataset.transform(dataset.sensors[group.sensor].frame, pattern.link) @ translation(pattern.centre)
        np.testing.assert_allclose(setup.problem.poses(group, values), expected[group.collections], atol=1e-12)
        seen += len(group.collections)
    assert seen == sum(len(collection.labels) for collection in dataset.collections)


@pytest.mark.parametrize(
    ("scene", "held", "shared", "local", "gauge"),
    [
        (stereo, ["world-left"], ["world-right"], ["board"], "left"),
        (ALL["anchored stereo"], ["world-right"], ["world-left"], ["board"], None),
        (eye_to_hand, [], ["world-cam", "board"], [], None),
        (eye_in_hand, [], ["flange-mount", "board"], [], None),
        (two_bodies, [], ["body_a-a", "body_b-b"], ["board"], None),
        (camera_and_lidar, ["world-cam"], ["world-lidar"], ["board"], None),
        (hand_and_world, ["world-static"], ["flange-mount", "world-base", "board"], [], None),
        (two_patterns, ["world-left"], ["world-right", "still"], ["board"], None),
        (lambda: replace(two_patterns(), anchored=None), ["world-left"], ["world-right", "still"], ["board"], "left"),
    ],
)
def test_blocks(scene, held, shared, local, gauge):
    setup = build(scene().dataset())
    blocks = setup.problem.blocks
    assert [b.name for b in blocks if b.held] == held
    assert [blocks[i].name for i in setup.problem.shared] == shared
    assert [blocks[i].name for i in setup.problem.local] == local
    assert setup.gauge == gauge
    assert [setup.block(block.edge) for block in blocks] == list(range(len(blocks)))


def test_constants_are_multiplied_out_and_kept_once_where_they_do_not_change():
    (group,) = build(eye_in_hand(5).dataset()).problem.groups
    before, (mount, pattern) = group.chain.before, group.chain.links
    assert before.shape == (4, 4)  # camera to mount
    assert mount.after.shape == (5, 4, 4)  # flange to world
    assert pattern.after is None
    left, right = build(stereo(5).dataset()).problem.groups
    for chain in (left.chain, right.chain):
        assert chain.before is None
        assert [link.after for link in chain.links] == [None, None]


def test_the_gauge_is_free_when_a_static_rig_sees_a_fixed_pattern():
    scene = stereo(4)
    still = {**scene.transforms, ("world", "board_link"): scene.transforms["world", "board_link"][0]}
    moving_frame = {**still, ("world", "other"): np.stack([pose(i, 0, 0) for i in range(4)])}
    setup = build(replace(scene, transforms=moving_frame, patterns=[board(fixed=True)]).dataset())
    assert setup.gauge == "left"


def test_the_gauge_is_fixed_by_a_pattern_with_a_known_pose():
    """On a robot that moves: the pattern in the world is what the sensors are relative to."""
    scene = stereo(6)
    T_world_robot = np.stack([pose(0.05 * i, 0, 0, 0.1 * i, 0.05 * i * i, 0) for i in range(6)])
    transforms = {
        ("world", "robot"): T_world_robot,
        ("robot", "left"): scene.transforms["world", "left"],
        ("robot", "right"): scene.transforms["world", "right"],
        ("world", "board_link"): scene.transforms["world", "left"] @ pose(0, 0, 1.5),
    }
    sensors = [camera("left", "robot"), camera("right", "robot")]
    assert build(Scene(transforms, sensors, [board(fixed=True)]).dataset()).gauge is None


def test_a_rig_that_a_robot_carries_is_free_when_it_sees_a_moving_pattern():
    """For any motion of the robot: the pattern's pose per collection is degenerate with it."""
    scene = stereo(6)
    T_world_robot = np.stack([pose(0.05 * i, 0, 0, 0.1 * i, 0, 0) for i in range(6)])
    transforms = {
        ("world", "robot"): T_world_robot,
        ("robot", "left"): scene.transforms["world", "left"],
        ("robot", "right"): scene.transforms["world", "right"],
        ("world", "board_link"): T_world_robot @ scene.transforms["world", "board_link"],
    }
    sensors = [camera("left", "robot"), camera("right", "robot")]
    assert build(Scene(transforms, sensors, [board()]).dataset()).gauge == "left"


def test_the_first_sensor_is_fixed():
    scene = stereo(4)
    assert build(replace(scene, sensors=scene.sensors[::-1]).dataset()).gauge == "right"


@pytest.mark.parametrize("order", [(0, 1, 2, 3, 4), (0, 4, 2, 1, 3), (1, 3, 0, 2, 4)])
def test_cameras_are_linked_by_those_between_them_in_any_order(order):
    scene = replace(ring(8), anchored=None)
    setup = build(replace(scene, sensors=[scene.sensors[k] for k in order]).dataset())
    assert setup.gauge == f"c{order[0]}"


def test_two_sensors_on_one_mount_share_its_block():
    scene = eye_in_hand(5)
    transforms = {**scene.transforms, ("mount", "second"): pose(0.05, 0, 0) @ scene.transforms["mount", "cam"]}
    second = Sensor("second", RGB, "second", "flange", "mount", camera("second").camera)
    setup = build(replace(scene, sensors=[*scene.sensors, second], transforms=transforms).dataset())
    assert [b.name for b in setup.problem.blocks] == ["flange-mount", "board"]
    assert len(setup.problem.groups) == 2
    for anchored in ("cam", "second"):
        dataset = replace(scene, sensors=[*scene.sensors, second], transforms=transforms, anchored=anchored).dataset()
        with pytest.raises(UndeterminedError, match="nothing to calibrate"):
            build(dataset)


def test_parts_of_a_system_that_do_not_see_the_same_are_each_determined_by_an_arm():
    """Two arms, each with its own pattern in the world: nothing links them, and nothing has to."""
    one, two = eye_in_hand(8, seed=1), eye_in_hand(8, seed=2)
    transforms = dict(one.transforms)
    other = {"flange": "flange_2", "mount": "mount_2", "cam": "cam_2", "board_link": "b_link"}
    for (parent, child), T in two.transforms.items():
        transforms[other.get(parent, parent), other[child]] = T
    sensors = [*one.sensors, Sensor("cam_2", RGB, "cam_2", "flange_2", "mount_2", one.sensors[0].camera)]
    scene = replace(one, transforms=transforms, sensors=sensors, patterns=[*one.patterns, board("b", fixed=True)])
    setup = build(replace(scene, sees=lambda s, p, _: (s == "cam") == (p == "board")).dataset())
    assert setup.gauge is None


def test_corners_of_a_sensor_without_intrinsics_are_an_error():
    dataset = stereo(4).dataset()
    sensors = {**dataset.sensors, "right": replace(dataset.sensors["right"], camera=None)}
    with pytest.raises(InputError, match="sensor 'right' has corner labels but no camera intrinsics"):
        build(replace(dataset, sensors=sensors))


@pytest.mark.parametrize("scene", [stereo, eye_in_hand])
def test_a_pattern_that_hangs_on_another_pattern_is_an_error(scene):
    base = scene(4)
    transforms = {**base.transforms, ("board_link", "second_link"): pose(0.4, 0.0, 0.0)}
    patterns = [*base.patterns, board("second", "board_link", fixed=True)]
    with pytest.raises(InputError, match="'second': its parent 'board_link' hangs on pattern 'board'"):
        build(replace(base, transforms=transforms, patterns=patterns).dataset())


def test_points_at_the_origin_are_rays_without_a_return():
    def lost(i: int, _: str, label: Labels) -> Labels:
        if i != 1 or isinstance(label, CornerLabels):
            return label
        points = label.points.copy()
        points[[0, 7]] = 0.0
        return PointLabels(points, np.array([0, len(points) - 1]))

    dataset = relabelled(camera_and_lidar(4, border=False).dataset(), lost)
    (ranges, border) = next(g for g in build(dataset).problem.groups if g.sensor == "lidar").terms
    count = len(dataset.collections[1].labels["board", "lidar"].points)
    assert ranges.counts[1] == count - 2
    assert border.counts.tolist() == [0, 1, 0, 0]
    assert max(errors(dataset, calibrate(dataset).transforms)) < 0.05
