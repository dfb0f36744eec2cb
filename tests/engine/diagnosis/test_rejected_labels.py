"""Labels that do not fit: noted, warned of, or red, by their share."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.engine.dataset.model import CornerLabels, Dataset
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.diagnosis.finding import Severity
from calibration.engine.diagnosis.limits import Limits, of_the_labels
from calibration.engine.diagnosis.rejected_labels import rejected_labels, wrong_views
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.covariance.result import Calibration, DroppedView, RejectedLabel
from tests.engine.estimation.scenes import Labels, relabelled
from tests.engine.estimation.systems import stereo


def with_wrong(dataset: Dataset, share: float, size: float, view: int | None = None) -> Dataset:
    """The dataset with a share of the corners moved by this many pixels: of all views of left, or of one."""
    rng = np.random.default_rng(1)

    def move(i: int, sensor: str, label: Labels) -> Labels:
        if not isinstance(label, CornerLabels) or sensor != "left" or view not in (None, i):
            return label
        wrong = rng.permutation(len(label.ids)) < round(share * len(label.ids))
        return replace(label, pixels=label.pixels + size * wrong[:, None])

    return relabelled(dataset, move)


@pytest.mark.parametrize(
    ("share", "size", "severity"),
    [(0.0, 0.0, None), (0.12, 1.1, "note"), (0.05, 20.0, "warning"), (0.12, 20.0, "red")],
)
def test_by_their_share_and_size(share: float, size: float, severity: str | None) -> None:
    dataset = with_wrong(stereo(8, pixel_noise=0.2).dataset(), share, size)
    found = rejected_labels(calibrate(dataset), Limits(translation_mm=0.1, rotation_deg=0.01))
    assert [each.severity for each in found] == ([severity] if severity else [])
    if severity in ("warning", "red"):
        assert found[0].sensors == ("left",)
        assert found[0].value == pytest.approx(share / 2, abs=0.01)
        assert f"of {2 * 8 * len(dataset.patterns['board'].corners)} labels do not fit" in found[0].text


def test_many_that_cannot_move_the_result_by_its_limit_are_a_warning() -> None:
    calibration = calibrate(with_wrong(stereo(8, pixel_noise=0.2).dataset(), 0.12, 20.0))
    [sigma, _] = of_the_labels(calibration, "right" if calibration.gauge == "left" else "left")
    most = 2.5 * np.sqrt(len(calibration.rejected)) * sigma
    for limit, severity in ((0.9 * most, "red"), (1.1 * most, "warning")):
        [found] = rejected_labels(calibration, Limits(translation_mm=limit, rotation_deg=90))
        assert found.severity == severity


def test_one_view_is_named() -> None:
    found = rejected_labels(calibrate(with_wrong(stereo(40, pixel_noise=0.2).dataset(), 0.3, 20.0, view=7)), Limits())
    assert [(each.kind, each.severity, each.collections) for each in found] == [
        ("rejected-view", "warning", ("007",)),
        ("rejected-labels", "note", ("007",)),
    ]


def test_real_images_have_tails(shared_data: Path) -> None:
    [note] = rejected_labels(calibrate(read_dataset(shared_data / "t2rgb-paper")), Limits())
    assert note.severity == "note"


@pytest.mark.parametrize(("view", "severities"), [(0, ["red", "note"]), (39, ["red", "note"]), (20, ["note"])])
def test_a_view_at_an_end_that_does_not_fit_has_moved(view: int, severities: list[str]) -> None:
    calibration = calibrate(stereo(40, pixel_noise=0.1).dataset())
    key, count = f"{view:03}", len(calibration.dataset.patterns["board"].corners)
    rejected = tuple(RejectedLabel(key, "left", "board", "pixel", i, 0.9) for i in range(count * 2 // 3))
    calibration = replace(calibration, rejected=rejected)
    found = rejected_labels(calibration, Limits(translation_mm=0.1))
    assert [each.severity for each in found] == severities
    assert all(f"collection {key}, at an end" in each.text for each in found if each.severity == "red")
    [note] = rejected_labels(calibration, Limits(translation_mm=100.0))  # the labels are off by far less than that
    assert note.severity == "note"


WIDE = Limits(translation_mm=1e4, rotation_deg=180)


@pytest.fixture(scope="module")
def clean() -> Calibration:
    return calibrate(stereo(30, pixel_noise=0.1).dataset())


def with_dropped(clean: Calibration, sensors: Sequence[str], keys: Sequence[str]) -> Calibration:
    dropped = tuple(DroppedView(sensor, "board", key, 100.0 + int(key), 2.5) for key in keys for sensor in sensors)
    return replace(clean, dropped_views=dropped)


MANY = [f"{i:03}" for i in range(1, 9)]


@pytest.mark.parametrize(
    ("keys", "severity"), [(["003"], "warning"), (["003", "007"], "warning"), (MANY[:-1], "warning"), (MANY, "red")]
)
def test_the_majority_is_right_unless_more_than_a_quarter_is_wrong(
    clean: Calibration, keys: list[str], severity: Severity
) -> None:
    [found] = wrong_views(with_dropped(clean, ["left"], keys), WIDE)
    assert (found.kind, found.severity, found.sensors) == ("wrong-views", severity, ("left",))
    assert found.collections == tuple(keys)
    assert found.value == pytest.approx(len(keys) / 30)
    assert f"{100 + int(keys[-1])} mm and 2.5 deg" in found.text


def test_two_sensors_contradict_each_other(clean: Calibration) -> None:
    [found] = wrong_views(with_dropped(clean, ["left", "right"], [f"{i:03}" for i in range(22)]), WIDE)
    assert found.text.startswith("left and right contradict each other in collections 000, 001, 002, 003, ")
    assert ", 018, 019 and 2 more, by up to 121 mm" in found.text


def test_nothing_dropped(clean: Calibration) -> None:
    assert not wrong_views(clean, WIDE)


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


@pytest.mark.parametrize(("turns", "severity"), [((2.5, 2.5, 2.4), "red"), ((2.5, 170.0, 40.0), "warning")])
def test_views_at_an_end_that_are_wrong_by_other_poses_each_are_of_no_move(
    clean: Calibration, turns: Sequence[float], severity: Severity
) -> None:
    dropped = tuple(DroppedView("left", "board", f"{27 + i:03}", 4 * turn, turn) for i, turn in enumerate(turns))
    [found] = wrong_views(replace(clean, dropped_views=dropped), Limits())
    assert found.severity == severity
    assert ("has moved" in found.text) == (severity == "red")


@pytest.mark.parametrize(
    ("keys", "severity"),
    [(["028", "029"], "red"), (["009", "028", "029"], "red"), (["014", "029"], "warning"), (["000", "014"], "warning")],
)
def test_wrong_views_elsewhere_are_accidents_that_may_lie_at_an_end_too(
    clean: Calibration, keys: Sequence[str], severity: Severity
) -> None:
    [found] = wrong_views(with_dropped(clean, ["left"], keys), Limits())
    assert found.severity == severity


def test_in_the_middle_few_are_a_warning(clean: Calibration) -> None:
    [found] = wrong_views(with_dropped(clean, ["left"], ["011"]), Limits())
    assert found.severity == "warning"
