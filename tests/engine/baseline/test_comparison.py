"""Moved sensors are significant and named with their direction; others are not."""

import math
from dataclasses import replace

import numpy as np
import pytest

from calibration.engine.baseline.calibration_document import CalibrationDocument
from calibration.engine.baseline.comparison import (
    chi_squared_quantile,
    chi_squared_tail,
    compare,
    t_squared_quantile,
    t_squared_tail,
)
from tests.engine.baseline.scenes import stereo, taken

MOVED = (0.0, 0.0, 0.005, 0.0, 0.009, 0.0)


def test_the_distributions_have_their_known_values() -> None:
    assert chi_squared_tail(12.592) == pytest.approx(0.05, rel=1e-3)
    assert chi_squared_tail(22.458) == pytest.approx(0.001, rel=1e-3)
    assert chi_squared_tail(math.inf) == 0
    assert chi_squared_quantile(0.001) == pytest.approx(22.458, abs=0.001)
    assert t_squared_tail(22.458, 6, math.inf) == pytest.approx(0.001, rel=0.1)
    assert t_squared_tail(10.828, 1, math.inf) == pytest.approx(0.001, rel=0.2)
    assert t_squared_quantile(0.05, 20) == pytest.approx(20 * 6 / 15 * 2.790, rel=0.02)  # F of 6 and 15
    assert t_squared_tail(math.inf, 6, 20) == 0
    assert t_squared_tail(1e5, 6, 5) == 1
    assert t_squared_quantile(0.05, 5) == math.inf


def test_a_calibration_does_not_differ_from_itself() -> None:
    found = taken(stereo())
    comparison = compare(found, found)
    assert comparison.same_data
    assert {each.kind for each in comparison.changes} == {"pose"}
    assert all(each.mm == each.deg == each.sigmas == 0 and each.p > 1 - 1e-5 for each in comparison.changes)


def test_other_data_of_the_same_robot_are_no_change() -> None:
    before = taken(stereo(1))
    for seed in range(2, 12):
        comparison = compare(before, taken(stereo(seed)))
        assert not comparison.same_data
        assert all(each.p > comparison.significance for each in comparison.changes)


def test_a_sensor_that_moved_is_the_one_that_changes_in_its_direction() -> None:
    comparison = compare(taken(stereo(1)), taken(stereo(2, MOVED)))
    [change] = [each for each in comparison.changes if each.p < comparison.significance]
    assert change.name == "right"
    assert change.translation_mm == pytest.approx((0, 0, 5), abs=4 * change.sigma_mm)
    assert change.rotation_deg == pytest.approx((0, math.degrees(0.009), 0), abs=4 * change.sigma_deg)
    assert change.mm == pytest.approx(np.linalg.norm(change.translation_mm), rel=1e-3)


def test_the_largest_undetected_move_is_about_as_large_as_reported() -> None:
    before = taken(stereo(1))
    unseen = next(each for each in compare(before, taken(stereo(2))).changes if each.name == "right").unseen_mm
    far = (0.0, 0.0, 3e-3 * unseen, 0.0, 0.0, 0.0)
    comparison = compare(before, taken(stereo(2, far)))
    assert min(each.p for each in comparison.changes) < comparison.significance


def test_added_and_removed_sensors_are_reported() -> None:
    found = taken(stereo())
    less = replace(found, poses=tuple(each for each in found.poses if each.name != "right"))
    assert [(each.kind, each.name) for each in compare(found, less).changes if each.kind != "pose"] == [
        ("removed", "right")
    ]
    assert [(each.kind, each.name) for each in compare(less, found).changes if each.kind != "pose"] == [
        ("added", "right")
    ]


def test_what_both_hold_differs_without_an_error_bar() -> None:
    found = taken(stereo())
    [left] = [each for each in found.poses if each.sigma_mm is None]
    other: CalibrationDocument = replace(
        found,
        poses=tuple(replace(each, xyz_mm=(1.0, 2.0, 3.0)) if each is left else each for each in found.poses),
    )
    change = next(each for each in compare(found, other).changes if each.name == left.name)
    assert change.p == 0
    assert change.mm > 0


def test_what_both_hold_errs_alike_and_widens_no_difference() -> None:
    before, now = taken(stereo(1)), taken(stereo(2))
    [right] = [each for each in before.poses if each.held]
    [change] = [each for each in compare(before, now).changes if each.name == "right"]
    assert right.norm_mm > 3 * change.sigma_mm / math.sqrt(2)
    apart = replace(now, poses=tuple(replace(each, held={}) for each in now.poses))
    [alone] = [each for each in compare(before, apart).changes if each.name == "right"]
    assert alone.sigma_mm > 2 * change.sigma_mm
