"""Notes on residuals that are no noise: alike in a part of the image or the range, in neighbours, or large."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.base.arrays import Array
from calibration.engine.dataset.model import CornerLabels, Dataset, Labels, PointLabels
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.diagnosis.residuals import residuals
from calibration.engine.diagnosis.what_does_not_fit import what_does_not_fit
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.options import ALL_EXACT
from tests.engine.estimation import systems


def with_labels(dataset: Dataset, change: "Change") -> Dataset:
    """The dataset with other labels."""
    return replace(
        dataset,
        collections=tuple(
            replace(c, labels={key: change(key[1], label) for key, label in c.labels.items()})
            for c in dataset.collections
        ),
    )


class Change:
    """Displaces corners by a field of their image, or points by their range."""

    def __init__(self, sensor: str, pixels: object = None, ranges: object = None) -> None:
        self.sensor, self.pixels, self.ranges = sensor, pixels, ranges

    def __call__(self, sensor: str, label: Labels) -> Labels:
        if sensor == self.sensor and isinstance(label, CornerLabels) and callable(self.pixels):
            return CornerLabels(label.ids, label.pixels + self.pixels(label.pixels))
        if sensor == self.sensor and isinstance(label, PointLabels) and callable(self.ranges):
            far = np.linalg.norm(label.points, axis=-1, keepdims=True)
            return replace(label, points=label.points * (1 + self.ranges(far) / far))
        return label


def notes(dataset: Dataset) -> dict[str, str]:
    return {each.kind: each.text for each in residuals(calibrate(dataset, Options(assume=ALL_EXACT)))}


@pytest.mark.parametrize("make", [systems.stereo, systems.camera_and_lidar, systems.jointed_arm])
def test_noise_is_worth_no_note(make: object) -> None:
    assert callable(make)
    assert notes(make(20, seed=2, pixel_noise=0.1).dataset(2)) == {}


def test_a_part_of_the_image_where_all_views_err_alike_is_named() -> None:
    camera = systems.WIDE

    def bump(pixels: Array) -> Array:
        away = pixels - (0.5 * camera.width, 0.5 * camera.height)
        return np.outer(np.exp(-((away / (0.12 * camera.width)) ** 2).sum(-1)), (3.0, 0.0))

    scene = systems.covering(80, seed=3, cameras=2, pixel_noise=0.1)
    name = next(iter(scene.dataset(3).sensors))
    found = notes(with_labels(scene.dataset(3), Change(name, pixels=bump)))
    assert f"corners of '{name}' at" in found["residual-pattern"]
    assert "calibrate the intrinsics" in found["residual-pattern"]


def test_neighbouring_corners_that_err_alike_are_named() -> None:
    rng = np.random.default_rng(1)

    def smooth(pixels: Array) -> Array:
        waves = rng.uniform(0, 2 * np.pi, (2, 1)) + 0.02 * pixels[:, 0] + 0.02 * pixels[:, 1]
        return 0.5 * np.sin(waves).T

    dataset = systems.eye_to_hand(20, seed=4, pixel_noise=0.05).dataset(4)
    found = notes(with_labels(dataset, Change("cam", pixels=smooth)))
    assert "corners of 'cam' err alike" in found["residual-correlation"]


def test_a_sensor_that_scatters_more_than_the_others_is_named() -> None:
    rng = np.random.default_rng(2)
    noisy = Change("right", pixels=lambda pixels: rng.normal(0, 0.4, pixels.shape))
    found = notes(with_labels(systems.stereo(20, seed=5, pixel_noise=0.1).dataset(5), noisy))
    assert found["noisy-sensor"].startswith("the labels of 'right' on 'board' scatter")


def test_noise_that_no_detector_makes_is_named() -> None:
    found = notes(systems.eye_to_hand(20, seed=6, pixel_noise=0.6).dataset(6))
    assert "a detector errs by 0.35 px at most" in found["noisy-sensor"]


def test_small_errors_that_add_up_are_red_together() -> None:
    dataset = systems.eye_to_hand(24, seed=1, pixel_noise=0.05).dataset(1)
    camera = dataset.sensors["cam"].camera
    assert camera is not None
    values = camera.intrinsics
    values[:2] *= 1.005
    values[2:4] += 2.0
    wrong = dataset.with_cameras({"cam": camera.with_intrinsics(values)})
    calibration = calibrate(wrong, Options(assume=ALL_EXACT))
    each = what_does_not_fit(calibration, Limits(translation_mm=1e3, rotation_deg=10.0))
    assert len(each) > 1
    assert all(one.severity == "note" for one in each)
    alone = max(one.moves_mm or 0.0 for one in each)
    together, *_ = what_does_not_fit(calibration, Limits(translation_mm=1.001 * alone, rotation_deg=10.0))
    assert together.severity == "red"
    assert "together they move cam" in together.text
