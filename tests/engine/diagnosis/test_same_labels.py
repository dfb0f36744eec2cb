"""A calibrated dataset of other labels, or with other frames moved, is distinguished from the requested one."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calibration.engine.dataset.model import CornerLabels, Dataset, PointLabels
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.diagnosis.same_labels import moved_frames, same_labels
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
