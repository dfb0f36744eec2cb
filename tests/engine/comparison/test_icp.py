"""ICP between LiDARs and depth cameras."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base import InputError, UndeterminedError
from calibration.engine.comparison.sensor_pairs import MOST_POINTS, align, icp, why_not_icp
from calibration.engine.dataset.model import Dataset, PointLabels
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import apply, distance, inverse, retract, transform
from tests.engine.evaluation.scene import lidar_and_camera, range_pair, two_cameras, with_labels

EACH = pytest.mark.parametrize("method", [icp, partial(icp, result="average"), partial(icp, result="best")])
ONE, TWO = ("one_mount", "one_base"), ("two_mount", "two_base")


def disturbed(dataset: Dataset, edge, size=1.0) -> Dataset:
    twist = np.broadcast_to(size * np.array([0.02, -0.02, 0.01, 0.02, -0.03, 0.02]), (len(dataset.keys), 6))
    return dataset.with_transforms({edge: retract(dataset.transforms[edge], twist)})


def same_points(seed=0, n=6) -> Dataset:
    """Two LiDARs that measure the very same places."""
    dataset, _ = range_pair(seed, n, ("lidar3d", "lidar3d"))
    T = dataset.transform("two_scan", "one_scan")
    seen = [c.labels["board", "one"] for c in dataset.collections]
    return with_labels(
        dataset, "two", [PointLabels(apply(t, label.points), label.limits) for t, label in zip(T, seen, strict=True)]
    )


def error(truth: Dataset, found: Dataset) -> tuple[float, float]:
    frames = truth.sensors["one"].frame, truth.sensors["two"].frame
    return tuple(float(e.max()) for e in distance(truth.transform(*frames), found.transform(*frames)))


@EACH
def test_the_same_places_give_the_exact_pose(method):
    dataset = same_points()
    found = method(disturbed(dataset, TWO, 0.3))
    assert max(error(dataset, found)) < 1e-9
    assert found.transforms[ONE] is dataset.transforms[ONE]  # anchored


def test_the_second_sensor_may_be_the_anchored_one():
    dataset = replace(same_points(1), anchored="two")
    found = icp(disturbed(dataset, ONE, 0.3))
    np.testing.assert_allclose(found.transforms[ONE], dataset.transforms[ONE], atol=1e-9)
    assert found.transforms[TWO] is dataset.transforms[TWO]


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("kinds", [("lidar3d", "depth"), ("depth", "depth"), ("depth", "lidar3d")])
def test_different_points_come_near(kinds):
    dataset, _ = range_pair(2, 8, kinds, noise=1e-3)
    start = disturbed(dataset, dataset.sensors["two"].edge)
    together, average = error(dataset, icp(start)), error(dataset, icp(start, "average"))
    assert together[0] < 0.012 < error(dataset, start)[0]
    assert together[1] < 0.03 < error(dataset, start)[1]
    assert together[0] < average[0]  # a single board lets it slide


@given(st.integers(0, 2**32 - 1))
def test_a_rigid_copy_is_laid_on_its_original(seed):
    rng = np.random.default_rng(seed)
    cloud = rng.uniform(-1, 1, (60, 3))
    T = transform(rotations.exp(rng.normal(size=3) * 0.005), rng.normal(size=3) * 0.005)
    found = align([(cloud, apply(inverse(T), cloud))], np.eye(4))
    np.testing.assert_allclose(found.T_first_second, T, atol=1e-9)
    assert found.rms < 1e-9


def test_clouds_far_apart_do_not_match():
    dataset = same_points(3)
    with pytest.raises(UndeterminedError, match=r"no points within 0.1 m of each other; it starts from the dataset's"):
        icp(dataset.with_transforms({TWO: dataset.transforms[TWO] @ transform(np.eye(3), [0, 0, 3.0])}))


def test_a_collection_in_which_nothing_matches_is_left_out_of_the_average():
    dataset = same_points(4)
    labels = [c.labels["board", "two"] for c in dataset.collections]
    assert isinstance(labels[0], PointLabels)
    labels[0] = replace(labels[0], points=labels[0].points + 5)
    wrong = with_labels(dataset, "two", labels)
    for method in (partial(icp, result="average"), partial(icp, result="best")):
        assert max(error(dataset, method(disturbed(wrong, TWO, 0.3)))) < 1e-9


def test_clouds_are_thinned():
    rng = np.random.default_rng(5)
    dataset = same_points(5, n=2)
    points = apply(dataset.transform("one_scan", "two_scan")[0], rng.uniform(0, 1, (5 * MOST_POINTS, 3)))
    many = with_labels(dataset, "one", [PointLabels(points, np.arange(0))] * 2)
    others = apply(dataset.transform("two_scan", "one_scan")[0], points)
    many = with_labels(many, "two", [PointLabels(others, np.arange(0))] * 2)
    assert max(error(many, icp(many))) < 1e-9


def test_why_it_does_not_apply():
    dataset = same_points(6, n=2)
    assert why_not_icp(dataset) is None
    few = with_labels(dataset, "two", [PointLabels(np.ones((9, 3)), np.arange(0))] * 2)
    for other, reason in (
        (
            two_cameras(n=2)[0],
            r"it needs two LiDARs or depth cameras, and there are 'left' \(rgb\)",
        ),
        (lidar_and_camera(n=2)[0], "it needs two LiDARs or depth cameras, and there are"),
        (replace(dataset, additional_transforms=(("a", "b"),)), "it cannot calibrate additional transforms"),
        (few, "it needs a view of 10 points by both sensors, and there is none"),
    ):
        with pytest.raises(InputError, match=f"ICP does not apply: {reason}"):
            icp(other)


def test_it_ends_after_so_many_iterations(monkeypatch):
    dataset = same_points(7)
    start = disturbed(dataset, TWO)
    monkeypatch.setattr("calibration.engine.comparison.sensor_pairs.MAX_ITERATIONS", 1)
    assert 1e-3 < error(dataset, icp(start))[0] < error(dataset, start)[0]


def test_the_best_collection_is_the_one_that_fits():
    dataset = same_points(8)
    rng = np.random.default_rng(8)
    labels = [c.labels["board", "two"] for c in dataset.collections]
    for i, label in enumerate(labels):
        assert isinstance(label, PointLabels)
        if i != 3:
            labels[i] = replace(label, points=label.points + rng.normal(size=label.points.shape) * 0.01)
    noisy = with_labels(dataset, "two", labels)
    assert max(error(dataset, icp(disturbed(noisy, TWO, 0.3), "best"))) < 1e-9
    assert error(dataset, icp(disturbed(noisy, TWO, 0.3), "average"))[0] > 1e-4
