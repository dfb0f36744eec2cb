"""Duplicated labels are refused by name; a robot at standstill is not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.base import InputError
from calibration.engine.dataset.model import Collection, Dataset
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.diagnosis.copies import check_copies, without_copies
from tests.engine.estimation.systems import eye_in_hand, hand_and_world

DATASETS = Path(__file__).parents[3] / "datasets"


def refusal(dataset: Dataset) -> str:
    with pytest.raises(InputError) as error:
        check_copies(dataset)
    return str(error.value)


def repeated(dataset: Dataset, times: int, i: int = 0) -> Dataset:
    """The dataset with collection i so many times more, at the end."""
    whole = dataset.with_collections([*range(len(dataset.collections)), *[i] * times])
    N = len(dataset.collections)
    renamed = tuple(replace(c, key=f"{k:03}") if k >= N else c for k, c in enumerate(whole.collections))
    return replace(whole, collections=renamed)


def with_view_of(dataset: Dataset, i: int, j: int, sensor: str) -> Dataset:
    """The dataset with what a sensor saw in collection i in collection j too."""
    pattern = next(iter(dataset.patterns))
    labels = {**dataset.collections[j].labels, (pattern, sensor): dataset.collections[i].labels[pattern, sensor]}
    collections = list(dataset.collections)
    collections[j] = Collection(dataset.keys[j], labels)
    return replace(dataset, collections=tuple(collections))


@pytest.mark.parametrize("name", ["t2rgb", "rlbot", "riwbot", "softbot", "spjbot"])
def test_data_that_ship_have_no_copies(name: str) -> None:
    check_copies(read_dataset(DATASETS / name))


def test_a_copied_collection_is_named(shared_data: Path) -> None:
    recorded = read_dataset(shared_data / "t2rgb-paper")
    check_copies(recorded)
    assert "the same labels, to the last digit: 022 = 003; expected" in refusal(repeated(recorded, 1, 3))
    assert ": 022 = 003, 023 = 003, 024 = 003, " in refusal(repeated(recorded, 20, 3))
    assert "and 12 more" in refusal(repeated(recorded, 20, 3))


def test_copies_are_left_out_and_named(shared_data: Path) -> None:
    recorded = read_dataset(shared_data / "t2rgb-paper")
    assert without_copies(recorded) == (recorded, ())
    left, [warning] = without_copies(repeated(repeated(recorded, 1, 0), 2, 5))
    assert left.keys == recorded.keys
    assert (warning.severity, warning.collections) == ("warning", ("022", "023", "024"))
    assert "3 of 25 collections" in warning.text
    assert "022 = 000, 023 = 005, 024 = 005" in warning.text
    check_copies(left)


def test_a_copied_view_is_left_out_of_the_later_collection() -> None:
    dataset = hand_and_world(pixel_noise=0.1).dataset()
    left, [warning] = without_copies(with_view_of(dataset, 2, 5, "cam"))
    assert (warning.sensors, warning.collections) == (("cam",), ("005",))
    assert ("board", "cam") in left.collections[2].labels
    assert set(left.collections[5].labels) == {("board", "static")}
    check_copies(left)


@pytest.mark.parametrize("name", ["t2rgb", "riwbot"])
def test_a_copied_view_is_named(name: str) -> None:
    dataset = read_dataset(DATASETS / name)
    sensor = next(iter(dataset.sensors))
    if name == "riwbot":  # whose only view it is
        assert "005 = 002" in refusal(with_view_of(dataset, 2, 5, sensor))
        return
    message = refusal(with_view_of(dataset, 2, 5, sensor))
    assert (
        f"sensor '{sensor}' has the same labels of 'pattern_1', to the last digit, in collections 005 = 002" in message
    )


def test_a_copied_view_of_an_arm_that_has_moved() -> None:
    dataset = with_view_of(hand_and_world(pixel_noise=0.1).dataset(), 2, 5, "cam")
    assert "sensor 'cam' has the same labels" in refusal(dataset)


def test_a_camera_that_sees_a_fixed_pattern_from_a_fixed_place_sees_the_same() -> None:
    dataset = hand_and_world().dataset()
    views = [collection.labels["board", "static"] for collection in dataset.collections]
    assert all(
        np.array_equal(view.pixels[view.ids.argsort()], views[0].pixels[views[0].ids.argsort()]) for view in views
    )
    check_copies(with_view_of(dataset, 2, 5, "static"))


def test_repeated_shots_with_noise_are_no_copies() -> None:
    scene = eye_in_hand(6)
    index = [0, 0, 1, 1, 2, 3, 4, 5]
    dataset = scene.dataset().with_collections(index)
    rng = np.random.default_rng(0)
    noisy = tuple(
        Collection(
            f"{i:03}",
            {k: replace(v, pixels=v.pixels + rng.normal(0, 0.1, v.pixels.shape)) for k, v in c.labels.items()},
        )
        for i, c in enumerate(dataset.collections)
    )
    check_copies(replace(dataset, collections=noisy))
