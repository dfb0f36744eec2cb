import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from calibration.base import ExitCode, InfrastructureError, InputError
from calibration.engine.dataset.modalities import LIDAR2D
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.dataset.sensor_data import MAX_RAYS, decode_pcd, read_points, write_points
from calibration.engine.dataset.writing import write_dataset
from tests.engine.dataset.documents import MISSING, Document, changed, document, write

POINTS = np.array([[1.5, -2.25, 3.0], [0.1, 0.2, 0.3], [np.nan, 0.0, -0.0]])
COLUMNS = {
    "x": ("F", POINTS[:, 0]),
    "y": ("F", POINTS[:, 1]),
    "z": ("F", POINTS[:, 2]),
    "ring": ("U", np.array([1, 2, 3])),
    "rgb": ("I", np.array([-7, 8, 9])),
}


def pcd(fields: str, sizes: list[int], kind: str = "binary") -> bytes:
    """A PCD file written column by column, independently of the code under test."""
    names = fields.split()
    codes = {"F": "f", "U": "u", "I": "i"}
    dtype = [(name, f"<{codes[COLUMNS[name][0]]}{size}") for name, size in zip(names, sizes, strict=True)]
    cloud = np.zeros(3, dtype)
    for name in names:
        cloud[name] = COLUMNS[name][1]
    header = (
        f"# a comment\nVERSION .7\nFIELDS {fields}\nSIZE {' '.join(map(str, sizes))}\n"
        f"TYPE {' '.join(COLUMNS[name][0] for name in names)}\nCOUNT {' '.join('1' * len(names))}\n"
        f"WIDTH 3\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 3\nDATA {kind}\n"
    )
    lines = "\n".join(" ".join(repr(value.item()) for value in row) for row in cloud) + "\n"
    return header.encode() + (cloud.tobytes() if kind == "binary" else lines.encode())


@pytest.mark.parametrize("kind", ["binary", "ascii"])
@pytest.mark.parametrize(
    ("fields", "sizes"),
    [
        ("x y z", [4, 4, 4]),
        ("x y z", [8, 8, 8]),
        ("x y z ring", [4, 4, 4, 2]),
        ("ring x rgb y z", [1, 4, 4, 4, 4]),
        ("z y x", [4, 4, 4]),
        ("y z x", [8, 8, 8]),
        ("x y z", [4, 8, 4]),
        ("x ring y z", [4, 4, 8, 4]),
        ("x ring y rgb z", [4, 4, 4, 4, 4]),
    ],
)
def test_x_y_and_z_among_any_fields(fields, sizes, kind):
    exact = min(size for name, size in zip(fields.split(), sizes, strict=True) if name in "xyz") == 8
    found = decode_pcd(pcd(fields, sizes, kind))
    assert found.shape == (3, 3)
    np.testing.assert_allclose(found, POINTS, rtol=0 if exact else 1e-7)


def test_counts_of_more_than_one():
    content = pcd("x y z ring", [4, 4, 4, 4]).replace(b"WIDTH 3", b"WIDTH 2").replace(b"POINTS 3", b"POINTS 2")
    head, body = content.split(b"DATA binary\n")
    padded = head.replace(b"COUNT 1 1 1 1", b"COUNT 1 1 1 3") + b"DATA binary\n" + body[:16] + b"\0" * 8 + body[16:]
    np.testing.assert_allclose(decode_pcd(padded), POINTS[:2], rtol=1e-7)


@pytest.mark.parametrize("remove", [b"COUNT 1 1 1\n", b"POINTS 3\n", b"WIDTH 3\nHEIGHT 1\n", b"# a comment\n"])
def test_lines_that_may_be_missing(remove):
    content = pcd("x y z", [4, 4, 4])
    assert remove in content
    np.testing.assert_allclose(decode_pcd(content.replace(remove, b"")), POINTS, rtol=1e-7)


def test_tabs_and_line_ends_of_other_systems():
    head, body = pcd("x y z", [4, 4, 4]).split(b"DATA binary\n")
    content = head.replace(b" ", b"\t").replace(b"\n", b"\r\n") + b"DATA binary\r\n" + body
    np.testing.assert_allclose(decode_pcd(content), POINTS, rtol=1e-7)


def test_an_empty_cloud():
    header = pcd("x y z", [4, 4, 4]).split(b"DATA")[0].replace(b" 3\n", b" 0\n")
    assert decode_pcd(header + b"DATA binary\n").shape == (0, 3)
    assert decode_pcd(header + b"DATA ascii\n").shape == (0, 3)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(arrays.arrays(np.float32, st.tuples(st.integers(0, 20), st.just(3))))
def test_what_is_written_reads_back_to_the_last_bit(tmp_path, points):
    write_points(tmp_path / "a.pcd", points)
    np.testing.assert_array_equal(read_points(tmp_path / "a.pcd"), points)


def test_the_file_is_atoms(shared_data, tmp_path):
    original = shared_data / "synthetic" / "rlbot" / "lidar_right_000.pcd"
    points = read_points(original)
    assert points.shape == (2721, 3)
    write_points(tmp_path / "a.pcd", points)
    assert (tmp_path / "a.pcd").read_bytes() == original.read_bytes()


def test_an_error_names_the_file(tmp_path):
    path = tmp_path / "a.pcd"
    path.write_bytes(pcd("x y ring", [4, 4, 4]))
    with pytest.raises(InputError) as caught:
        read_points(path)
    assert str(caught.value) == f"{path}: found FIELDS 'x y ring', expected one each of x, y and z"
    assert caught.value.exit_code == ExitCode.BAD_INPUT
    with pytest.raises(InputError, match=r"b\.pcd: .* cannot be read: No such file"):
        read_points(tmp_path / "b.pcd")


def test_words_that_are_no_numbers():
    with pytest.raises(InputError, match="found points that are no numbers: could not convert"):
        decode_pcd(pcd("x y z", [4, 4, 4], "ascii").replace(b"-2.25", b"many"))


def test_where_nothing_can_be_written(tmp_path):
    with pytest.raises(InfrastructureError, match="cannot be written"):
        write_points(tmp_path, POINTS)


NAN, INFINITY = float("nan"), float("inf")
DATA, LABEL = "collections/000/data/lidar", "collections/000/labels/board/lidar"
RANGES = [NAN, 2.0, 2.1, 2.2, None, 2.0, INFINITY, 0.05, 40, 0.0, -1.0]


def with_scan(changes: Document | None = None) -> Document:
    """The tiny dataset with a 2D LiDAR in the place of its LiDAR."""
    scan = {
        "header": {"seq": 1, "frame_id": "lidar_frame", "stamp": {"secs": 1, "nsecs": 0}},
        "ranges": RANGES,
        "intensities": [],
        "angle_min": -0.5,
        "angle_max": 0.5,
        "angle_increment": 0.1,
        "time_increment": 0.0,
        "scan_time": 0.025,
        "range_min": 0.1,
        "range_max": 30.0,
    }
    made = changed(
        document(),
        {
            "sensors/lidar/modality": "lidar2d",
            "sensors/lidar/msg_type": "LaserScan",
            "calibration_config/sensors/lidar/modality": "lidar2d",
            DATA: scan,
            LABEL: {"detected": True, "idxs": [1, 2, 3, 5], "edge_idxs": [5, 1]},
            "collections/002/labels/board/lidar": {"detected": False, "idxs": []},
        },
    )
    return changed(made, changes or {})


def test_rays_become_points_in_the_plane_of_the_scan(tmp_path: Path):
    labels = read_dataset(write(tmp_path, with_scan())).collections[0].labels["board", "lidar"]
    angles = np.array([-0.4, -0.3, -0.2, 0.0])
    expected = np.array([2.0, 2.1, 2.2, 2.0])[:, None] * np.stack([np.cos(angles), np.sin(angles), 0 * angles], -1)
    np.testing.assert_allclose(labels.points, expected, atol=1e-15)
    assert labels.limits.tolist() == [3, 0]
    assert read_dataset(write(tmp_path, with_scan())).sensors["lidar"].modality == LIDAR2D


def test_the_ends_may_have_the_name_that_other_sensors_limits_have(tmp_path: Path):
    label = {"detected": True, "idxs": [1, 2, 3], "idxs_limit_points": [3]}
    dataset = read_dataset(write(tmp_path, with_scan({LABEL: label})))
    assert dataset.collections[0].labels["board", "lidar"].limits.tolist() == [2]


def test_angles_may_fall_and_bounds_may_be_missing_or_without_end(tmp_path: Path):
    falling = {f"{DATA}/angle_min": 0.5, f"{DATA}/angle_increment": -0.1, f"{DATA}/range_min": MISSING}
    far = {f"{DATA}/range_max": INFINITY, f"{LABEL}/idxs": [1, 2, 3, 5, 7, 8]}
    points = read_dataset(write(tmp_path, with_scan({**falling, **far}))).collections[0].labels["board", "lidar"].points
    np.testing.assert_allclose(points[0], [2 * np.cos(0.4), 2 * np.sin(0.4), 0])
    np.testing.assert_allclose(np.hypot(*points[:, :2].T), [2.0, 2.1, 2.2, 2.0, 0.05, 40])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({f"{DATA}/ranges": MISSING}, f"{DATA}: missing key 'ranges'"),
        ({f"{DATA}/ranges": {}}, f"{DATA}/ranges: found an empty object, expected a list"),
        ({f"{DATA}/ranges": [1.0] * (MAX_RAYS + 1)}, f"{DATA}/ranges: found 1048577 ranges, expected 1048576 at most"),
        ({f"{DATA}/ranges/3": "2.2"}, f"{DATA}/ranges/3: found '2.2', expected a range in m, or NaN, Infinity or null"),
        ({f"{DATA}/ranges/3": True}, f"{DATA}/ranges/3: found true, expected a range"),
        ({f"{DATA}/ranges/3": 10**400}, f"{DATA}/ranges/3: found a huge integer, expected a range"),
        ({f"{DATA}/angle_min": MISSING}, f"{DATA}: missing key 'angle_min'"),
        ({f"{DATA}/angle_min": NAN}, f"{DATA}/angle_min: found nan, expected a finite number"),
        ({f"{DATA}/angle_min": -135}, f"{DATA}/angle_min: found -135, expected a number from -10 to 10"),
        ({f"{DATA}/angle_increment": 0.0}, f"{DATA}/angle_increment: found 0.0, expected the angle between two rays"),
        ({f"{DATA}/angle_increment": 0.75}, f"{DATA}/angle_increment: 11 rays of 0.75 rad make more than one rev"),
        ({f"{DATA}/range_min": "0"}, f"{DATA}/range_min: found '0', expected a finite number"),
        ({f"{DATA}/range_max": NAN}, f"{DATA}/range_max: found nan, expected a finite number"),
        ({f"{LABEL}/edge_idxs": MISSING}, f"{LABEL}: missing key 'idxs_limit_points' or 'edge_idxs'"),
        ({f"{LABEL}/edge_idxs/1": 4}, f"{LABEL}/edge_idxs/1: found 4, expected one of 'idxs'"),
        ({f"{LABEL}/edge_idxs/1": "1"}, f"{LABEL}/edge_idxs/1: found '1', expected a finite number"),
        ({f"{LABEL}/idxs/2": 11}, f"{LABEL}/idxs/2: found 11, expected the index of one of the scan's 11 rays"),
        ({f"{LABEL}/idxs/2": -1}, f"{LABEL}/idxs/2: found -1, expected the index of a point"),
        *[
            ({f"{LABEL}/idxs/2": k}, f"{LABEL}/idxs/2: ray {k} of the scan has no range; a labelled ray must")
            for k in (0, 4, 6, 7, 8, 9, 10)
        ],
        ({f"{DATA}/ranges": [], f"{LABEL}/idxs": [1, 2, 3, 5]}, f"{LABEL}/idxs/0: found 1, expected the index of one"),
    ],
)
def test_errors_are_one_line(tmp_path: Path, changes: Document, message: str):
    path = write(tmp_path, with_scan(changes))
    with pytest.raises(InputError) as caught:
        read_dataset(path)
    assert str(caught.value).isprintable()
    assert str(caught.value).removeprefix(f"{path}: ").startswith(message)


def test_a_dataset_is_written_with_its_scans_as_they_were(tmp_path: Path):
    dataset = read_dataset(write(tmp_path / "in", with_scan()))
    path = write_dataset(dataset, tmp_path / "out")
    written = json.loads(path.read_text())["collections"]["000"]
    source = with_scan()["collections"]["000"]
    assert json.dumps(written["data"]["lidar"]) == json.dumps(source["data"]["lidar"], sort_keys=True)
    assert written["labels"]["board"]["lidar"] == source["labels"]["board"]["lidar"]
    again = read_dataset(path).collections[0].labels["board", "lidar"]
    np.testing.assert_array_equal(again.points, dataset.collections[0].labels["board", "lidar"].points)
