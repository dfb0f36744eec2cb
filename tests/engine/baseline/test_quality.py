"""Worse quality than the accepted one: red on the same data, on other data a warning where it is more than chance."""

from dataclasses import replace

import pytest

from calibration.engine.baseline.calibration_document import CalibrationDocument, TaskDocument
from calibration.engine.baseline.quality import BaselineSettings
from calibration.engine.baseline.verdict import Accepted, against_baseline
from calibration.engine.diagnosis.finding import Finding
from calibration.engine.tasks.robot_task import TaskUnit
from tests.engine.baseline.scenes import stereo, taken


@pytest.fixture(scope="module")
def before() -> CalibrationDocument:
    return taken(stereo(1))


def findings(before: CalibrationDocument, now: CalibrationDocument) -> list[Finding]:
    found = against_baseline(Accepted(BaselineSettings(), before), now)[1]
    return [each for each in found if each.kind == "baseline-quality"]


def on_other_data(before: CalibrationDocument, **changes: object) -> CalibrationDocument:
    return replace(before, data="f" * 64, **changes)  # type: ignore[arg-type]


def test_the_extents_are_those_of_the_pattern_in_the_images(before: CalibrationDocument) -> None:
    assert set(before.extents) == set(before.views)
    assert all(20 < each < 2000 for each in before.extents.values())


@pytest.mark.parametrize(("pixel", "warned"), [(0.3, False), (0.6, True)])
def test_more_noise_than_light_and_focus_usually_make_is_a_warning_on_other_data_and_red_on_the_same(
    pixel: float, warned: bool, before: CalibrationDocument
) -> None:
    noise = replace(before.noise, pixel=pixel)
    assert [each.severity for each in findings(before, on_other_data(before, noise=noise))] == ["warning"] * warned
    assert {each.severity for each in findings(before, replace(before, noise=noise))} == {"red"}


def test_noise_of_a_bad_baseline_is_compared_with_twice_that(before: CalibrationDocument) -> None:
    bad = replace(before, noise=replace(before.noise, pixel=0.5))
    assert findings(bad, on_other_data(before, noise=replace(before.noise, pixel=0.9))) == []
    assert findings(bad, on_other_data(before, noise=replace(before.noise, pixel=2.0))) != []


def test_what_is_chance_is_nothing(before: CalibrationDocument) -> None:
    assert before.rms_px is not None
    assert findings(before, on_other_data(before, rms_px=1.1 * before.rms_px)) == []
    assert findings(before, on_other_data(before, rms_px=0.5 * before.rms_px)) == []


def test_noise_of_a_smaller_pattern_in_the_images_is_not_compared(before: CalibrationDocument) -> None:
    assert before.rms_px is not None
    farther = {name: 0.6 * extent for name, extent in before.extents.items()}
    assert findings(before, on_other_data(before, rms_px=2.0, extents=farther)) == []
    without = replace(before, extents={})  # of an older file
    assert findings(without, on_other_data(before, rms_px=2.0)) != []


@pytest.mark.parametrize(
    ("counts", "significant"),
    [
        (((2, 28), (4, 26)), False),
        (((0, 28), (1, 26)), False),
        (((2, 28), (18, 26)), True),
        (((0, 400), (60, 400)), True),
    ],
)
def test_a_share_of_rejected_labels_is_compared_with_the_chance_of_both(
    counts: tuple[tuple[int, int], tuple[int, int]], significant: bool, before: CalibrationDocument
) -> None:
    """Pairs of poses: one label a view. The first are the halves of a public recording."""
    first, second = (
        on_other_data(before, rejected_labels=rejected, labels=labels, views={"camera": labels})
        for rejected, labels in counts
    )
    found = findings(replace(first, data="e" * 64), second)
    assert bool(found) is significant
    assert {each.severity for each in found} <= {"warning"}


def test_an_error_bar_is_compared_at_the_same_number_of_collections(before: CalibrationDocument) -> None:
    def wider(factor: float, effective: float) -> CalibrationDocument:
        poses = tuple(
            replace(each, own_mm=tuple(factor * v for v in each.own_mm), held={}) if each.own_mm else each
            for each in before.poses
        )
        return on_other_data(before, poses=poses, effective_collections=effective)

    accepted = wider(1.0, 40.0)
    assert findings(replace(accepted, data="e" * 64), wider(2.0, 10.0)) == []
    [found] = findings(replace(accepted, data="e" * 64), wider(2.0, 40.0))
    assert found.severity == "warning"


def test_a_task_that_the_robot_does_worse_is_named(before: CalibrationDocument) -> None:
    """By more than a quarter; of one that is asked in another unit nothing is said."""

    def with_error(most: float, unit: TaskUnit = "mm") -> CalibrationDocument:
        return replace(before, tasks={"grasp": TaskDocument(most / 2, most, unit)})

    accepted = with_error(1.0)
    assert not findings(accepted, with_error(1.24))
    [worse] = findings(accepted, with_error(1.26))
    assert (worse.kind, worse.value) == ("baseline-quality", 1.26)
    assert "'grasp'" in worse.text
    assert not findings(accepted, with_error(9.0, "deg"))
    assert not findings(before, with_error(9.0))
