from dataclasses import replace

import numpy as np
import pytest

from calibration.dataset.model import CornerLabels
from calibration.errors import InputError
from calibration.simulation.collection.capture import SimulatedCollection, collect
from calibration.simulation.motion.sequence import Motion, moving_joints, moving_model, read_motion
from calibration.simulation.placement import place
from calibration.simulation.scene import Box, Scene
from calibration.simulation.system import System
from tests.simulation.conftest import DATASETS, SYSTEMS


def own_motion(system: System) -> Motion:
    return read_motion(DATASETS / system.name / "motion.json")


def content(collection: SimulatedCollection) -> list[list[float]]:
    """Every number that the sensors made."""
    numbers = [labels.pixels.ravel().tolist() for labels in collection.corners.values() if labels]
    numbers += [
        labels.on_pattern.tolist() + labels.on_border.tolist() for labels in collection.points.values() if labels
    ]
    return numbers + [cloud.ravel().tolist() for cloud in collection.clouds.values()]


@pytest.mark.parametrize("name", SYSTEMS)
def test_a_part_of_the_motion_gives_a_part_of_the_collections(systems: dict[str, System], name: str) -> None:
    system = systems[name]
    motion = own_motion(system)
    whole = [content(c) for c in collect(system, motion, seed=5)]
    part = [content(c) for c in collect(system, motion.take(list(range(6))), seed=5)]
    assert part == whole[:6]
    changed = motion.take([9, *range(1, 6)])  # another first pose
    assert [content(c) for c in collect(system, changed, seed=5)][1:] == whole[1:6]


def test_a_sensor_does_not_change_what_another_one_sees(systems: dict[str, System]) -> None:
    system = systems["rlbot"]
    config = system.configuration
    alone = replace(
        system,
        sensors={"rgb_left": system.sensors["rgb_left"]},
        configuration=replace(config, sensors={"rgb_left": config.sensors["rgb_left"]}),
    )
    for a, b in zip(collect(system, own_motion(system), 1), collect(alone, own_motion(system), 1), strict=True):
        x, y = a.corners["pattern_1", "rgb_left"], b.corners["pattern_1", "rgb_left"]
        assert isinstance(x, CornerLabels)
        assert isinstance(y, CornerLabels)
        np.testing.assert_array_equal(x.pixels, y.pixels)


def test_another_seed_gives_other_noise(systems: dict[str, System]) -> None:
    system = systems["t2rgb"]
    motion = own_motion(system).take([0])
    (a,), (b,) = (list(collect(system, motion, seed)) for seed in (1, 2))
    assert content(a) != content(b)


def test_a_box_before_a_camera_hides_corners(systems: dict[str, System]) -> None:
    system = systems["t2rgb"]
    motion = own_motion(system).take([0])
    placement = place(system, motion)
    camera, board = placement.sensors["left_camera"][0, :3, 3], placement.patterns["pattern_1"][0]
    centre = board @ np.append(system.patterns["pattern_1"].centre, 1)
    middle = np.eye(4)
    middle[:3, 3] = (camera + centre[:3]) / 2
    hiding = replace(system, scene=Scene(boxes=(Box(middle, np.full(3, 0.15)),)))
    (collection,) = collect(hiding, motion, 1)
    left, right = (collection.corners["pattern_1", name] for name in ("left_camera", "right_camera"))
    assert left is None or len(left.ids) < 88
    assert right is not None


def test_a_motion_that_does_not_fit(systems: dict[str, System]) -> None:
    joints, model = moving_joints({"elbow_joint": np.zeros(2)}), moving_model(np.eye(4)[None])
    with pytest.raises(
        InputError, match="found no position and orientation; pattern 'pattern_1' of t2rgb moves by them"
    ):
        collect(systems["t2rgb"], joints, 1)
    with pytest.raises(InputError, match="found positions and orientations, but every pattern of riwbot is fixed"):
        collect(systems["riwbot"], model, 1)
    with pytest.raises(InputError, match="joint 'elbow_joint' is not in the robot"):
        collect(systems["t2rgb"], replace(model, joints=joints.take([0]).joints), 1)
    with pytest.raises(InputError, match="joint 'elbow_joint' at 4 in pose 2 is outside its limits"):
        collect(systems["riwbot"], moving_joints({"elbow_joint": np.array([0.0, 4.0])}), 1)


def test_a_camera_inside_a_wall(systems: dict[str, System]) -> None:
    system = systems["t2rgb"]
    wall = Box(place(system, own_motion(system)).sensors["left_camera"][0], np.ones(3))
    with pytest.raises(InputError, match=r"motion.json: a sensor is in a box or under the ground in pose 1"):
        collect(replace(system, scene=Scene(boxes=(wall,))), own_motion(system), 1)
