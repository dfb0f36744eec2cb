"""A camera and a LiDAR against each other, by the edges that both see."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.guard.edge_scenes import T_LIDAR_CAMERA, RigInRoom
from calibration.addons.guard.outcome import SensorCheck
from calibration.addons.guard.witness.depth_edges import check_by_edges, depth_edges
from calibration.addons.guard.witness.moving_frames import checks_of_bag
from calibration.base.arrays import Array
from tests.addons.guard.witness.moving_bag import accepted_mounts
from tests.robot.importing.bags import BEGIN, SECOND, BagFile
from tests.thorough import thorough

TURN = np.radians(0.6)
ACCEPTED = accepted_mounts(
    {"lidar": ("rig", "lidar_link", np.eye(4)), "camera": ("rig", "optical", T_LIDAR_CAMERA)}, sigma_mm=0.5
)


def bag_of(folder: Path, rig: RigInRoom, shift: Array) -> Path:
    """A bag with an image and a scan a second."""
    seen, path = rig.seen(shift), folder / "rig.bag"
    with BagFile(path, "bag") as bag:
        for k, (image, scan) in enumerate(zip(seen.images, seen.scans, strict=True)):
            stamp = BEGIN + k * SECOND
            bag.camera_info("/camera/camera_info", stamp, "optical", (640, 480), seen.camera.fx)
            bag.image("/camera/image_raw", stamp, cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), "optical", "mono8")
            bag.cloud("/lidar/points", stamp + SECOND // 20, scan, "lidar_link")
    return path


def checks_of(bag: Path, **told: SensorCheck) -> dict[str, SensorCheck]:
    """What is said of its sensors."""
    return {each.sensor: each for each in checks_of_bag(bag, ACCEPTED, told)}


@pytest.mark.parametrize("seed", [1, *map(thorough, range(2, 5))])
def test_nothing_is_found_of_a_camera_that_has_not_moved(seed: int) -> None:
    found = check_by_edges(RigInRoom(seed).seen())
    assert found.outcome == "unmoved"
    assert found.unseen_deg is not None
    assert found.unseen_deg < 0.8


@pytest.mark.parametrize("axis", [1, thorough(0), thorough(2)])
def test_a_turn_is_found_with_its_axis_and_moment(axis: int) -> None:
    shift = np.zeros(6)
    shift[3 + axis] = TURN
    found = check_by_edges(RigInRoom(1).seen(shift, 6))
    assert found.red
    assert found.since == pytest.approx(5.5)
    assert found.rotation_deg == pytest.approx(np.degrees(shift[3:]), abs=0.2)


@pytest.mark.parametrize(
    "rig",
    [RigInRoom(bare=True, people=0), thorough(RigInRoom(moments=5))],
    ids=["nothing stands before the walls", "few images"],
)
def test_a_recording_that_cannot_tell_says_so(rig: RigInRoom) -> None:
    found = check_by_edges(rig.seen())
    assert found.outcome == "cannot-tell"
    assert found.reason


def test_edges_of_another_place_agree_by_chance_only() -> None:
    found = check_by_edges(replace(RigInRoom(1).seen(), scans=RigInRoom(2).seen().scans))
    assert found.outcome == "cannot-tell"
    assert "by chance" in found.reason


def test_a_floor_at_a_slant_has_no_edges() -> None:
    down, around = np.meshgrid(np.linspace(-0.4, -0.05, 60), np.linspace(-1, 1, 400))
    rays = np.stack([np.cos(down) * np.cos(around), np.cos(down) * np.sin(around), np.sin(down)], -1).reshape(-1, 3)
    floor = rays * (-1.5 / rays[:, 2:])
    assert len(depth_edges(floor).at) == 0
    floor[floor[:, 1] > 0.3] *= 0.5
    assert len(depth_edges(floor).at) > 30


def test_a_scan_that_returned_nothing_has_no_edges() -> None:
    for scan in (np.zeros((0, 3)), np.full((9, 3), np.nan), np.full((9, 3), 1e300), np.ones((2, 3))):
        assert len(depth_edges(scan).at) == 0
    seen = RigInRoom(1, moments=9).seen()
    assert check_by_edges(replace(seen, scans=[np.zeros((0, 3))] * 9)).outcome == "cannot-tell"


def test_a_bag_of_a_rig_that_stands_names_the_camera_or_the_lidar(tmp_path: Path) -> None:
    bag = bag_of(tmp_path, RigInRoom(1, still=True), np.r_[0, 0, 0, 0, 2 * TURN, 0])
    found = checks_of(bag)
    assert found["camera"].red
    assert "or lidar has moved" in found["camera"].reason
    unmoved = replace(found["camera"], sensor="camera", outcome="unmoved")
    [blamed] = checks_of(bag, camera=unmoved).values()
    assert (blamed.sensor, blamed.red) == ("lidar", True)


@pytest.mark.thorough
def test_a_rig_that_never_stands_still_is_no_witness(tmp_path: Path) -> None:
    found = checks_of(bag_of(tmp_path, RigInRoom(1), np.zeros(6)))
    assert {each.outcome for each in found.values()} == {"cannot-tell"}
    assert "0 moments" in found["camera"].reason
