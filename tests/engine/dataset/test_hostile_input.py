"""With any content of the files, a dataset is read, or refused with one line."""

import copy
import json
import math
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from calibration.base import InputError
from calibration.engine.dataset.configuration import parse_configuration, read_configuration
from calibration.engine.dataset.document import Node
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.dataset.sensor_data import decode_pcd
from calibration.engine.dataset.writing import write_dataset
from calibration.engine.evaluation.truth import read_truth, truth_of
from tests.engine.dataset import documents

scalars = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 12),
    st.sampled_from([10**18, -(2**63), 2**63, 10**400, 0.5, 1e-320, 1e154, 1e308, math.nan, math.inf, -math.inf, -0.0]),
    st.sampled_from(
        ["", "world", "mount", "cam", "lidar", "board", "000", "a\nb", "\ud800", "a\0", "../x", "/", "3.0"]
    ),
    st.floats(),
    st.text(max_size=5),
)
values = st.recursive(
    scalars,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=8,
)
many = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


def places(node: Any, way: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Every place in a document."""
    children = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    return [way, *(place for key, child in children for place in places(child, (*way, key)))]


def at(document: Any, way: tuple[Any, ...]) -> Any:
    for key in way:
        document = document[key]
    return document


@st.composite
def broken(draw: st.DrawFn, original: documents.Document) -> Any:
    """A document that was changed in one to three places: replaced, removed, renamed, doubled, swapped."""
    result = copy.deepcopy(original)
    for _ in range(draw(st.integers(1, 3))):
        *way, key = draw(st.sampled_from(places(result)[1:] or [(0,)]))
        if not isinstance(at(result, tuple(way)), dict | list) or not at(result, tuple(way)):
            continue
        parent = at(result, tuple(way))
        match draw(st.sampled_from(["value", "number", "remove", "key", "copy", "swap"])):
            case "value":
                parent[key] = draw(values)
            case "number":
                parent[key] = draw(st.floats() | st.integers())
            case "remove":
                del parent[key]
            case "key" if isinstance(parent, dict):
                parent[draw(st.sampled_from(["", "world", "7", "x-y"]) | st.text(max_size=4))] = parent.pop(key)
            case "key":
                parent.append(parent[key])
            case "copy":
                parent[key] = copy.deepcopy(at(result, draw(st.sampled_from(places(result)))))
            case "swap":
                other = draw(st.sampled_from(list(parent) if isinstance(parent, dict) else range(len(parent))))
                parent[key], parent[other] = parent[other], parent[key]
        if not isinstance(result, dict) or not result:
            break
    return result


def is_a_message(error: InputError, path: Path) -> None:
    """One line that can be printed and that names the file."""
    assert str(error).isprintable()
    assert str(path) in str(error)


def survives(folder, content: bytes) -> None:
    """Read it, and if that works, write it and read it again."""
    path = folder / "dataset.json"
    path.write_bytes(content)
    try:
        dataset = read_dataset(path)
    except InputError as error:
        is_a_message(error, path)
        return
    assert any(collection.labels for collection in dataset.collections)
    for sensor in dataset.sensors.values():
        assert np.isfinite(dataset.transform(dataset.world, sensor.frame)).all()
    for pattern in dataset.patterns.values():
        assert np.isfinite(pattern.corners).all()
        assert np.isfinite(dataset.transform(dataset.world, pattern.parent_link)).all()
    again = read_dataset(write_dataset(dataset, folder / "out"))
    assert again.keys == dataset.keys
    for edge, T in dataset.transforms.items():
        np.testing.assert_array_equal(again.transforms[edge], T)
    for name, pattern in dataset.patterns.items():
        np.testing.assert_array_equal(again.patterns[name].corners, pattern.corners)
        np.testing.assert_array_equal(again.patterns[name].outline, pattern.outline)
    with suppress(InputError):  # a transform to calibrate that differs between collections is no truth
        truth_of(dataset)


@pytest.fixture
def folder(tmp_path):
    documents.write(tmp_path, documents.document())
    return tmp_path


@many
@given(broken(documents.document()))
def test_a_broken_document(folder, content):
    survives(folder, json.dumps(content).encode())


@many
@given(broken(documents.version_2()))
def test_a_broken_document_of_version_2(folder, content):
    survives(folder, json.dumps(content).encode())


CLOUD_IN_DOCUMENT = documents.changed(
    documents.document(),
    {
        "collections/000/data/lidar": {
            "height": 3,
            "width": 3,
            "point_step": 12,
            "row_step": 36,
            "fields": [{"name": axis, "offset": 4 * i, "datatype": 7} for i, axis in enumerate("xyz")],
            "data": list(documents.CLOUD.tobytes()),
        }
    },
)


@many
@given(broken(CLOUD_IN_DOCUMENT["collections"]["000"]["data"]["lidar"]))
def test_a_broken_message(folder, message):
    content = documents.changed(documents.document(), {"collections/000/data/lidar": message})
    survives(folder, json.dumps(content).encode())


@many
@given(st.data())
def test_broken_bytes(folder, data):
    content = bytearray(json.dumps(documents.document(), indent=1).encode())
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(content) - 1))
        content[place : place + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
    survives(folder, bytes(content))


@many
@given(st.data())
def test_a_broken_cloud(data):
    header = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z i\nSIZE 4 4 4 2\nTYPE F F F U\nCOUNT 1 1 1 1\nWIDTH 2\nHEIGHT 1\n"
        f"POINTS 2\nDATA {data.draw(st.sampled_from(['binary', 'ascii', 'binary_compressed']))}\n"
    )
    content = bytearray(header.encode() + data.draw(st.just(b"1 2 3 4\n5 6 7 8\n") | st.binary(max_size=40)))
    for _ in range(data.draw(st.integers(0, 4))):
        place = data.draw(st.integers(0, len(content) - 1))
        new = data.draw(
            st.binary(max_size=3) | st.sampled_from([b"9" * 13, b"\n", b"-1", b"0", b"DATA binary\n", b"nan"])
        )
        content[place : place + data.draw(st.integers(0, 3))] = new
    try:
        points = decode_pcd(bytes(content))
    except InputError:
        return
    assert points.ndim == 2
    assert points.shape[1] == 3
    points.sum()  # all of it lies in memory that is ours


@many
@given(broken(documents.document()["calibration_config"]))
def test_a_broken_configuration(tmp_path, content):
    try:
        parse_configuration(Node(tmp_path / "config.yml", (), content))
    except InputError as error:
        is_a_message(error, tmp_path / "config.yml")


@many
@given(st.data())
@example(None)
def test_broken_yaml(tmp_path, data):
    path = tmp_path / "config.yml"
    config = documents.document()["calibration_config"]
    content = bytearray(json.dumps(config, indent=1).replace('"', "").replace(",", "").encode())
    for _ in range(data.draw(st.integers(0, 4)) if data else 0):
        place = data.draw(st.integers(0, len(content) - 1))
        new = st.sampled_from(
            [b"\n", b"? ", b"- ", b"&a ", b"*a ", b"!!binary ", b"!!python/object:os.system ", b"2024-13-45"]
        )
        content[place : place + data.draw(st.integers(0, 3))] = data.draw(new | st.binary(max_size=2))
    path.write_bytes(bytes(content))
    try:
        read_configuration(path)
    except InputError as error:
        is_a_message(error, path)


TRUTH = {
    "sensors": {"cam": {"parent": "mount", "child": "cam_link", "trans": [0, 0, 1], "quat": [0, 0, 0, 1]}},
    "patterns": {"000": {"parent": "world", "child": "board_link", "trans": [0, 0, 1], "quat": [0, 0, 0, 1]}},
    "pattern": {"parent": "hand", "child": "board_link", "trans": [0, 0, 1], "quat": [0, 0, 0, 1]},
    "seed": 1,
}


@many
@given(broken(TRUTH))
def test_a_broken_truth(tmp_path, content):
    path = tmp_path / "ground_truth.json"
    path.write_text(json.dumps(content))
    try:
        truth = read_truth(path)
    except InputError as error:
        is_a_message(error, path)
        return
    assert all(np.isfinite(T).all() for T in truth.transforms.values())
