"""Every modality together, with gaps, and cameras that only others link."""

from collections.abc import Callable

import numpy as np
import pytest

from calibration.base import UndeterminedError
from calibration.engine.dataset.model import Labels, PointLabels
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.least_squares.noise_levels import NoiseLevels
from calibration.engine.estimation.start.build import build
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.engine.geometry.transforms import local
from tests.engine.estimation.scenes import Scene, errors, relabelled
from tests.engine.estimation.systems import (
    camera_and_lidar2d,
    linked_by_a_lidar,
    linked_by_an_arm,
    stereo,
    tripod,
    tripod_with_gaps,
)

MIXTURES: dict[str, Callable[..., Scene]] = {
    "camera and 2D lidar": camera_and_lidar2d,
    "tripod": tripod,
    "tripod with gaps": tripod_with_gaps,
    "linked by an arm": linked_by_an_arm,
    "linked by a lidar": linked_by_a_lidar,
    "linked by a 2D lidar": lambda *a, **k: linked_by_a_lidar(*a, flat=True, **k),
}
NOISES = [(0, 0), (0.5, 0), (0, 0.5), (0.5, 0.5), (3, 3)]
LIDAR_2D_STEP = np.radians(0.5)


@pytest.mark.thorough(but_first=2)
@pytest.mark.parametrize("mixture", MIXTURES)
def test_exact_labels_give_the_truth_from_every_starting_noise(mixture):
    dataset = MIXTURES[mixture](border=False).dataset()
    for translation_noise, rotation_noise in NOISES:
        result = calibrate(dataset, Options(), StartingNoise(translation_noise, rotation_noise, 3))
        assert result.converged
        assert not [warning for warning in result.notes if "no equation" in warning]
        assert max(errors(dataset, result.transforms, result.gauge)) < 1e-6


# "tripod" is a part of "tripod with gaps"; a camera beside a 3D LiDAR is in test_uncertainty.
@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize(
    "mixture", ["camera and 2D lidar", "tripod with gaps", "linked by an arm", "linked by a 2D lidar"]
)
@pytest.mark.many_scenes
def test_the_errors_of_every_block_are_as_large_as_stated(mixture):
    scenes = 20
    squares: dict[tuple[str, str], list[float]] = {}
    for seed in range(scenes):
        dataset = MIXTURES[mixture](seed=seed, pixel_noise=0.3, range_noise=0.008).dataset(seed)
        result = calibrate(dataset, Options(loss="linear"))
        assert result.converged
        for edge, covariance in result.label_covariances.items():
            e = local(result.transforms[edge], dataset.transforms[edge][0])
            squares.setdefault(edge, []).append(float(e @ np.linalg.solve(covariance, e)))
    for edge, each in squares.items():
        assert abs(np.mean(each) - 6) < 3.5 * np.sqrt(12 / scenes), edge


def test_each_kind_of_sensor_has_noise_of_its_own():
    """The ranges of the 2D LiDAR three times as noisy as those of the others."""
    rng = np.random.default_rng(0)

    def noisier(_: int, sensor: str, label: Labels) -> Labels:
        if sensor != "scan" or not isinstance(label, PointLabels):
            return label
        ranges = np.linalg.norm(label.points, axis=-1, keepdims=True)
        return PointLabels(label.points * (1 + 0.024 * rng.normal(size=ranges.shape) / ranges), label.limits)

    levels = calibrate(relabelled(tripod(20, pixel_noise=0.3, range_noise=0.008).dataset(1), noisier)).noise_levels
    assert levels.range == pytest.approx(0.008, rel=0.05)
    assert levels.lidar2d_range == pytest.approx(np.hypot(0.024, 0.008), rel=0.1)
    assert levels.lidar2d_border == pytest.approx(LIDAR_2D_STEP / np.sqrt(12), rel=0.25)
    assert levels.lidar2d_border > 1.2 * levels.border


def test_the_noise_of_a_2d_lidar_can_be_given():
    given = NoiseLevels(lidar2d_range=0.02, lidar2d_border=0.004)
    levels = calibrate(tripod(pixel_noise=0.3, range_noise=0.008).dataset(), Options(noise_levels=given)).noise_levels
    assert (levels.lidar2d_range, levels.lidar2d_border) == (0.02, 0.004)
    assert levels.range == pytest.approx(0.008, rel=0.05)


def test_the_ends_of_scan_lines_add_information_to_their_planes():
    edge = ("world", "scan")
    with_ends, without = (
        calibrate(camera_and_lidar2d(pixel_noise=0.3, range_noise=0.008, border=border).dataset()).label_sigma_mm(edge)
        for border in (True, False)
    )
    assert with_ends < 0.9 * without


def test_an_end_that_is_none_is_rejected_by_the_place_of_its_ray():
    def wrong(i: int, sensor: str, label: Labels) -> Labels:
        if (i, sensor) != (3, "scan") or not isinstance(label, PointLabels):
            return label
        return PointLabels(label.points[:-15], np.array([0, len(label.points) - 16]))

    dataset = relabelled(camera_and_lidar2d(20, pixel_noise=0.3, range_noise=0.008).dataset(), wrong)
    last = len(dataset.collections[3].labels["board", "scan"].points) - 1
    rejected = [label for label in calibrate(dataset).rejected if label.kind == "lidar2d_border"]
    assert [(label.collection, label.sensor, label.label) for label in rejected] == [("003", "scan", last)]


def test_outliers_among_the_rays_do_little_harm():
    rng = np.random.default_rng(0)

    def spoil(_: int, sensor: str, label: Labels) -> Labels:
        if sensor != "scan" or not isinstance(label, PointLabels):
            return label
        bad = rng.random((len(label.points), 1)) < 0.2
        return PointLabels(label.points * np.where(bad, rng.uniform(0.7, 1.4, bad.shape), 1.0), label.limits)

    dataset = relabelled(camera_and_lidar2d(20, pixel_noise=0.3, range_noise=0.008).dataset(), spoil)
    result = calibrate(dataset, Options(), StartingNoise(3, 1.5))
    assert result.converged
    assert errors(dataset, result.transforms)[0] < 0.01


@pytest.mark.parametrize("link", ["a lidar", "nothing"])
def test_cameras_that_nothing_links_are_refused_with_both_names(link):
    """Two cameras that take turns; the LiDAR sees the pattern with one of them only, or there is none."""
    if link == "nothing":
        scene = stereo(12, sees=lambda sensor, _, i: (sensor == "left") == (i % 2 == 0))
        names = r"\{left\} and \{right\}"
    else:
        scene = linked_by_a_lidar(sees=lambda sensor, _, i: (sensor == "second") == (i % 2 == 0))
        names = r"\{cam, lidar\} and \{second\}"
    with pytest.raises(UndeterminedError, match=f"the sensors {names} share no collection of a pattern"):
        build(scene.dataset())
