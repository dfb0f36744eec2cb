"""Views of a chessboard from its other end are turned back where half a turn, and nothing else, makes them agree."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.diagnosis.diagnose import diagnose
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.options import Options
from calibration.engine.estimation.start.ambiguous_views import with_boards_turned_back, with_turned
from calibration.engine.geometry.transforms import distance
from tests.engine.estimation import systems


def scene(name: str) -> Dataset:
    return systems.__dict__[name](16, seed=3, pixel_noise=0.1).dataset()


@pytest.mark.parametrize("name", ["eye_to_hand", "eye_in_hand", "stereo", "two_patterns"])
def test_a_good_recording_stays_as_it_is(name: str) -> None:
    dataset = scene(name)
    assert with_boards_turned_back(dataset) == (dataset, ())


@pytest.mark.parametrize("share", [0.1, 0.3, 0.49])
@pytest.mark.parametrize(("name", "sensor"), [("eye_to_hand", "cam"), ("eye_in_hand", "cam"), ("stereo", "right")])
def test_turned_views_are_turned_back_and_said(name: str, sensor: str, share: float) -> None:
    dataset = scene(name)
    keys = np.random.default_rng(1).permutation(dataset.keys)[: int(share * 16)].tolist()
    wrong = with_turned(dataset, "board", sensor, set(keys))

    found = calibrate(wrong)

    assert {(p, key) for p, _, key in found.turned_views} == {("board", key) for key in keys}
    for edge, T in calibrate(dataset).transforms.items():
        assert max(map(float, distance(T, found.transforms[edge]))) < 1e-6
    said = diagnose(found, wrong, replace(Options(), description="rough"), Limits())
    [warning] = [each for each in said if each.kind == "turned-board"]
    assert (warning.severity, set(warning.collections)) == ("warning", set(keys))
    assert [each for each in said if each.severity == "red"] == []


@pytest.mark.parametrize(("name", "sensor"), [("eye_to_hand", "cam"), ("eye_in_hand", "cam"), ("stereo", "right")])
def test_where_most_are_numbered_from_the_other_end(name: str, sensor: str) -> None:
    """On an arm the fewer are turned, since its board may begin at either end; two cameras have one numbering each."""
    dataset = scene(name)
    order = np.random.default_rng(1).permutation(dataset.keys).tolist()
    fewer, more = set(order[:4]), set(order[4:])
    found = with_boards_turned_back(with_turned(dataset, "board", sensor, more))[1]
    assert {key for _, _, key in found} == (more if name == "stereo" else fewer)


def test_grids_of_circles_are_turned_back_too() -> None:
    dataset = scene("eye_to_hand")
    circles = {name: replace(pattern, kind="circles") for name, pattern in dataset.patterns.items()}
    wrong = with_turned(replace(dataset, patterns=circles), "board", "cam", set(dataset.keys[:4]))
    found = calibrate(wrong)
    assert {key for _, _, key in found.turned_views} == set(dataset.keys[:4])
    (said,) = [each for each in diagnose(found, wrong, Options(), Limits()) if each.kind == "turned-board"]
    assert "asymmetric grid" in said.text


def test_views_that_are_wrong_otherwise_are_not_turned() -> None:
    dataset = scene("eye_to_hand")
    collections = list(dataset.collections)
    collections[3], collections[9] = (
        replace(collections[i], labels=collections[j].labels) for i, j in ((3, 9), (9, 3))
    )
    assert with_boards_turned_back(replace(dataset, collections=tuple(collections)))[1] == ()


def test_a_public_recording_with_one_view_from_the_other_end(shared_data: Path) -> None:
    folder = shared_data / "door" / "real" / "04-symmetric-board-180-deg" / "data" / "robot"
    if not folder.is_dir():
        pytest.skip(f"no {folder.name} of a public recording")
    found = calibrate(read_dataset(folder))
    assert found.turned_views == (("board", "camera", "012"),)
    assert found.rms_px < 0.6
    assert found.dropped_views == ()
