"""A sensor whose data are mirrored is named; one that is right, or wrong in another way, is not."""

from dataclasses import replace

import pytest

from calibration.dataset.model import Dataset
from calibration.diagnosis.diagnose import diagnose
from calibration.diagnosis.limits import Limits
from calibration.diagnosis.mirrored import mirrored, with_mirrored
from calibration.estimation.calibrate import calibrate
from calibration.estimation.options import Options
from tests.estimation import systems


def rig() -> Dataset:
    return systems.camera_and_lidar(12, seed=3).dataset(3)


def test_mirrored_points_are_named() -> None:
    wrong = with_mirrored(rig(), "lidar")
    [red, *_] = diagnose(calibrate(wrong), wrong, Options(), Limits(translation_mm=5.0))
    assert (red.kind, red.severity) == ("mirrored-sensor", "red")
    assert "points of 'lidar'" in red.text
    assert "lidar" in red.sensors


def test_what_is_as_it_should_be_is_not_mirrored_back() -> None:
    dataset = rig()
    assert mirrored(calibrate(dataset), dataset, Options()) == ()
    assert mirrored(None, dataset, replace(Options(), start="given")) == ()


@pytest.mark.parametrize("sensor", ["cam", "lidar"])
def test_twice_mirrored_is_as_it_was(sensor: str) -> None:
    dataset = rig()
    again = with_mirrored(with_mirrored(dataset, sensor), sensor)
    for before, after in zip(dataset.collections, again.collections, strict=True):
        for key, label in before.labels.items():
            for name in ("pixels", "points"):
                if hasattr(label, name):
                    assert getattr(after.labels[key], name) == pytest.approx(getattr(label, name), abs=1e-9)
