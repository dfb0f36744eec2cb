"""Usable labels: the others are removed and reported."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.base import InputError, UndeterminedError
from calibration.engine.dataset.model import CornerLabels, Dataset, Labels, PointLabels
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.start.build import MINIMUM_CORNERS, usable_labels
from tests.engine.estimation.scenes import Scene, board, relabelled
from tests.engine.estimation.systems import camera_and_lidar, camera_and_lidar2d, eye_in_hand, stereo


def only(
    dataset: Dataset, ids: list[int], collection: int = 2, sensors: tuple[str, ...] = ("left", "right", "cam")
) -> Dataset:
    """With these corners alone, in one collection."""

    def keep(i: int, sensor: str, label: Labels) -> Labels:
        if i != collection or sensor not in sensors or isinstance(label, PointLabels):
            return label
        return CornerLabels(np.array(ids), label.pixels[ids])

    return relabelled(dataset, keep)


def test_a_dataset_in_which_all_labels_count_is_not_changed():
    dataset = camera_and_lidar(6, partial=0.5).dataset()
    usable, ignored = usable_labels(dataset)
    assert ignored == ()
    assert usable.keys == dataset.keys
    assert all(a.labels == b.labels for a, b in zip(usable.collections, dataset.collections, strict=True))


@pytest.mark.parametrize(
    ("ids", "fault"),
    [
        ([], f"0 corners, at least {MINIMUM_CORNERS} are needed"),
        ([0, 1, 7], f"3 corners, at least {MINIMUM_CORNERS} are needed"),
        ([0, 1, 2, 3, 4, 5], "its corners lie on a line"),
        ([0, 6, 12, 18, 24, 5], "its corners lie on a line"),
        ([0, 7, 14, 21], "its corners lie on a line"),
        ([0, 1, 6, 7], None),
        ([0, 1, 2, 3, 4, 5, 6, 7], None),
    ],
)
def test_views_that_leave_the_pose_open_are_left_out(ids, fault):
    dataset = only(stereo(6).dataset(), ids, sensors=("left",))
    usable, ignored = usable_labels(dataset)
    assert ignored == ((f"collection 002, left: {fault}",) if fault else ())
    assert (("board", "left") in usable.collections[2].labels) == (fault is None)
    assert ("board", "right") in usable.collections[2].labels
    assert ("board", "left") in dataset.collections[2].labels


def test_a_collection_without_labels_left_is_left_out_of_the_result():
    dataset = only(stereo(6, pixel_noise=0.3).dataset(), [0, 1, 2, 3, 4])
    result = calibrate(dataset)
    assert result.converged
    assert [w for w in result.notes if "002" in w] == [
        "collection 002, left: its corners lie on a line",
        "collection 002, right: its corners lie on a line",
    ]
    assert "002" not in result.residuals[0].collections
    pattern = result.dataset.transforms["world", "board_link"]
    assert np.isnan(pattern).any((1, 2)).tolist() == [False, False, True, False, False, False]
    assert result.dataset.keys == dataset.keys


def test_too_few_points_are_left_out():
    def few(i: int, sensor: str, label: Labels) -> Labels:
        return PointLabels(label.points[:9], np.array([0, 8])) if (i, sensor) == (1, "lidar") else label

    usable, ignored = usable_labels(relabelled(camera_and_lidar(6).dataset(), few))
    assert ignored == ("collection 001, lidar: 9 points, at least 10 are needed",)
    assert list(usable.collections[1].labels) == [("board", "cam")]


def test_a_scan_line_needs_fewer_points_than_a_plane():
    def few(i: int, sensor: str, label: Labels) -> Labels:
        return PointLabels(label.points[: 2 + i], np.array([0, 1])) if sensor == "scan" and i < 2 else label

    usable, ignored = usable_labels(relabelled(camera_and_lidar2d(6).dataset(), few))
    assert ignored == ("collection 000, scan: 2 points, at least 3 are needed",)
    assert ("board", "scan") in usable.collections[1].labels


def test_a_lidar_needs_a_camera_that_sees_the_moving_pattern_at_the_same_moment():
    scene = camera_and_lidar(6, sees=lambda sensor, _, i: sensor == "lidar" or i != 3)
    usable, ignored = usable_labels(scene.dataset())
    assert ignored == ("collection 003, lidar: no camera saw 'board'",)
    assert usable.keys == ("000", "001", "002", "004", "005")


def test_a_lidar_needs_a_camera_that_ever_sees_the_fixed_pattern():
    once = two_boards()
    assert usable_labels(once.dataset())[1] == ()
    never = replace(once, sees=lambda sensor, pattern, _: sensor == "lidar" or pattern == "board")
    usable, ignored = usable_labels(never.dataset())
    assert len(ignored) == 7
    assert ignored[-1] == "pattern 'still': no collection has enough labels of it"
    assert list(usable.patterns) == ["board"]
    result = calibrate(replace(never, pixel_noise=0.3, range_noise=0.01).dataset())
    assert result.converged
    assert ("world", "still_link") not in result.transforms


def test_a_sensor_without_labels_left_is_an_error():
    def few(_: int, sensor: str, label: Labels) -> Labels:
        return CornerLabels(label.ids[:3], label.pixels[:3]) if sensor == "right" else label

    with pytest.raises(InputError, match="sensor 'right': no collection has enough labels"):
        usable_labels(relabelled(stereo(6).dataset(), few))


def test_fewer_than_two_collections_left_is_an_error():
    dataset = eye_in_hand(3).dataset()
    for collection in (0, 2):
        dataset = only(dataset, [0, 1, 2, 3, 4, 5], collection)
    with pytest.raises(UndeterminedError, match="1 collection has labels; at least 2"):
        usable_labels(dataset)


def test_a_view_that_leaves_the_pose_open_does_not_count_for_a_lidar():
    dataset = only(camera_and_lidar(6).dataset(), [0, 1, 7])
    usable, ignored = usable_labels(dataset)
    assert ignored == (
        "collection 002, cam: 3 corners, at least 4 are needed",
        "collection 002, lidar: no camera saw 'board'",
    )
    assert usable.keys == ("000", "001", "003", "004", "005")


def two_boards() -> Scene:
    """Beside the moving pattern a fixed one, which a camera sees in one collection."""
    scene = camera_and_lidar(6)
    still = board("still", fixed=True, square=0.12)
    transforms = {**scene.transforms, ("world", "still_link"): scene.transforms["world", "board_link"][0]}
    sees = {"sees": lambda sensor, pattern, i: sensor == "lidar" or pattern == "board" or i == 2}
    return replace(scene, patterns=[*scene.patterns, still], transforms=transforms, **sees)


def test_nor_does_it_count_if_the_pattern_is_fixed():
    dataset = two_boards().dataset()
    label = dataset.collections[2].labels["still", "cam"]
    assert isinstance(label, CornerLabels)
    few = CornerLabels(label.ids[:3], label.pixels[:3])
    collections = list(dataset.collections)
    collections[2] = replace(collections[2], labels={**collections[2].labels, ("still", "cam"): few})
    usable, ignored = usable_labels(replace(dataset, collections=tuple(collections)))
    assert ignored[0] == "collection 002, cam: 3 corners, at least 4 are needed"
    assert len(ignored) == 8
    assert list(usable.patterns) == ["board"]


def test_corners_on_a_line_are_found_on_every_pattern():
    usable, ignored = usable_labels(only(two_boards().dataset(), [0, 1, 2, 3, 4, 5]))
    assert [text for text in ignored if "cam" in text and "line" in text] == [
        "collection 002, cam: its corners lie on a line"
    ] * 2
    assert list(usable.patterns) == ["board"]
