"""Outliers of a fleet, with known ones; how many there are without any."""

import numpy as np
import pytest

from calibration.engine.baseline.calibration_document import CalibratedPose
from calibration.engine.baseline.comparison import FLEET_WISE, MIN_ROBOTS, compare_fleet

SPREAD_MM, SPREAD_DEG, OWN_MM, OWN_DEG = 1.0, 0.1, 0.15, 0.02
"""Standard deviations on each axis: of mounts, and of calibrations."""


def pose(xyz: np.ndarray, rpy: np.ndarray, own_mm: float = OWN_MM) -> CalibratedPose:
    sigmas = ((own_mm,) * 3, (OWN_DEG,) * 3)
    return CalibratedPose("base", "camera", tuple(xyz.tolist()), tuple(rpy.tolist()), "camera", *sigmas, (0.0,) * 15)


def fleet(seed: int, robots: int, off: float = 0.0, outliers: int = 3) -> dict[str, dict[str, CalibratedPose]]:
    """Return a mount of some robots, the first of which are off by a number of mm in any direction."""
    rng = np.random.default_rng(seed)
    poses = {}
    for i in range(robots):
        xyz = np.array([100.0, 200.0, 300.0]) + rng.normal(0, np.hypot(SPREAD_MM, OWN_MM), 3)
        rpy = np.array([10.0, 20.0, 30.0]) + rng.normal(0, np.hypot(SPREAD_DEG, OWN_DEG), 3)
        direction = rng.normal(size=3)
        if i < outliers:
            xyz += off * direction / np.linalg.norm(direction)
        poses[f"robot {i}"] = pose(xyz, rpy)
    return {"mount": poses}


def named(mounts: dict[str, dict[str, CalibratedPose]]) -> set[str]:
    return {each.robot for mount in compare_fleet(mounts) for each in mount.robots if each.outlier}


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_three_of_a_hundred_that_are_off_by_four_standard_deviations_are_named(seed: int) -> None:
    off = 4 * SPREAD_MM * np.sqrt(3)  # norms of three axes, as all standard deviations here
    assert named(fleet(seed, 100, off)) == {"robot 0", "robot 1", "robot 2"}


@pytest.mark.parametrize("robots", [MIN_ROBOTS, 30])
def test_none_is_named_where_all_are_alike(robots: int) -> None:
    fleets = 20
    wrong = sum(bool(named(fleet(seed, robots))) for seed in range(fleets))
    assert wrong <= fleets * FLEET_WISE + 3 * np.sqrt(fleets * FLEET_WISE)


def test_many_outliers_do_not_hide_each_other() -> None:
    assert named(fleet(1, 100, 30.0, outliers=30)) == {f"robot {i}" for i in range(30)}


def test_the_spread_is_that_of_the_fleet_without_its_outliers() -> None:
    [found] = compare_fleet(fleet(1, 100, 50.0))
    assert found.fleet_sigma_mm == pytest.approx(np.sqrt(3) * SPREAD_MM, rel=0.15)
    assert found.fleet_sigma_deg == pytest.approx(np.sqrt(3) * SPREAD_DEG, rel=0.3)


def test_a_robot_with_large_error_bars_is_no_outlier() -> None:
    mounts = fleet(1, 100)
    xyz, rpy = np.array([110.0, 200.0, 300.0]), np.array([10.0, 20.0, 30.0])
    mounts["mount"]["robot 0"] = pose(xyz, rpy)
    assert named(mounts) == {"robot 0"}
    mounts["mount"]["robot 0"] = pose(xyz, rpy, own_mm=5.0)
    assert named(mounts) == set()


def test_a_rotation_alone_is_found() -> None:
    mounts = fleet(1, 100)
    mounts["mount"]["robot 0"] = pose(np.array([100.0, 200.0, 300.0]), np.array([10.0, 20.0, 31.5]))
    assert named(mounts) == {"robot 0"}


def test_few_robots_are_not_compared_and_equal_ones_are_alike() -> None:
    assert compare_fleet(fleet(1, MIN_ROBOTS - 1)) == ()
    same = pose(np.zeros(3), np.zeros(3))
    assert named({"mount": {f"robot {i}": same for i in range(20)}}) == set()
