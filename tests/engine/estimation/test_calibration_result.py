"""Statistics of a result: residuals, degrees of freedom, warnings; all of it checked against the labels."""

import numpy as np
import pytest

from calibration.engine.dataset.model import CornerLabels, Labels, PointLabels
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.engine.geometry.transforms import apply
from tests.engine.estimation.scenes import errors, pose, relabelled
from tests.engine.estimation.systems import (
    ALL,
    camera_and_lidar,
    eye_in_hand,
    hand_and_world,
    stereo,
    two_arms,
    two_bodies,
)

NOISY = {"pixel_noise": 0.3, "range_noise": 0.01, "partial": 0.3}


@pytest.mark.parametrize("scene", ALL)
def test_residuals_are_those_of_the_calibrated_dataset(scene):
    result = calibrate(ALL[scene](**NOISY).dataset(1))
    dataset = result.dataset
    squares = []
    for view in result.residuals:
        if view.kind != "pixel":
            continue
        sensor, pattern = dataset.sensors[view.sensor], dataset.patterns[view.pattern]
        for key, magnitudes in zip(view.collections, view.magnitudes, strict=True):
            one = dataset.with_collections([dataset.keys.index(key)])
            label = one.collections[0].labels[view.pattern, view.sensor]
            T = one.transform(sensor.frame, pattern.link)[0]
            error = np.linalg.norm(sensor.camera.project(apply(T, pattern.corners[label.ids])) - label.pixels, axis=-1)
            np.testing.assert_allclose(magnitudes[label.ids], error, atol=1e-9)
            assert np.isfinite(magnitudes).sum() == len(label.ids)
            squares.append(error**2)
    assert result.rms_px == pytest.approx(np.sqrt(np.concatenate(squares).mean()))
    assert result.rms_px == pytest.approx(0.3 * np.sqrt(2), rel=0.15)


def test_residuals_of_a_lidar_are_distances_along_its_rays():
    result = calibrate(camera_and_lidar(**NOISY).dataset(1))
    dataset = result.dataset
    (view,) = (r for r in result.residuals if r.kind == "range")
    for i, key in enumerate(view.collections):
        points = dataset.collections[dataset.keys.index(key)].labels["board", "lidar"].points
        T = dataset.transform("lidar", "board_link")[i]
        lengths = np.linalg.norm(points, axis=-1)
        expected = np.abs(T[:3, 2] @ T[:3, 3] / (points / lengths[:, None] @ T[:3, 2]) - lengths)
        np.testing.assert_allclose(view.magnitudes[i, : len(points)], expected, rtol=0.01, atol=1e-6)
        assert np.isnan(view.magnitudes[i, len(points) :]).all()


@pytest.mark.parametrize(
    ("scene", "parameters"),
    [(stereo, 6 + 12 * 6), (eye_in_hand, 12), (two_bodies, 12 + 12 * 6), (hand_and_world, 18), (camera_and_lidar, 78)],
)
@pytest.mark.parametrize("loss", ["linear", "huber"])
def test_degrees_of_freedom_are_labels_less_parameters(scene, parameters, loss):
    dataset = scene(**{**NOISY, "border": False}).dataset()
    labels = 0
    for collection in dataset.collections:
        for label in collection.labels.values():
            labels += 2 * len(label.ids) if isinstance(label, CornerLabels) else len(label.points)
    result = calibrate(dataset, Options(loss=loss))
    assert result.degrees_of_freedom == labels - parameters
    assert result.cost == pytest.approx(result.degrees_of_freedom, rel=0.1)


def test_free_transforms_have_a_covariance_and_the_others_none():
    result = calibrate(hand_and_world(**NOISY).dataset())
    assert set(result.transforms) == {
        ("flange", "mount"),
        ("world", "static"),
        ("world", "base"),
        ("world", "board_link"),
    }
    assert set(result.covariances) == set(result.transforms) - {("world", "static")}
    for covariance in result.covariances.values():
        np.testing.assert_allclose(covariance, covariance.T)
        assert (np.linalg.eigvalsh(covariance) > 0).all()


def test_the_anchored_sensor_stays_as_it_is():
    dataset = stereo(anchored="right", **NOISY).dataset()
    result = calibrate(dataset, noise=StartingNoise(0.5, 0.5))
    edge = ("world", "right")
    np.testing.assert_array_equal(result.transforms[edge], dataset.transforms[edge][0])
    np.testing.assert_array_equal(result.dataset.transforms[edge], dataset.transforms[edge])


def test_what_is_not_calibrated_stays_as_it_is():
    dataset = eye_in_hand(**NOISY).dataset()
    result = calibrate(dataset)
    for edge in (("world", "flange"), ("mount", "cam")):
        np.testing.assert_array_equal(result.dataset.transforms[edge], dataset.transforms[edge])
    assert result.dataset.collections == dataset.collections


def test_unused_views_are_reported():
    def few(i: int, sensor: str, label: Labels) -> Labels:
        if i == 2 and sensor == "cam":
            return CornerLabels(label.ids[:3], label.pixels[:3])
        return PointLabels(label.points[:5], np.zeros(0, int)) if i == 4 and sensor == "lidar" else label

    result = calibrate(relabelled(camera_and_lidar(**NOISY).dataset(), few))
    assert result.converged
    assert result.notes == (
        "collection 002, cam: 3 corners, at least 4 are needed",
        "collection 004, lidar: 5 points, at least 10 are needed",
        "collection 002, lidar: no camera saw 'board'",
    )


@pytest.mark.parametrize("start", ["linear", "given"])
def test_a_transform_without_a_linear_start_is_reported(start):
    dataset = two_arms(**NOISY).dataset()
    result = calibrate(dataset, Options(start), StartingNoise(0.1, 0.1, 4))
    assert result.converged
    assert result.notes == ("no equation gives 'world-base' a linear start; it starts from its guess",)
    assert errors(dataset, result.transforms)[0] < 0.002


@pytest.mark.parametrize("start", ["linear", "given"])
@pytest.mark.parametrize("noise", [StartingNoise(), StartingNoise(0.2, 0.1, 3)])
def test_the_fixed_sensor_has_the_pose_of_the_description(start, noise):
    dataset = stereo(**NOISY).dataset()
    whole_rig = {edge: pose(1, 2, 3) @ dataset.transforms[edge] for edge in (("world", "left"), ("world", "right"))}
    result = calibrate(dataset.with_transforms(whole_rig), Options(start), noise)
    assert result.converged
    assert result.gauge == "left"
    np.testing.assert_array_equal(result.transforms["world", "left"], whole_rig["world", "left"][0])
