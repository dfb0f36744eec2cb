"""Dropped views: warned of or red, by their share, with sensors and collections named."""

from collections.abc import Sequence
from dataclasses import replace

import pytest

from calibration.engine.diagnosis.finding import Severity
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.diagnosis.wrong_views import wrong_views
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.covariance.result import Calibration, DroppedView
from tests.engine.estimation.systems import stereo


@pytest.fixture(scope="module")
def clean() -> Calibration:
    return calibrate(stereo(30, pixel_noise=0.1).dataset())


def with_dropped(clean: Calibration, sensors: Sequence[str], keys: Sequence[str]) -> Calibration:
    dropped = tuple(DroppedView(sensor, "board", key, 100.0 + int(key), 2.5) for key in keys for sensor in sensors)
    return replace(clean, dropped_views=dropped)


@pytest.mark.parametrize(("keys", "severity"), [(["003"], "warning"), (["003", "007"], "red")])
def test_by_their_share(clean: Calibration, keys: list[str], severity: Severity) -> None:
    [found] = wrong_views(with_dropped(clean, ["left"], keys))
    assert (found.kind, found.severity, found.sensors) == ("wrong-views", severity, ("left",))
    assert found.collections == tuple(keys)
    assert found.value == pytest.approx(len(keys) / 30)
    assert f"{100 + int(keys[-1])} mm and 2.5 deg" in found.text


def test_two_sensors_contradict_each_other(clean: Calibration) -> None:
    [found] = wrong_views(with_dropped(clean, ["left", "right"], [f"{i:03}" for i in range(22)]))
    assert found.text.startswith("left and right contradict each other in collections 000, 001, 002, 003, ")
    assert ", 018, 019 and 2 more, by up to 121 mm" in found.text


def test_nothing_dropped(clean: Calibration) -> None:
    assert not wrong_views(clean)


@pytest.mark.parametrize(
    ("key", "said"),
    [
        ("000", "or left has moved before collection 001."),
        ("029", "or left has moved after collection 028, and the result is that of before."),
    ],
)
def test_at_an_end_of_the_recording_it_may_have_moved(clean: Calibration, key: str, said: str) -> None:
    dropped = with_dropped(clean, ["left"], [key])
    [found] = wrong_views(dropped, Limits())
    assert (found.severity, found.collections) == ("red", (key,))
    assert f"either image and pose are of different moments, {said}" in found.text
    [within] = wrong_views(dropped, Limits(translation_mm=200.0))
    assert within.severity == "warning"


def test_in_the_middle_few_are_a_warning(clean: Calibration) -> None:
    [found] = wrong_views(with_dropped(clean, ["left"], ["011"]), Limits())
    assert found.severity == "warning"
