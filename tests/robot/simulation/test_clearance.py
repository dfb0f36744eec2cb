from dataclasses import replace

import numpy as np
import pytest

from calibration.base.arrays import Array
from calibration.robot.simulation.kinematics import place
from calibration.robot.simulation.motion import Motion
from calibration.robot.simulation.motion_generation import is_clear
from calibration.robot.simulation.scene import Box, Scene
from calibration.robot.simulation.system import System
from calibration.robot.urdf import compose
from tests.robot.simulation.conftest import SYSTEMS

PATTERN = "pattern_1"


def clear(system: System, motion: Motion, scene: Scene) -> list[bool]:
    cleared = replace(system, scene=scene)
    result: list[bool] = is_clear(cleared, system.patterns[PATTERN], place(cleared, motion)).tolist()
    return result


def cube(centre: Array, size: float) -> Scene:
    T = np.eye(4)
    T[:3, 3] = centre
    return Scene(boxes=(Box(T, np.full(3, size)),))


@pytest.mark.thorough(but_first=2)
@pytest.mark.parametrize("name", SYSTEMS)
def test_the_pattern_runs_into_a_box(systems: dict[str, System], motions: dict[str, Motion], name: str) -> None:
    system, motion = systems[name], motions[name]
    assert all(clear(system, motion, Scene()))
    outline = system.patterns[PATTERN].outline
    corner = (place(system, motion).patterns[PATTERN][4] @ [*outline[0], 0.0, 1.0])[:3]
    assert not clear(system, motion, cube(corner, 1e-3))[4]


@pytest.mark.parametrize("name", SYSTEMS)
def test_a_sensor_in_a_box_is_not_clear(systems: dict[str, System], motions: dict[str, Motion], name: str) -> None:
    system, motion = systems[name], motions[name]
    for T_world_sensor in place(system, motion).sensors.values():
        there = np.linalg.norm(T_world_sensor[:, :3, 3] - T_world_sensor[0, :3, 3], axis=-1) < 0.01
        assert not (np.array(clear(system, motion, cube(T_world_sensor[0, :3, 3], 0.05))) & there).any()


def test_a_link_of_the_arm_runs_into_a_box(systems: dict[str, System], motions: dict[str, Motion]) -> None:
    system, motion = systems["riwbot"], motions["riwbot"]
    elbow = compose(system.robot.tree, place(system, motion).transforms, "world", "forearm_link")[:, :3, 3]
    assert not clear(system, motion, cube(elbow[7], 1e-3))[7]


def test_a_base_drives_on_the_ground_but_into_no_box(systems: dict[str, System], motions: dict[str, Motion]) -> None:
    """Its links move level, at the height at which they were built; the links of an arm do not."""
    system, motion = systems["softbot"], motions["softbot"]
    base = compose(system.robot.tree, place(system, motion).transforms, "world", "base_footprint")[:, :3, 3]
    assert np.abs(base[:, 2]).max() == 0
    assert all(clear(system, motion, Scene(ground=0.0)))
    assert not clear(system, motion, cube(base[3], 1e-3))[3]
    arm, moves = systems["spjbot"], motions["spjbot"]
    wrist = compose(arm.robot.tree, place(arm, moves).transforms, "world", "j4_link")[:, 2, 3]
    ground = float(wrist.min()) - 0.05
    lowest = clear(arm, moves, Scene(ground=ground))
    assert not lowest[int(wrist.argmin())]


def test_the_ground_is_kept_away_from(systems: dict[str, System], motions: dict[str, Motion]) -> None:
    system, motion = systems["t2rgb"], motions["t2rgb"]
    board = place(system, motion).patterns[PATTERN]
    outline = np.column_stack([system.patterns[PATTERN].outline, np.zeros(4), np.ones(4)])
    lowest = (board @ outline.T)[:, 2].min(-1)
    ground = float(np.median(lowest)) - 0.05
    assert clear(system, motion, Scene(ground=ground)) == (lowest >= ground + 0.05).tolist()
