from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.errors import InputError
from calibration.geometry import rotations
from calibration.geometry.transforms import apply
from calibration.simulation.collection.capture import collect
from calibration.simulation.motion.generation import draw_poses, filling_distances, generate_motion
from calibration.simulation.motion.sequence import Motion, motion_document, read_motion
from calibration.simulation.placement import place
from calibration.simulation.random_streams import stream
from calibration.simulation.scene import Box, Scene
from calibration.simulation.system import MotionRanges, System, read_system
from tests.simulation.conftest import DATASETS, SYSTEMS


@pytest.fixture(scope="module")
def motions(systems: dict[str, System]) -> dict[str, Motion]:
    """A motion of 24 poses of each system."""
    return {name: generate_motion(system, 24, seed=3) for name, system in systems.items()}


@pytest.mark.parametrize("name", SYSTEMS)
def test_every_sensor_sees_every_pose(systems: dict[str, System], motions: dict[str, Motion], name: str) -> None:
    system = systems[name]
    collections = list(collect(system, motions[name], seed=7))
    assert len(collections) == 24
    for collection in collections:
        assert all(collection.detected(sensor) for sensor in system.sensors)


@pytest.mark.parametrize("name", SYSTEMS)
def test_about_a_third_of_the_views_is_partial(
    systems: dict[str, System], motions: dict[str, Motion], name: str
) -> None:
    system = systems[name]
    views = [labels for c in collect(system, motions[name], seed=0) for labels in c.corners.values()]
    complete = len(system.patterns["pattern_1"].corners)
    partial = sum(labels is not None and len(labels.ids) < complete for labels in views)
    assert 0.25 <= partial / len(views) <= 0.42


@pytest.mark.parametrize("name", SYSTEMS)
def test_poses_are_spread(systems: dict[str, System], motions: dict[str, Motion], name: str) -> None:
    system = systems[name]
    placement = place(system, motions[name])
    pattern = system.patterns["pattern_1"]
    for camera, simulated in system.cameras.items():
        T = placement.pattern_in(camera, "pattern_1")
        centre = apply(T, pattern.centre[None])[:, 0]
        pixels = simulated.camera.project(centre) / [simulated.camera.width, simulated.camera.height]
        assert (np.histogram2d(*pixels.T, bins=2, range=[[0, 1], [0, 1]])[0] >= 3).all()
        assert system.motion.distance is not None
        low, high = system.motion.distance
        distance = np.linalg.norm(centre, axis=-1)
        assert distance.min() < low + 0.2 * (high - low)
        assert distance.max() > high - 0.2 * (high - low)
        assert np.ptp(T[:, 0, 2]) > 0.9  # the normal leans both ways
        assert np.ptp(T[:, 1, 2]) > 0.9


def test_the_arm_turns_about_every_axis(systems: dict[str, System], motions: dict[str, Motion]) -> None:
    T = place(systems["riwbot"], motions["riwbot"]).pattern_in("rgb_world", "pattern_1")
    axes = rotations.log(T[1:, :3, :3] @ T[0, :3, :3].T)
    assert np.linalg.eigvalsh(axes.T @ axes / len(axes)).min() > 0.1


@pytest.mark.parametrize("name", SYSTEMS)
def test_the_same_seed_gives_the_same_motion(systems: dict[str, System], name: str) -> None:
    documents = [motion_document(generate_motion(systems[name], 5, seed)) for seed in (4, 4, 5)]
    assert documents[0] == documents[1] != documents[2]


@pytest.mark.parametrize("name", SYSTEMS)
def test_nothing_is_run_into(systems: dict[str, System], motions: dict[str, Motion], name: str) -> None:
    system = systems[name]
    placement = place(system, motions[name])
    corners = apply(placement.patterns["pattern_1"], system.patterns["pattern_1"].corners)
    assert not system.scene.contains(corners).any()


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


def test_distances_from_the_size_of_the_pattern(systems: dict[str, System]) -> None:
    camera, pattern = systems["rlbot"].cameras["rgb_left"].camera, systems["rlbot"].patterns["pattern_1"]
    low, high = filling_distances(camera, pattern)
    assert 1.2 < low < 1.6
    assert 3.5 < high < 4.2


def test_a_systems_own_file_fits(systems: dict[str, System]) -> None:
    for name, system in systems.items():
        assert (
            20 <= len(place(system, read_motion(DATASETS / name / "motion.json")).transforms["world", "tripod"]) <= 30
        )


def without_cameras(folder: Path) -> System:
    for file in ("config.yml", "simulation.yml"):
        text = (folder / file).read_text()
        start = text.index("  rgb_left:")
        end = text.index("additional_tfs" if file == "config.yml" else "  # A Velodyne")
        text = (text[:start] + text[end:]).replace("anchored_sensor: rgb_left", "")
        (folder / file).write_text(text)
    return read_system(folder)


def test_what_cannot_be_generated(systems: dict[str, System], system_copy: Path) -> None:
    wall = Box(np.eye(4), np.full(3, 100.0))
    with pytest.raises(InputError, match="found 0 poses of t2rgb that every sensor sees, expected 5; widen distance_m"):
        generate_motion(replace(systems["t2rgb"], scene=Scene(boxes=(wall,))), 5, 1)
    riwbot = systems["riwbot"]
    stiff = replace(riwbot.robot, joints=tuple(replace(joint, kind="fixed") for joint in riwbot.robot.joints))
    with pytest.raises(InputError, match="pattern 'pattern_1' is fixed and no joint lies between it and a camera"):
        generate_motion(replace(riwbot, robot=stiff), 5, 1)
    with pytest.raises(InputError, match="a motion of mine cannot be generated: it has no camera"):
        generate_motion(without_cameras(system_copy), 5, 1)
