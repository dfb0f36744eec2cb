"""Sizes of meshes in STL, binary and text, also of broken ones; binary meshes reach the checks."""

import struct
from pathlib import Path

import pytest

from benchmarks.ros_defects.workspace import Workspace, write
from calibration.addons.analysis.copies import copied
from calibration.addons.analysis.ros.__main__ import check
from calibration.addons.analysis.ros.description_checks import stl_size
from calibration.addons.analysis.ros.tree import Tree
from calibration.ci.git import Repository
from tests.repositories import commit


def binary(*triangles: tuple[float, ...]) -> bytes:
    parts = (struct.pack("<12fH", 0, 0, 1, *each, 0) for each in triangles)
    return bytes(80) + struct.pack("<I", len(triangles)) + b"".join(parts)


TRIANGLE = (0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 2.0, 0.0)


def test_the_longest_side_is_the_size() -> None:
    assert stl_size(binary(TRIANGLE)) == 2.0
    assert stl_size(b"solid a\nvertex 0 0 0\n vertex -1e0 0 3.5\nendsolid") == 3.5


@pytest.mark.parametrize(
    "data", [b"", b"solid", bytes(84), binary(TRIANGLE)[:-1], b"vertex a b c", b"vertex nan 0 0", b"\xff" * 134]
)
def test_a_broken_mesh_has_no_size(data: bytes) -> None:
    assert stl_size(data) is None


def test_a_binary_mesh_in_millimetres_is_found(tmp_path: Path) -> None:
    files = Workspace(2, 0).files
    [mesh] = [path for path in files if path.endswith("base.stl")]
    root = tmp_path / "robot"
    write(root, files)
    (root / mesh).write_bytes(binary(tuple(1000 * each for each in TRIANGLE)))
    commit(root, {})
    repository = Repository.around(root)
    copy = copied(repository, tmp_path / "copy", repository.tracked())
    assert copy.meshes == (mesh,)
    assert mesh not in copy.files
    [finding] = check(Tree(copy.root, copy.present, copy.opaque))
    assert (finding.rule, "2e+03 m long" in finding.message) == ("ros/mesh-size", True)
