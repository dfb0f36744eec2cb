from dataclasses import replace

import numpy as np
import pytest

from calibration.base.errors import InputError
from calibration.engine.geometry.transforms import apply, from_xyz_rpy
from calibration.robot.simulation.motion.drawing import draw_motion, draw_poses, filling_distances, within_ranges
from calibration.robot.simulation.placement import place
from calibration.robot.simulation.random_streams import stream
from calibration.robot.simulation.system import MotionRanges, System
from tests.robot.simulation.conftest import SYSTEMS


def test_drawn_poses_keep_to_the_ranges(systems: dict[str, System]) -> None:
    camera, pattern = systems["rlbot"].cameras["rgb_left"].camera, systems["rlbot"].patterns["pattern_1"]
    ranges = MotionRanges(distance=(1, 2), tilt=0.5, roll=0.2)
    T = draw_poses(camera, pattern, ranges, 500, stream(0))
    centre = apply(T, pattern.centre[None])[:, 0]
    distance = np.linalg.norm(centre, axis=-1)
    assert distance.min() >= 1 - 1e-9
    assert distance.max() <= 2 + 1e-9
    assert camera.contains(camera.project(centre)).all()
    tilt = np.arccos((T[:, :3, 2] * centre).sum(-1) / distance)
    assert 0.45 < tilt.max() <= 0.5 + 1e-9
    np.testing.assert_allclose(np.linalg.det(T), 1)


def test_poses_are_within_the_ranges_that_they_were_drawn_in(systems: dict[str, System]) -> None:
    camera, pattern = systems["rlbot"].cameras["rgb_left"].camera, systems["rlbot"].patterns["pattern_1"]
    ranges = MotionRanges(distance=(1, 2), tilt=0.5, roll=0.2)
    T = draw_poses(camera, pattern, ranges, 500, stream(0))
    wider = MotionRanges(distance=(1 - 1e-9, 2 + 1e-9), tilt=0.5 + 1e-7, roll=0.2 + 1e-7)
    assert within_ranges(T, camera, pattern, wider).all()
    assert 0.4 < within_ranges(T, camera, pattern, replace(wider, distance=(1.5, 2))).mean() < 0.6
    assert 0.4 < within_ranges(T, camera, pattern, replace(wider, tilt=0.25)).mean() < 0.6
    assert 0.4 < within_ranges(T, camera, pattern, replace(wider, roll=0.1)).mean() < 0.6
    behind = from_xyz_rpy((0, 0, 0), (0, np.pi, 0)) @ T
    assert not within_ranges(behind, camera, pattern, wider).any()
    beside = from_xyz_rpy((0, 0, 0), (0, 1.2, 0)) @ T
    assert not within_ranges(beside, camera, pattern, wider).any()


def test_distances_from_the_size_of_the_pattern(systems: dict[str, System]) -> None:
    camera, pattern = systems["rlbot"].cameras["rgb_left"].camera, systems["rlbot"].patterns["pattern_1"]
    low, high = filling_distances(camera, pattern)
    assert 1.2 < low < 1.6
    assert 3.5 < high < 4.2


@pytest.mark.parametrize("name", SYSTEMS)
def test_a_drawn_motion_brings_the_pattern_in_front_of_the_cameras(systems: dict[str, System], name: str) -> None:
    system = systems[name]
    pattern = system.patterns["pattern_1"]
    motion = draw_motion(system, pattern, 200, stream(1))
    assert len(motion) >= 100
    placement = place(system, motion)
    shown = np.zeros(len(motion), bool)
    for camera, simulated in system.cameras.items():
        centre = apply(placement.pattern_in(camera, "pattern_1"), pattern.centre[None])[:, 0]
        shown |= simulated.camera.contains(simulated.camera.project(centre))
        if len(system.cameras) == 1:
            low, high = system.motion.distance or filling_distances(simulated.camera, pattern)
            assert np.linalg.norm(centre, axis=-1).min() > low - 1e-5
            assert np.linalg.norm(centre, axis=-1).max() < high + 1e-5
    assert shown.mean() > 0.99  # positions are rounded, so a centre at the edge may leave the image


def test_joints_that_reach_few_poses_are_drawn_themselves(systems: dict[str, System]) -> None:
    system = systems["spjbot"]
    motion = draw_motion(system, system.patterns["pattern_1"], 50, stream(1))
    assert set(motion.joints) == set(system.robot.movable)
    for name, positions in motion.joints.items():
        joint = system.robot.movable[name]
        assert ((positions >= joint.lower) & (positions <= joint.upper)).all()
        assert np.ptp(positions) > 0.5 * (joint.upper - joint.lower)


def test_nothing_to_draw(systems: dict[str, System]) -> None:
    t2rgb, riwbot = systems["t2rgb"], systems["riwbot"]
    mounted = riwbot.patterns["pattern_1"]
    assert mounted.fixed
    tripod = next(name for name in t2rgb.robot.tree.frames if "link" in name)
    fixed = type(mounted)("p", mounted.kind, tripod, "world", True, mounted.corners, mounted.outline)
    with pytest.raises(InputError, match="pattern 'p' is fixed and no joint lies between it and a camera"):
        draw_motion(t2rgb, fixed, 10, stream(0))
