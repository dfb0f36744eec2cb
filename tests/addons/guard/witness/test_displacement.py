"""A mount that moved, by the points of a scene and poses that are known."""

import numpy as np
import pytest

from benchmarks.guard.scenes import Scene
from calibration.addons.guard.outcome import MAX_FALSE_ALARM
from calibration.addons.guard.witness.bundle import evidence_of
from calibration.addons.guard.witness.displacement import Displacement, displacement_of
from calibration.base.arrays import Array
from tests.thorough import thorough

LENS = np.full(3, 1e-5)
STILL = np.zeros(6)
SHIFT = np.array([3e-3, -2e-3, 1e-3, 0.0, 4e-3, 1e-3])
"""m and rad: 3.7 mm and 0.24 degrees."""


def displaced(scene: Scene, shift: Array = STILL, begin: int = 0, accepted: float = 0.0) -> Displacement:
    """What is found of a scene."""
    observations, velocities = scene.seen(shift, begin)
    evidence = evidence_of(observations, LENS)
    assert evidence is not None
    return displacement_of(evidence, velocities, (5e-5, 1e-4), LENS, accepted**2 * np.eye(6))


def off_by(found: Displacement, shift: Array) -> float:
    """By how much the result is off, in its standard deviations squared, of six."""
    off = found.twist - shift
    return float(off @ np.linalg.solve(found.covariance, off))


@pytest.mark.parametrize("seed", [1, *map(thorough, range(2, 9))])
def test_nothing_is_found_of_a_mount_that_has_not_moved(seed: int) -> None:
    found = displaced(Scene(seed))
    assert found.p > MAX_FALSE_ALARM
    assert off_by(found, STILL) < 26  # one of 4000


@pytest.mark.parametrize("seed", [1, *map(thorough, (2, 3, 4))])
@pytest.mark.parametrize("begin", [0, 14])
def test_a_displacement_is_found_with_its_size_and_moment(seed: int, begin: int) -> None:
    found = displaced(Scene(seed), SHIFT, begin)
    assert found.p < 1e-6
    assert found.begin == begin
    assert off_by(found, SHIFT) < 26
    assert np.sqrt(np.diag(found.covariance)).max() < 1e-3


def test_images_that_lag_are_no_displacement() -> None:
    assert displaced(Scene(3, lag=0.03)).p > MAX_FALSE_ALARM


def test_what_is_not_known_of_the_accepted_mount_is_no_displacement() -> None:
    assert displaced(Scene(4), SHIFT).p < 1e-6
    assert displaced(Scene(4), SHIFT, accepted=5e-3).p > MAX_FALSE_ALARM


def test_poses_that_err_more_are_told_by_the_images() -> None:
    precise, rough = displaced(Scene(5)), displaced(Scene(5, arm=(2e-3, 3e-3)))
    assert rough.p > MAX_FALSE_ALARM
    assert np.diag(rough.covariance).max() > 10 * np.diag(precise.covariance).max()


def test_without_turns_a_translation_cannot_be_told() -> None:
    found = displaced(Scene(6, radians=0.0))
    sigmas = np.sqrt(np.diag(found.covariance))
    assert sigmas[:3].min() > 0.03
    assert sigmas[3:].max() < 2e-3


def test_too_few_points_say_nothing() -> None:
    observations, _ = Scene(points=12).seen(STILL)
    assert evidence_of(observations, LENS) is None
