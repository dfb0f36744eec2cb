import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from calibration.base.errors import ExitCode, InfrastructureError, InputError
from calibration.engine.dataset.pointcloud import decode_pcd, read_points, write_points

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
