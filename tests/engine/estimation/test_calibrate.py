"""The whole calibration: one result whatever the guess and the order, inputs untouched, outliers named."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from calibration.base.arrays import Array
from calibration.engine.dataset.model import CornerLabels, Dataset, Labels, PointLabels
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.engine.geometry.transforms import inverse
from tests.engine.estimation.scenes import errors, relabelled, sigmas_apart
from tests.engine.estimation.systems import ALL, camera_and_lidar, two_patterns

NOISY = {"pixel_noise": 0.3, "range_noise": 0.01, "partial": 0.3}
EVERY_SCENE = pytest.mark.parametrize("scene", ALL)


@pytest.mark.thorough(but_first=8)
@EVERY_SCENE
@pytest.mark.parametrize("loss", ["linear", "huber"])
def test_every_start_gives_the_same_result(scene, loss):
    dataset = ALL[scene](**NOISY).dataset(1)
    first = calibrate(dataset, Options(loss=loss))
    assert first.converged
    for noise in (StartingNoise(0.1, 0.1, 3), StartingNoise(2, 3, 5)):
        result = calibrate(dataset, Options(loss=loss), noise)
        assert result.converged
        assert sigmas_apart(first, result) < 1e-5
        assert result.cost == pytest.approx(first.cost, abs=1e-6)


@pytest.mark.thorough(but_first=8)
@EVERY_SCENE
@pytest.mark.parametrize("loss", ["linear", "huber"])
def test_exact_labels_give_the_truth(scene, loss):
    dataset = ALL[scene](border=False, partial=0.3).dataset()
    result = calibrate(dataset, Options(loss=loss), StartingNoise(0.5, 0.5, 2))
    assert result.converged, result.reason
    assert result.rejected == ()
    assert max(errors(dataset, result.transforms, result.gauge)) < 1e-9
    # the whole dataset, moving patterns among them: what each sensor sees is where it is
    for pattern, sensor in {key for c in dataset.collections for key in c.labels}:
        ends = (dataset.sensors[sensor].frame, dataset.patterns[pattern].link)
        seen = [i for i, _ in dataset.detections(pattern, sensor)]
        np.testing.assert_allclose(pose_of(result.dataset, *ends)[seen], pose_of(dataset, *ends)[seen], atol=1e-9)


def pose_of(dataset: Dataset, start: str, end: str) -> Array:
    """As `Dataset.transform`, with NaN where the pattern was not seen."""
    T = np.broadcast_to(np.eye(4), (len(dataset.collections), 4, 4))
    for step in dataset.tree.path(start, end):
        edge = dataset.transforms[step.parent, step.child]
        T = T @ (inverse(edge) if step.inverted else edge)
    return T


def arrays(dataset: Dataset) -> list[np.ndarray]:
    out = [*dataset.transforms.values(), *(p.corners for p in dataset.patterns.values())]
    for collection in dataset.collections:
        for label in collection.labels.values():
            out += [label.ids, label.pixels] if isinstance(label, CornerLabels) else [label.points, label.limits]
    return out


@pytest.mark.parametrize("scene", ["stereo", "camera and lidar", "hand and world", "two patterns"])
@pytest.mark.parametrize("start", ["linear", "given"])
def test_a_dataset_is_not_changed_and_may_be_read_only(scene, start):
    dataset = ALL[scene](**NOISY).dataset()
    before = [array.copy() for array in arrays(dataset)]
    for array in arrays(dataset):
        array.flags.writeable = False
    result = calibrate(dataset, Options(start=start), StartingNoise(0.1, 0.1))
    for array, old in zip(arrays(dataset), before, strict=True):
        np.testing.assert_array_equal(array, old)
    for edge in result.transforms:
        assert not np.shares_memory(result.transforms[edge], dataset.transforms[edge])


@cache
def in_order(scene: str) -> tuple[Dataset, Calibration]:
    """A scene's dataset, and its calibration."""
    dataset = ALL[scene](**NOISY).dataset(2)
    return dataset, calibrate(dataset)


@pytest.mark.thorough(but_first=8)
@EVERY_SCENE
@pytest.mark.parametrize("order", ["collections", "sensors", "labels"])
def test_the_order_does_not_matter(scene, order):
    dataset, first = in_order(scene)
    if order == "collections":
        other = dataset.with_collections(np.random.default_rng(0).permutation(len(dataset.collections)).tolist())
    elif order == "sensors":
        other = replace(dataset, sensors=dict(reversed(dataset.sensors.items())))
    else:
        other = relabelled(dataset, reverse)
    second = calibrate(other)
    held = {s.edge for s in dataset.sensors.values() if s.name in (first.gauge, second.gauge)}
    ends = {edge: second.transforms[edge] for edge in first.transforms}
    back = np.eye(4)
    for edge in held:
        back = first.transforms[edge] @ inverse(second.transforms[edge])
    for edge, T in ends.items():
        np.testing.assert_allclose(back @ T, first.transforms[edge], atol=1e-6)
    assert second.cost == pytest.approx(first.cost, rel=1e-6)
    assert second.noise_levels.pixel == pytest.approx(first.noise_levels.pixel, rel=1e-6)


def reverse(_: int, __: str, label: Labels) -> Labels:
    if isinstance(label, PointLabels):
        return PointLabels(label.points[::-1], len(label.points) - 1 - label.limits)
    return CornerLabels(label.ids[::-1], label.pixels[::-1])


def test_the_same_input_gives_the_same_bytes():
    dataset = camera_and_lidar(**NOISY).dataset()
    first, second = (calibrate(dataset, noise=StartingNoise(0.5, 0.5, 7)) for _ in range(2))
    for edge in first.transforms:
        assert first.transforms[edge].tobytes() == second.transforms[edge].tobytes()
    assert first.rejected == second.rejected
    assert first.cost == second.cost


def test_moving_patterns_have_poses_only_in_collections_with_views():
    dataset = two_patterns(8, **NOISY).dataset()
    result = calibrate(dataset)
    missing = np.isnan(result.dataset.transforms["world", "board_link"]).all((1, 2))
    assert missing.tolist() == [False, True] * 4
    assert np.isfinite(result.dataset.transforms["world", "still_link"]).all()
    assert np.isfinite(result.transforms["world", "still_link"]).all()
