"""A calibrated dataset of other labels, or with other frames moved, is distinguished from the requested one."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calibration.base.tables.table import parse_table
from calibration.engine.dataset.model import CornerLabels, Dataset, PointLabels
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.diagnosis.software_output import moved_frames, not_evaluated, same_labels, table_follows
from calibration.engine.evaluation.table import Table
from calibration.engine.geometry.transforms import translation
from tests.engine.estimation.scenes import Labels, relabelled
from tests.engine.estimation.systems import camera_and_lidar, eye_in_hand, hand_and_world, stereo

GIVEN = stereo(6).dataset()


def changed(sensor: str, change: Callable[[Labels], Labels | None]) -> Dataset:
    """The dataset with what a sensor labelled in collection 002 changed."""
    return relabelled(GIVEN, lambda i, name, label: change(label) if (i, name) == (2, sensor) else label)


def shifted(label: Labels) -> Labels:
    assert isinstance(label, CornerLabels)
    return replace(label, pixels=label.pixels + 0.5)


def fewer(label: Labels) -> Labels:
    assert isinstance(label, CornerLabels)
    return CornerLabels(label.ids[1:], label.pixels[1:])


def reordered(label: Labels) -> Labels:
    assert isinstance(label, CornerLabels)
    return CornerLabels(label.ids[::-1], label.pixels[::-1] + 1e-4)


def bent(pattern: str) -> Dataset:
    board = GIVEN.patterns[pattern]
    return replace(GIVEN, patterns={pattern: replace(board, corners=1.01 * board.corners)})


@pytest.mark.parametrize(
    ("found", "message"),
    [
        (GIVEN.with_collections(range(5)), r"it has 5 collections, expected 6 \(not in both: 005\)"),
        (replace(GIVEN, sensors={"left": GIVEN.sensors["left"]}), "its sensors are left, expected left, right"),
        (replace(GIVEN, anchored="left"), "its anchored sensor is left, expected none"),
        (replace(GIVEN, patterns={}), "its patterns are none, expected board"),
        (bent("board"), "the corners of its pattern 'board' lie up to .* mm elsewhere"),
        (changed("right", shifted), "collection 002: the labels of 'right' differ by up to 0.5 px"),
        (changed("right", fewer), "collection 002: the labels of 'right' are .* corners, expected the"),
        (changed("right", lambda _: None), "collection 002 lacks labels of 'right'"),
    ],
)
def test_other_labels_are_named(found: Dataset, message: str) -> None:
    [finding] = same_labels(found, GIVEN)
    assert finding.severity == "red"
    assert re.search(message, finding.text), finding.text


def test_the_same_in_another_order_and_with_fewer_digits_are_the_same() -> None:
    assert same_labels(changed("right", reordered), GIVEN) == ()
    assert same_labels(GIVEN.with_transforms({("world", "left"): np.eye(4)}), GIVEN) == ()


def test_points_are_labels_too() -> None:
    given = camera_and_lidar(4).dataset()

    def farther(_: int, __: str, label: Labels) -> Labels:
        return replace(label, points=1.01 * label.points) if isinstance(label, PointLabels) else label

    [finding] = same_labels(relabelled(given, farther), given)
    assert "the labels of 'lidar' differ by up to" in finding.text
    assert "and 1 more differences" in finding.text


def moved(dataset: Dataset, edge: tuple[str, str], metres: float) -> Dataset:
    return dataset.with_transforms({edge: dataset.transforms[edge] @ translation(np.array([metres, 0, 0]))})


def test_frames_that_are_not_calibrated_stay() -> None:
    given = eye_in_hand(6).dataset()
    [sensor] = given.sensors.values()
    other = next(edge for edge in given.transforms if edge != sensor.edge and "board_link" not in edge)
    assert moved_frames(given, given, Limits()) == ()
    assert moved_frames(moved(given, sensor.edge, 1.0), given, Limits()) == ()
    assert moved_frames(moved(given, other, 0.0005), given, Limits()) == ()
    [finding] = moved_frames(moved(given, other, 0.005), given, Limits())
    assert finding.severity == "red"
    assert f"moves '{'-'.join(other)}', which is not calibrated, by 5 mm" in finding.text
    assert moved_frames(moved(given, other, 0.005), given, Limits(translation_mm=10)) == ()


def test_the_anchored_sensor_stays() -> None:
    given = hand_and_world(6).dataset()
    assert given.anchored is not None
    [finding] = moved_frames(moved(given, given.sensors[given.anchored].edge, 0.1), given, Limits())
    assert f"moves the anchored sensor '{given.anchored}', by 100 mm" in finding.text


VALUES = np.array([[0.31, 1.2], [5.2, 2.4], [0.04, 3.6]])
MADE = Table("Collection #", ("RMS (pix)", "Trans (mm)"), ("000", "004", "007"), VALUES)


def said(text: str) -> list[tuple[str, str]]:
    return [(found.severity, found.text) for found in table_follows(parse_table(text, "t.csv"), MADE)]


def test_its_own_table_follows() -> None:
    assert said(MADE.to_csv()) == []


@pytest.mark.parametrize(
    "text",
    [
        "Collection #;Trans (mm);Colour;RMS (pix)\n0;1.2;red;0.3\n4;2.4;red;5.2\n7;3.6;red;0.0\n",  # few digits
        "Collection #,RMS (pix)\n004,5.21\n000,0.3094\nAverages,1.85\n",  # another order, one left out, a percent off
        "Collection,RMS (pix)\nAverages,1.85e0\n",
        "Collection,RMS (pix)\nAverages,18.5e-1\nMedian,0.31\n",
    ],
)
def test_digits_order_and_method_may_differ(text: str) -> None:
    assert said(text) == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Collection #,RMS (pix)\n004,0.31\n", "the table says RMS (pix) 0.31 for 004, its dataset gives 5.2"),
        ("Collection #,RMS (pix)\nAverages,0.31\n", "the table says RMS (pix) 0.31 on average, its dataset gives 1.85"),
        ("Collection #,Trans (mm)\n000,0\n004,0\nAverages,0\n", "the table says Trans (mm) 0 for 000"),
        ("Collection #,RMS (pix)\n000,---\n", "the table says RMS (pix) --- for 000, its dataset gives 0.31"),
        ("Collection #,RMS (pix)\n000,nan\n", "the table says RMS (pix) nan for 000"),
        ("Collection #,RMS (pix)\n000,0\n004,0\n", "the table says RMS (pix) 0 for 000, its dataset gives 0.31"),
        ("Collection #,RMS (pix)\nAverages,2.1\n", "RMS (pix) 2.1 on average"),
        ("Collection #,RMS (pix)\n000,-0.31\n", "the table says RMS (pix) -0.31 for 000"),
        ("Collection #,RMS (pix)\n000,\n", "the table says RMS (pix) nothing for 000"),
        ("Collection #,RMS (pix)\n100,0.31\n", "the table has no row of the collections of its dataset (000, 004, 007"),
    ],
)
def test_what_does_not_follow_is_red(text: str, message: str) -> None:
    [(severity, found)] = said(text)
    assert severity == "red"
    assert message in found


def test_only_the_first_difference_is_reported() -> None:
    [(_, text)] = said("Collection #,RMS (pix),Trans (mm)\n000,0,0\n004,0,0\n007,0,0\nAverages,0,0\n")
    assert "RMS (pix) 0 for 000" in text
    assert "and 6 more values differ" in text


def test_other_columns_are_not_verified() -> None:
    [(severity, text)] = said("Name,Error\na,1\n")
    assert severity == "note"
    assert "not verified" in text


def test_what_the_sensor_did_not_see_has_no_value() -> None:
    missing = np.array([[True, False], [False, False], [False, False]])
    made = Table(MADE.key, MADE.columns, MADE.labels, VALUES, missing=missing)
    assert table_follows(parse_table(made.to_csv(), "t.csv"), made) == ()


def test_without_an_evaluation_the_rms_is_compared_with_the_noise() -> None:
    assert [found.severity for found in not_evaluated(0.0, 0.15)] == ["red"]
    for rms, noise in ((0.1, 0.15), (None, 0.15), (0.0, float("nan"))):
        assert [found.severity for found in not_evaluated(rms, noise)] == ["note"]
