import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.base import InputError
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import apply, from_xyz_rpy
from calibration.robot.simulation.kinematics import place, stream
from calibration.robot.simulation.motion import Motion, motion_document, read_motion
from calibration.robot.simulation.motion_generation import (
    draw_motion,
    draw_poses,
    filling_distances,
    find_candidates,
    generate_motion,
    is_clear,
    within_ranges,
)
from calibration.robot.simulation.motion_information import predicted_sigmas
from calibration.robot.simulation.scene import Box, Scene
from calibration.robot.simulation.sensors import SimulatedDepthCamera
from calibration.robot.simulation.system import MotionRanges, System, read_system
from tests.robot.simulation.conftest import DATASETS, FREE, SYSTEMS, corner_views, detects
from tests.robot.simulation.other_choices import at_random, spread


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


PATTERN = "pattern_1"


@pytest.mark.parametrize("name", SYSTEMS)
def test_every_sensor_sees_every_pose_and_nothing_is_run_into(
    systems: dict[str, System], motions: dict[str, Motion], name: str
) -> None:
    system = systems[name]
    assert len(motions[name]) == 24
    placement = place(system, motions[name])
    for camera in system.cameras:
        assert corner_views(system, camera, PATTERN, placement).detectable.all()
    for sensor in system.sensors:
        assert detects(system, sensor, PATTERN, placement).all()
    assert is_clear(system, system.patterns[PATTERN], placement).all()


def test_a_lidar_that_needs_distance_sees_every_pose(systems: dict[str, System]) -> None:
    lidar = replace(systems["rlbot"].sensors["lidar_right"], reach=(1.9, 130.0))
    system = replace(systems["rlbot"], sensors={**systems["rlbot"].sensors, "lidar_right": lidar})
    placement = place(system, generate_motion(system, 12, seed=1))
    assert detects(system, "lidar_right", PATTERN, placement).all()


@pytest.mark.parametrize("name", [*FREE, "spjbot"])
def test_every_cell_of_every_image_is_covered(
    systems: dict[str, System], motions: dict[str, Motion], name: str
) -> None:
    system = systems[name]
    placement = place(system, motions[name])
    for camera, simulated in system.cameras.items():
        assert corner_views(system, camera, PATTERN, placement).cells(simulated.camera).any(0).all()


@pytest.mark.parametrize("name", SYSTEMS)
def test_a_third_of_the_views_is_partial(systems: dict[str, System], motions: dict[str, Motion], name: str) -> None:
    placement = place(systems[name], motions[name])
    partial = [corner_views(systems[name], camera, PATTERN, placement).partial for camera in systems[name].cameras]
    assert np.mean(partial) == pytest.approx(1 / 3, abs=1 / 24)


def test_no_partial_views_where_none_are_wanted(systems: dict[str, System]) -> None:
    system = replace(systems["t2rgb"], motion=replace(systems["t2rgb"].motion, partial=0.0))
    placement = place(system, generate_motion(system, 8, seed=1))
    assert not any(corner_views(system, camera, PATTERN, placement).partial.any() for camera in system.cameras)


def error(system: System, motion: Motion) -> float:
    """Predicted error of the free sensor, m and rad together, a radian counting as the pattern's distance."""
    camera = next(iter(system.cameras))
    distance = float(np.linalg.norm(place(system, motion).pattern_in(camera, PATTERN)[:, :3, 3], axis=-1).mean())
    return max(float(np.hypot(t / distance, r)) for t, r in predicted_sigmas(system, motion).values())


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("name", SYSTEMS)
def test_the_calibration_is_better_determined_than_by_other_choices(systems: dict[str, System], name: str) -> None:
    system = systems[name]
    for count, seed in ((8, 1), (24, 2)):
        ours = error(system, generate_motion(system, count, seed))
        candidates = find_candidates(system, count, seed)
        random = [error(system, candidates.motion.take(at_random(candidates, count, i))) for i in range(9)]
        assert ours < 0.85 * np.median(random)
        assert ours < min(random)
        room = 0.95 if name in FREE else 1.0
        assert ours < room * error(system, candidates.motion.take(spread(system, candidates, count)))


@pytest.mark.parametrize("name", FREE)
def test_the_pattern_leans_every_way(systems: dict[str, System], motions: dict[str, Motion], name: str) -> None:
    placement = place(systems[name], motions[name])
    for camera in systems[name].cameras:
        normal = placement.pattern_in(camera, PATTERN)[:, :2, 2]
        assert (np.ptp(normal, axis=0) > 0.9).all()


def test_the_arm_turns_about_every_axis(systems: dict[str, System], motions: dict[str, Motion]) -> None:
    T = place(systems["riwbot"], motions["riwbot"]).pattern_in("rgb_world", PATTERN)
    axes = rotations.log(T[1:, :3, :3] @ T[0, :3, :3].T)
    assert np.linalg.eigvalsh(axes.T @ axes / len(axes)).min() > 0.1


def test_the_joints_stay_within_their_limits(systems: dict[str, System], motions: dict[str, Motion]) -> None:
    assert set(motions["riwbot"].joints) == set(systems["riwbot"].robot.movable)
    for name, positions in motions["riwbot"].joints.items():
        joint = systems["riwbot"].robot.movable[name]
        assert ((positions >= joint.lower) & (positions <= joint.upper)).all()


@pytest.mark.thorough(but_first=2)
@pytest.mark.parametrize("name", SYSTEMS)
def test_the_same_seed_gives_the_same_motion(systems: dict[str, System], name: str) -> None:
    documents = [motion_document(generate_motion(systems[name], 5, seed)) for seed in (4, 4, 5)]
    assert documents[0] == documents[1] != documents[2]


GENERATE = """
import json, sys
from pathlib import Path
from calibration.robot.simulation.motion_generation import generate_motion
from calibration.robot.simulation.motion import motion_document
from calibration.robot.simulation.system import read_system
for folder in sys.argv[1:]:
    print(json.dumps(motion_document(generate_motion(read_system(Path(folder)), 12, 1))))
"""


def numpys_extensions() -> str:
    """The instruction sets that numpy would use here beyond those that it was built for."""
    names = ("numpy._core._multiarray_umath", "numpy.core._multiarray_umath")
    umath = next(sys.modules[name] for name in names if name in sys.modules)
    return " ".join(name for name in umath.__cpu_dispatch__ if umath.__cpu_features__[name])


def test_an_older_processor_gives_the_same_motion(systems: dict[str, System]) -> None:
    environment = {**os.environ, "NPY_DISABLE_CPU_FEATURES": numpys_extensions(), "OPENBLAS_CORETYPE": "Nehalem"}
    folders = [str(DATASETS / name) for name in SYSTEMS]
    command = [sys.executable, "-c", GENERATE, *folders]
    run = subprocess.run(
        command, env=environment, cwd=DATASETS.parent, check=True, capture_output=True, text=True, timeout=100
    )
    for name, line in zip(SYSTEMS, run.stdout.splitlines(), strict=True):
        assert json.loads(line) == motion_document(generate_motion(systems[name], 12, 1))


def test_a_motion_survives_its_file(systems: dict[str, System], motions: dict[str, Motion], tmp_path: Path) -> None:
    for name, motion in motions.items():
        path = tmp_path / f"{name}.json"
        path.write_text(json.dumps(motion_document(motion)))
        assert predicted_sigmas(systems[name], read_motion(path)) == predicted_sigmas(systems[name], motion)


@pytest.mark.parametrize("count", [1, 2])
def test_short_motions(systems: dict[str, System], count: int) -> None:
    for system in systems.values():
        assert len(generate_motion(system, count, 1)) == count


@pytest.mark.thorough
def test_a_system_that_only_atom_can_calibrate(systems: dict[str, System]) -> None:
    """A depth camera sees every pose too; without a second sensor the engine knows, poses cover the images."""
    system = systems["t2rgb"]
    depth = SimulatedDepthCamera(system.cameras["right_camera"].camera)
    mixed = replace(system, sensors={**system.sensors, "right_camera": depth})
    motion = generate_motion(mixed, 12, 1)
    placement = place(mixed, motion)
    assert detects(mixed, "right_camera", PATTERN, placement).all()
    cells = corner_views(mixed, "left_camera", PATTERN, placement).cells(system.cameras["left_camera"].camera)
    assert cells.any(0).sum() >= 10  # what lies left of the other's image stays empty


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
