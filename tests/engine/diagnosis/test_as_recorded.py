"""Repeated shots are counted once, whatever their noise; small motions are not repeated shots."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from calibration.engine.dataset.model import CornerLabels, Dataset
from calibration.engine.diagnosis.diagnose import repeated
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.covariance.clusters import repeated_collections
from tests.engine.estimation.scenes import Scene, relabelled
from tests.engine.estimation.systems import eye_in_hand, eye_to_hand, ring, stereo

SIGMA = 0.2


def repeating(dataset: Dataset, index: Sequence[int]) -> Dataset:
    """Collections of these indices, each with noise of its own."""
    rng = np.random.default_rng(1)
    chosen = dataset.with_collections(index)
    keyed = tuple(replace(c, key=f"{i:03}") for i, c in enumerate(chosen.collections))

    def noisy(_: int, __: str, label: object) -> object:
        if not isinstance(label, CornerLabels):
            return label
        return replace(label, pixels=label.pixels + rng.normal(0, SIGMA, label.pixels.shape))

    return relabelled(replace(chosen, collections=keyed), noisy)


@pytest.mark.parametrize("scene", [stereo, eye_in_hand, eye_to_hand, ring])
def test_repeated_shots_are_one_cluster(scene: Callable[..., Scene]) -> None:
    index = [0, 1, 1, 2, 3, 0, 4, 5, 5, 5, 6, 7]
    result = calibrate(repeating(scene(8).dataset(), index))
    assert repeated_collections(result.dataset, SIGMA).tolist() == [0, 1, 1, 3, 4, 0, 6, 7, 7, 7, 10, 11]
    [note] = repeated(result)
    assert note.severity == "note"
    assert "4 of 12 collections repeat the poses of others (002 = 001, 005 = 000, 008 = 007, 009 = 007)" in note.text


def test_every_collection_of_a_good_dataset_counts() -> None:
    result = calibrate(stereo(30, pixel_noise=SIGMA).dataset())
    assert repeated_collections(result.dataset, SIGMA).tolist() == list(range(30))
    assert repeated(result) == ()


def test_an_arm_that_has_moved_repeats_nothing() -> None:
    """Both arms of a robot that carry camera and pattern along: the same view, but another pose of the robot."""
    dataset = eye_in_hand(6).dataset()
    twice = dataset.with_collections([0, *range(6)])
    assert repeated_collections(twice, SIGMA).tolist() == [0, 0, 2, 3, 4, 5, 6]
    (edge,) = (e for e, T in dataset.transforms.items() if np.ptp(T, axis=0).max() > 1e-3)
    pattern = dataset.patterns["board"]
    T = twice.transforms[edge].copy()
    T[1, 0, 3] += 0.01
    of_board = np.broadcast_to(twice.transforms[pattern.parent_link, pattern.link][0], T.shape).copy()
    of_board[1] = T[1] @ np.linalg.inv(T[0]) @ of_board[0] if edge[0] == pattern.parent_link else of_board[1]
    moved = twice.with_transforms({edge: T, (pattern.parent_link, pattern.link): of_board})
    assert repeated_collections(moved, SIGMA).tolist() == list(range(7))


def test_repeated_shots_make_no_result_more_certain() -> None:
    """The honest error bar of a dataset is that of its own collections, however often one of them is taken again."""
    once = repeating(eye_to_hand(10).dataset(), range(10))
    often = repeating(eye_to_hand(10).dataset(), [*range(10), *[3] * 40])
    few, many = calibrate(once), calibrate(often)
    edge = once.sensors["cam"].edge
    assert many.sigma_mm(edge) > 0.8 * few.sigma_mm(edge)
    assert many.error_bars is not None
    assert many.error_bars.effective_collections < 10
