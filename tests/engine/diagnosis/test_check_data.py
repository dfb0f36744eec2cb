"""Patterns with other corner numbers than in the dataset are refused, with the board that fits."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.base import InputError
from calibration.engine.dataset.model import CornerLabels, Dataset, Labels
from calibration.engine.dataset.pattern import grid, tag_grid
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.diagnosis.check_data import check_board_order
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import apply, transform
from tests.engine.estimation.scenes import relabelled

DATASETS = Path(__file__).parents[3] / "datasets"
T2RGB = read_dataset(DATASETS / "t2rgb")


def refusal(dataset: Dataset) -> str:
    with pytest.raises(InputError) as error:
        check_board_order(dataset)
    return str(error.value)


def numbered(dataset: Dataset, number: Callable[[int], int], *sensors: str) -> Dataset:
    """The dataset with other ids in the labels of some cameras."""

    def change(_: int, sensor: str, label: Labels) -> Labels:
        if sensor not in sensors or not isinstance(label, CornerLabels):
            return label
        return replace(label, ids=np.array([number(i) for i in label.ids.tolist()]))

    return relabelled(dataset, change)


@pytest.mark.parametrize("name", ["t2rgb", "rlbot", "riwbot", "softbot", "spjbot"])
def test_shipped_datasets_have_the_right_corner_numbers(name: str) -> None:
    check_board_order(read_dataset(DATASETS / name))


@pytest.mark.parametrize(("columns", "rows", "expected"), [(8, 11, "x: 11, y: 8"), (10, 9, "x: 11"), (12, 8, "x: 11")])
def test_rows_of_another_length(shared_data: Path, columns: int, rows: int, expected: str) -> None:
    for dataset in (T2RGB, read_dataset(shared_data / "t2rgb-paper")):
        check_board_order(dataset)
        pattern = replace(dataset.patterns["pattern_1"], corners=grid(columns, rows, 0.06, (0.0, 0.0)))
        message = refusal(replace(dataset, patterns={"pattern_1": pattern}))
        assert f"/dimension: found x: {columns}, y: {rows}, but the labels of 'left_camera' are numbered by" in message
        assert f"by rows of 11 corners; expected {expected} (x counts the corners of a row)" in message


def test_an_aprilgrid_with_another_number_of_tags_in_a_row() -> None:
    """Labels of 4 x 3 tags, seen by t2rgb's cameras, in a dataset with 3 x 4."""
    printed, said = (tag_grid(columns, rows, 0.1, 0.3) for columns, rows in ((4, 3), (3, 4)))

    def change(_: int, sensor: str, label: Labels) -> Labels:
        camera = T2RGB.sensors[sensor].camera
        if not isinstance(label, CornerLabels) or camera is None:
            return label
        pose = transform(rotations.exp(np.array([0.1 * len(label.ids) % 0.5, 0.3, 0.2])), [-0.2, 0.2, 1.5])
        return CornerLabels(np.arange(48), camera.project(apply(pose, printed)))

    old = T2RGB.patterns["pattern_1"]
    right = replace(old, kind="aprilgrid", corners=printed)
    dataset = relabelled(replace(T2RGB, patterns={"pattern_1": right}), change)
    check_board_order(dataset)
    message = refusal(replace(dataset, patterns={"pattern_1": replace(right, corners=said)}))
    assert "/dimension: found x: 3, y: 4, but the labels of 'left_camera' are numbered by" in message
    assert "by rows of 4 tags; expected x: 4, y: 3 (x counts the tags of a row)" in message


@pytest.mark.parametrize(
    ("number", "said"),
    [
        (lambda i: i % 11 * 8 + i // 11, "numbered by rows of 8 corners; expected x: 8, y: 11"),
        (lambda i: i * i * i % 89 - 1 if i else 87, "fit no view of a flat pattern"),
        (lambda i: i // 11 * 11 + 10 - i % 11, "those of 'left_camera' do not"),
    ],
    ids=["down the columns", "at random", "mirrored"],
)
def test_one_detector_that_numbers_otherwise(number: Callable[[int], int], said: str) -> None:
    message = refusal(numbered(T2RGB, number, "right_camera"))
    assert "right_camera" in message
    assert said in message


def flipped_since(first: int) -> Dataset:
    """Images of the right camera that are upside down from a collection on."""

    def change(i: int, sensor: str, label: Labels) -> Labels:
        camera = T2RGB.sensors[sensor].camera
        if i < first or sensor != "right_camera" or not isinstance(label, CornerLabels) or camera is None:
            return label
        return replace(label, pixels=label.pixels * (1, -1) + (0, camera.height - 1))

    return relabelled(T2RGB, change)


def test_images_that_are_flipped_since_some_collection() -> None:
    n = len(T2RGB.collections)
    message = refusal(flipped_since(n - 4))
    assert "right_camera" in message
    assert f"in collections {', '.join(T2RGB.keys[n - 4 :])} look mirrored" in message
    check_board_order(flipped_since(n - 1))  # a wrong view among many


def test_corners_that_all_cameras_number_mirrored_do_no_harm() -> None:
    check_board_order(numbered(T2RGB, lambda i: i // 11 * 11 + 10 - i % 11, "left_camera", "right_camera"))
