"""Records: what a pose leaves, as JSON and back."""

import json

import numpy as np
import pytest

from calibration.geometry.transforms import apply
from calibration.simulation.collection.play import Play
from calibration.simulation.collection.record import Record


def test_a_record_survives_json(rlbot_records: list[Record]) -> None:
    for record in rlbot_records:
        again = Record.from_json(record.to_json())
        assert again == record
        assert again.to_json() == record.to_json()


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"number": 1}', "null"])
def test_what_is_no_record(text: str) -> None:
    with pytest.raises((ValueError, TypeError, KeyError)):
        Record.from_json(text)


def test_lost_and_kept(rlbot_records: list[Record]) -> None:
    assert [record.kept for record in rlbot_records] == [True, False, True]
    assert [record.key for record in rlbot_records] == ["000", "001", "002"]
    lost = rlbot_records[1]
    assert lost.labels == {"lidar_right": 0, "rgb_left": 0}
    assert lost.initial == {"pattern_1": {"detected": False}}
    assert lost.errors == {}
    labels = lost.collection["labels"]["pattern_1"]
    assert labels["rgb_left"] == {"detected": False, "idxs": []}
    assert labels["lidar_right"] == {"detected": False, "idxs": [], "idxs_limit_points": []}


def test_corner_errors_are_those_against_the_projected_truth(rlbot_play: Play, rlbot_records: list[Record]) -> None:
    system = rlbot_play.system
    labels = rlbot_records[0].collection["labels"]["pattern_1"]["rgb_left"]["idxs"]
    found = np.array([[label["x"], label["y"]] for label in labels])
    ids = [label["id"] for label in labels]
    T_camera_pattern = rlbot_play.true.pattern_in("rgb_left", "pattern_1")[0]
    true = system.cameras["rgb_left"].camera.project(apply(T_camera_pattern, system.patterns["pattern_1"].corners[ids]))
    error = found - true
    told = rlbot_records[0].errors["rgb_left"]
    assert told.count == len(labels) == rlbot_records[0].labels["rgb_left"]
    assert told.rms == pytest.approx(np.sqrt((error**2).sum(-1).mean()), abs=1e-6)
    assert told.mean == pytest.approx(error.mean(0), abs=1e-6)
    assert told.largest == pytest.approx(np.linalg.norm(error, axis=-1).max(), abs=1e-6)


def test_cells_are_those_with_a_corner(rlbot_records: list[Record]) -> None:
    record = rlbot_records[0]
    labels = record.collection["labels"]["pattern_1"]["rgb_left"]["idxs"]
    expected = {4 * min(int((p["y"] + 0.5) / (800 / 3)), 2) + min(int((p["x"] + 0.5) / 300), 3) for p in labels}
    assert record.cells == {"rgb_left": tuple(sorted(expected))}


def test_numbers_are_rounded(rlbot_records: list[Record]) -> None:
    """The last bits of a machine's arithmetic do not show."""

    def check(value: object, decimals: int) -> None:
        if isinstance(value, float):
            assert round(value, decimals) == value
        for part in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
            check(part, decimals)

    document = json.loads(rlbot_records[0].to_json())
    check(document["collection"]["labels"], 4)
    check(document["collection"]["transforms"], 9)
    check(document["initial"], 5)
    check(document["errors"], 6)
