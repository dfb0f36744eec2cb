"""Labels that are wrong: single ones are named and hardly matter, whole views end in the optimum or a reason."""

import numpy as np
import pytest

from calibration.engine.dataset.model import CornerLabels, Labels, PointLabels
from calibration.engine.estimation.calibrate import Options, calibrate
from tests.engine.estimation.scenes import errors, relabelled, sigmas_apart
from tests.engine.estimation.systems import camera_and_lidar, eye_in_hand, stereo, two_bodies

NOISY = {"pixel_noise": 0.3, "range_noise": 0.01, "partial": 0.3}


@pytest.mark.parametrize("scene", [stereo, eye_in_hand, two_bodies], ids=lambda s: s.__name__)
def test_planted_outliers_are_exactly_the_rejected_labels(scene):
    rng = np.random.default_rng(0)
    planted = set()

    def plant(i: int, sensor: str, label: Labels) -> Labels:
        pixels = label.pixels.copy()
        for k in rng.permutation(len(label.ids))[: rng.integers(0, 3)]:
            angle = rng.uniform(0, 2 * np.pi)
            pixels[k] += rng.uniform(5, 80) * np.array([np.cos(angle), np.sin(angle)])
            planted.add((f"{i:03}", sensor, int(label.ids[k])))
        return CornerLabels(label.ids, pixels)

    clean = scene(14, **NOISY).dataset()
    spoiled = relabelled(clean, plant)
    result, plain = (calibrate(spoiled, Options(loss=loss)) for loss in ("huber", "linear"))
    assert result.converged
    assert {(r.collection, r.sensor, r.label) for r in result.rejected} == planted
    assert all(r.kind == "pixel" and r.pattern == "board" and 3 < r.residual < 90 for r in result.rejected)
    assert sigmas_apart(calibrate(clean), result) < 3
    assert sigmas_apart(calibrate(clean), plain) > 6
    assert plain.rejected == ()


def test_rejected_points_are_named_by_their_place_among_the_labelled_points():
    def plant(i: int, _: str, label: Labels) -> Labels:
        if i != 3 or isinstance(label, CornerLabels):
            return label
        points = label.points.copy()
        points[20] *= 1.3  # 0.5 m too far
        points[label.limits[-3]] = points[label.limits[-3]] @ np.array([[0.99, 0.14, 0], [-0.14, 0.99, 0], [0, 0, 1.0]])
        return PointLabels(points, label.limits)

    dataset = relabelled(camera_and_lidar(**NOISY).dataset(), plant)
    limit = dataset.collections[3].labels["board", "lidar"].limits[-3]
    rejected = {(r.collection, r.sensor, r.kind, r.label) for r in calibrate(dataset).rejected if r.sensor == "lidar"}
    assert ("003", "lidar", "range", 20) in rejected
    assert ("003", "lidar", "border", int(limit)) in rejected
    assert {r[0] for r in rejected} == {"003"}


@pytest.mark.thorough(but_first=3)
@pytest.mark.parametrize("scene", [stereo, eye_in_hand, two_bodies], ids=lambda s: s.__name__)
@pytest.mark.parametrize("seed", [1, 6, 12])
def test_nonsense_in_some_views_leads_to_the_optimum_or_to_a_reason(scene, seed):
    rng = np.random.default_rng(seed)
    bad = rng.permutation(12)[:3]

    def spoil(i: int, sensor: str, label: Labels) -> Labels:
        spoilt = i in bad and sensor in ("left", "cam", "a")
        return CornerLabels(label.ids, rng.uniform(0, 900, label.pixels.shape)) if spoilt else label

    dataset = scene(12, seed=seed, pixel_noise=0.3).dataset(seed)
    result = calibrate(relabelled(dataset, spoil))
    assert result.converged == (result.reason == "")
    assert all(np.isfinite(T).all() for T in result.transforms.values())
    if scene is eye_in_hand:
        assert result.converged
        assert errors(dataset, result.transforms)[0] < 0.05


def test_a_point_that_lies_nowhere_near_the_pattern_is_rejected():
    def turn(i: int, _: str, label: Labels) -> Labels:
        if i != 3 or isinstance(label, CornerLabels):
            return label
        points = label.points.copy()
        points[20] *= -1.0
        return PointLabels(points, label.limits)

    clean = camera_and_lidar(**NOISY).dataset()
    result = calibrate(relabelled(clean, turn))
    assert result.converged
    assert ("003", "lidar", "range", 20) in {(r.collection, r.sensor, r.kind, r.label) for r in result.rejected}
    assert sigmas_apart(calibrate(clean), result) < 1
