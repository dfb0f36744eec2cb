"""LiDARs against the motion that carries them, by the crispness of the map."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.guard.lidar_scenes import NOT_MOVED, T_LINK_LIDAR, ScannedRoom
from benchmarks.guard.lidars import room_of
from calibration.__main__ import main
from calibration.addons.guard.witness.plane_map import check_by_map, map_checks_of_bag
from calibration.base.arrays import Array
from calibration.engine.baseline.document import Baseline, write_baseline
from tests.addons.guard.witness.moving_bag import accepted_mounts
from tests.robot.importing.bags import BEGIN, SECOND, BagFile
from tests.thorough import thorough

SHIFT = np.array([0.008, 0.0, 0.0, 0.0, np.radians(0.5), 0.0])
"""m and rad."""
ACCEPTED = accepted_mounts({"lidar": ("base_link", "lidar_link", T_LINK_LIDAR)})


def room(seed: int = 1, planar: bool = False, scans: int = 16) -> ScannedRoom:
    """A small one."""
    return ScannedRoom(seed, scans=scans, rings=20, azimuths=240, planar=planar)


def bag_of(folder: Path, shift: Array = NOT_MOVED, begin: int = 0, stops: bool = True, parent: str = "odom") -> Path:
    """A bag with clouds at two a second, of a base that stops for each, or never."""
    seen, path = room().seen(shift, begin), folder / "drive.bag"
    with BagFile(path, "bag") as bag:
        for k, (scan, T) in enumerate(zip(seen.scans, seen.carriage.T_root_link, strict=True)):
            stamp = BEGIN + k * SECOND // 2
            for side in (-1, 0, 1) if stops else (0,):
                bag.transforms("/tf", stamp + side * SECOND // 5, {(parent, "base_link"): T})
            bag.cloud("/lidar/points", stamp, scan, "lidar_link")
    return path


@pytest.mark.parametrize("seed", [1, *map(thorough, range(2, 9))])
def test_nothing_is_found_of_a_lidar_that_has_not_moved(seed: int) -> None:
    found = check_by_map(room(seed).seen())
    assert found.outcome == "unmoved"
    assert found.unseen_deg is not None
    assert found.unseen_mm is not None
    assert found.unseen_deg < 0.5
    assert found.unseen_mm < 25


def test_a_planar_drive_tells_all_but_the_height() -> None:
    up = T_LINK_LIDAR[2, :3]
    still = check_by_map(room(planar=True).seen(np.r_[0.05 * up, 0, 0, 0]))
    assert (still.outcome, still.unseen_mm) == ("unmoved", None)
    assert "along z cannot be told" in still.reason
    assert check_by_map(room(planar=True).seen(SHIFT)).red


def test_odometry_that_drifts_is_no_displacement() -> None:
    drifting = replace(room(planar=True), drift=(2e-3, 5e-4))
    assert not check_by_map(drifting.seen()).red


def test_a_wheel_that_slips_once_is_no_displacement() -> None:
    assert not check_by_map(replace(room_of("base", 2), slip=(0.03, 0.03)).seen()).red


def test_check_is_red_of_a_bag_in_which_the_lidar_was_displaced(tmp_path: Path) -> None:
    bag, baseline, output = bag_of(tmp_path, SHIFT, 8), tmp_path / "accepted.json", tmp_path / "output"
    write_baseline(baseline, Baseline(1, {"robot": ACCEPTED}))
    assert main(["check", str(bag), "--baseline", str(baseline), "--output", str(output)]) == 1
    [found] = json.loads((output / "results.json").read_text())["systems"]["robot"]
    assert (found["sensor"], found["outcome"]) == ("lidar", "moved")
    assert found["since"] == pytest.approx(3.75, abs=0.5)
    assert found["rotation_deg"] == pytest.approx([0, 0.5, 0], abs=0.15)
    assert found["translation_mm"][:2] == pytest.approx([8, 0], abs=4)  # with a slip, its end tells no height


def test_scans_during_motion_are_no_witness(tmp_path: Path) -> None:
    [found] = map_checks_of_bag(bag_of(tmp_path, stops=False), ACCEPTED)
    assert found.outcome == "cannot-tell"
    assert "stop" in found.reason


def test_what_hangs_on_the_map_is_no_witness(tmp_path: Path) -> None:
    [found] = map_checks_of_bag(bag_of(tmp_path, parent="map"), ACCEPTED)
    assert found.outcome == "cannot-tell"
    assert "map" in found.reason


def test_a_lidar_that_is_covered_tells_nothing() -> None:
    seen = room().seen()
    covered = [
        np.full_like(scan, value) for scan, value in zip(seen.scans, [np.nan, 0.0, np.inf, 1e300] * 4, strict=True)
    ]
    assert check_by_map(replace(seen, scans=covered)).outcome == "cannot-tell"
    assert check_by_map(replace(seen, scans=[*covered[:4], *seen.scans[4:]])).outcome == "unmoved"


@pytest.mark.parametrize(
    "lidar",
    [ScannedRoom(scans=6, rings=8), ScannedRoom(scans=8, rings=8, metres=0.0, radians=0.0)],
    ids=["few", "still"],
)
def test_a_recording_that_cannot_tell_says_so(lidar: ScannedRoom) -> None:
    assert check_by_map(lidar.seen()).outcome == "cannot-tell"
