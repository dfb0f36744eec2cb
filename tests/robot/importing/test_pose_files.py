"""Poses in every form that others write them in, with what import.yml says of them, are the same poses."""

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.base.records import read
from calibration.engine.geometry.transforms import inverse
from calibration.robot.importing.files.samples import Sample, Samples, read_samples
from tests.robot.importing.hand_eye import message, simulated

PAIRS = simulated(in_hand=True, count=5)
ARM, SEEN = PAIRS.arm, PAIRS.seen
Described = dict[str, Any]


def rotation(T: Array) -> Rotation:
    return Rotation.from_matrix(T[:3, :3])


def quaternion(T: Array) -> list[float]:
    return [float(value) for value in rotation(T).as_quat()]


def rows(poses: Array, turned: Callable[[Array], Any], scale: float = 1.0) -> list[list[float]]:
    return [[float(value) for value in (*(scale * T[:3, 3]), *np.ravel(turned(T)))] for T in poses]


def lines(numbers: list[list[float]], separator: str = ",", head: str = "") -> str:
    return head + "\n".join(separator.join(map(repr, row)) for row in numbers) + "\n"


def text_of_matrix(T: Array) -> str:
    return lines(T.tolist(), " ")


def samples_of(folder: Path, described: Mapping[str, Any], in_hand: bool = True) -> list[Sample]:
    return read_samples(read(Samples, described, "import.yml: samples", folder), in_hand)


def pair(arm: Array, seen: Array) -> dict[str, Any]:
    return {
        name: {"position": T[:3, 3].tolist(), "orientation": quaternion(T)}
        for name, T in (("arm", arm), ("board", seen))
    }


@dataclass(frozen=True)
class Form:
    """A way of writing `ARM`, and `SEEN` where it has pairs."""

    write: Callable[[Path], object]
    described: Described
    pairs: bool = False


def storage(path: Path, arm: str = "T1_", seen: str = "T2_") -> None:
    """OpenCV's own, with numbered matrices of the arm and of the inverse pattern."""
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    file.write("frameCount", len(ARM))
    for i, (a, b) in enumerate(zip(ARM, inverse(SEEN), strict=True)):
        file.write(f"{arm}{i}", a)
        file.write(f"{seen}{i}", b)
    file.release()


def rvec_and_tvec(folder: Path) -> None:
    """A file for each pose in a folder of its own, as those who program with OpenCV leave them."""
    for i, (a, b) in enumerate(zip(ARM, SEEN, strict=True)):
        (folder / f"pose_{i:02}").mkdir()
        found = {"O_T_EE": a.ravel().tolist(), "T_cam_target_rvec": rotation(b).as_rotvec()[:, None].tolist()}
        found["T_cam_target_tvec"] = b[:3, 3][:, None].tolist()
        (folder / f"pose_{i:02}" / "data.json").write_text(json.dumps(found))


def cal_data(folder: Path) -> None:
    """industrial_calibration's list."""
    listed = []
    for i, T in enumerate(ARM):
        pose = dict(
            zip(
                ("x", "y", "z", "qz", "qx", "qw", "qy"),
                [*T[:3, 3], *np.array(quaternion(T))[[2, 0, 3, 1]]],
                strict=True,
            )
        )
        (folder / f"{i}.yaml").write_text(yaml.safe_dump({key: float(value) for key, value in pose.items()}))
        listed.append({"pose": f"{i}.yaml", "image": f"{i}.png"})
    (folder / "cal_data.yaml").write_text(yaml.safe_dump({"data": listed}))


def tagged(path: Path) -> None:
    """Rows in turn, with a word before them."""
    numbers = [rows(each, lambda T: rotation(T).as_euler("xyz", degrees=True)) for each in (ARM, SEEN)]
    path.write_text("".join(f"hand,{lines([a])}eye,{lines([b])}" for a, b in zip(*numbers, strict=True)))


def vectors(folder: Path) -> None:
    """A file for each pose with a column of six numbers, as ViSP writes it."""
    for i, T in enumerate(ARM):
        column = "\n".join(
            f"  - [{value!r}]" for [value] in np.array(rows(T[None], lambda T: rotation(T).as_rotvec())).T.tolist()
        )
        (folder / f"pose_rPe_{i + 1}.yaml").write_text(f"rows: 6\ncols: 1\ndata: \n{column}\n")


FORMS: dict[str, Form] = {
    "names of others": Form(
        lambda at: (at / "f.csv").write_text(
            lines([[0.5, *row] for row in rows(ARM, quaternion)], ";", "Time;X [m];Y [m];Z [m];q_x;q_y;q_z;q_w\n")
        ),
        {"file": "f.csv"},
    ),
    "columns that are named in import.yml": Form(
        lambda at: (at / "f.txt").write_text(lines([[0.5, *row] for row in rows(ARM, quaternion)], " ")),
        {"file": "f.txt", "columns": ["-", "x", "y", "z", "qx", "qy", "qz", "qw"]},
    ),
    "seven numbers, w first": Form(
        lambda at: (at / "f.txt").write_text(lines(rows(ARM, lambda T: np.roll(quaternion(T), 1)), " ", "# header\n")),
        {"file": "f.txt", "rotation": "wxyz"},
    ),
    "columns called xyzw that are w first": Form(
        lambda at: (at / "f.csv").write_text(
            lines(rows(ARM, lambda T: np.roll(quaternion(T), 1)), ",", "x,y,z,qx,qy,qz,qw\n")
        ),
        {"file": "f.csv", "rotation": "quaternion-wxyz"},
    ),
    "columns called wxyz, stated too": Form(
        lambda at: (at / "f.csv").write_text(
            lines(rows(ARM, lambda T: np.roll(quaternion(T), 1)), ",", "x,y,z,qw,qx,qy,qz\n")
        ),
        {"file": "f.csv", "rotation": "quaternion-wxyz"},
    ),
    "Euler angles about fixed axes, degrees, mm": Form(
        lambda at: (at / "f.csv").write_text(
            lines(rows(ARM, lambda T: rotation(T).as_euler("xyz", degrees=True), 1e3), ",", "x,y,z,roll,pitch,yaw\n")
        ),
        {"file": "f.csv", "rotation": "euler-xyz-extrinsic", "degrees": True, "units": "mm"},
    ),
    "Euler angles about moving axes": Form(
        lambda at: (at / "f.csv").write_text(lines(rows(ARM, lambda T: rotation(T).as_euler("ZYX")))),
        {"file": "f.csv", "rotation": "euler-zyx-intrinsic"},
    ),
    "Euler angles zyz": Form(
        lambda at: (at / "f.csv").write_text(lines(rows(ARM, lambda T: rotation(T).as_euler("ZYZ")))),
        {"file": "f.csv", "rotation": "euler-zyz-intrinsic"},
    ),
    "rotation vectors, inverse": Form(
        lambda at: (at / "f.csv").write_text(lines(rows(inverse(ARM), lambda T: rotation(T).as_rotvec()))),
        {"file": "f.csv", "rotation": "rotvec", "inverse": True},
    ),
    "matrices of twelve numbers": Form(
        lambda at: (at / "f.txt").write_text(lines([T[:3].ravel().tolist() for T in ARM], " ")), {"file": "f.txt"}
    ),
    "matrices in a text": Form(
        lambda at: (at / "f.txt").write_text("\n".join(text_of_matrix(T) for T in ARM)), {"file": "f.txt"}
    ),
    "a text for each matrix": Form(
        lambda at: [(at / f"pose_{i}.txt").write_text(text_of_matrix(T)) for i, T in enumerate(ARM)],
        {"file": "pose_*.txt"},
    ),
    "a folder": Form(
        lambda at: ((at / "poses").mkdir(), [np.save(at / "poses" / f"{i}.npy", T) for i, T in enumerate(ARM)]),
        {"file": "poses"},
    ),
    "numpy's arrays": Form(
        lambda at: np.savez(at / "f.npz", arm=ARM, board=SEEN),
        {"file": "f.npz", "key": "arm", "pattern": {"key": "board"}},
        pairs=True,
    ),
    "a comment in GBK": Form(
        lambda at: (at / "f.txt").write_bytes("# 格式\n".encode("gbk") + lines(rows(ARM, quaternion)).encode()),
        {"file": "f.txt"},
    ),
    "an array of poses": Form(lambda at: np.save(at / "f.npy", ARM), {"file": "f.npy"}),
    "by its columns": Form(
        lambda at: (at / "f.json").write_text(json.dumps([T.T.ravel().tolist() for T in ARM])), {"file": "f.json"}
    ),
    "FileStorage in YAML": Form(
        lambda at: storage(at / "f.yml"),
        {"file": "f.yml", "key": "T1_", "pattern": {"key": "T2_", "inverse": True}},
        pairs=True,
    ),
    "FileStorage in XML": Form(
        lambda at: storage(at / "f.xml"),
        {"file": "f.xml", "key": "T1_", "pattern": {"key": "T2_", "inverse": True}},
        pairs=True,
    ),
    "FileStorage in JSON": Form(
        lambda at: storage(at / "f.json"),
        {"file": "f.json", "key": "T1_", "pattern": {"key": "T2_", "inverse": True}},
        pairs=True,
    ),
    "rows of a matrix of FileStorage": Form(
        lambda at: (at / "f.yml").write_text(
            "%YAML:1.0\n---\nposes: !!opencv-matrix\n   rows: 5\n   cols: 7\n   dt: d\n"
            f"   data: {np.ravel(rows(ARM, quaternion)).tolist()}\n"
        ),
        {"file": "f.yml"},
    ),
    "rotations and translations in two files": Form(
        lambda at: [
            (at / name).write_text(
                yaml.safe_dump(
                    {"poses": [{"rotation": T[:3, :3].tolist(), "translation": T[:3, 3].tolist()} for T in poses]}
                )
            )
            for name, poses in (("robot.yaml", ARM), ("marker.yaml", SEEN))
        ],
        {"file": "robot.yaml", "pattern": {"file": "marker.yaml"}},
        pairs=True,
    ),
    "keys of OpenCV": Form(
        rvec_and_tvec, {"file": "*/data.json", "key": "O_T_EE", "pattern": {"key": "T_cam_target"}}, True
    ),
    "rows with a word": Form(
        lambda at: tagged(at / "f.csv"),
        {"file": "f.csv", "key": "hand", "rotation": "euler-xyz-extrinsic", "degrees": True, "pattern": {"key": "eye"}},
        pairs=True,
    ),
    "easy_handeye 1": Form(
        lambda at: (at / "f.yaml").write_text(
            yaml.safe_dump(
                {
                    "samples": {
                        "hand_world_samples": {"transforms": [message(T) for T in ARM]},
                        "camera_marker_samples": {"transforms": [message(T) for T in SEEN]},
                    }
                }
            )
        ),
        {"file": "f.yaml"},
        pairs=True,
    ),
    "a list below other keys": Form(
        lambda at: (at / "f.yaml").write_text(
            yaml.safe_dump(
                {"collected": {"total": 5, "samples": [pair(*each) for each in zip(ARM, SEEN, strict=True)]}}
            )
        ),
        {"file": "f.yaml", "key": "arm", "pattern": {"key": "board"}},
        pairs=True,
    ),
    "numbered matrices of FileStorage in XML": Form(
        lambda at: storage(at / "f.xml", "EEF_", "seen_"),
        {"file": "f.xml", "key": "EEF_", "pattern": {"key": "seen_", "inverse": True}},
        pairs=True,
    ),
    "numbered objects": Form(
        lambda at: (at / "f.json").write_text(
            json.dumps({f"pose_{i}": pair(ARM[i], SEEN[i]) for i in (3, 0, 4, 1, 2)})
        ),
        {"file": "f.json", "key": "arm", "pattern": {"key": "board"}},
        pairs=True,
    ),
    "ViSP": Form(vectors, {"file": "pose_rPe_*.yaml", "rotation": "rotvec"}),
    "industrial_calibration": Form(cal_data, {"file": "cal_data.yaml"}),
}


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
def test_every_form_gives_the_same_poses(tmp_path: Path, form: Form) -> None:
    form.write(tmp_path)
    found = samples_of(tmp_path, form.described)
    assert np.abs(np.stack([each.T_base_tool for each in found]) - ARM).max() < 1e-9
    if form.pairs:
        assert (
            np.abs(np.stack([np.eye(4) if (T := each.T_camera_pattern) is None else T for each in found]) - SEEN).max()
            < 1e-9
        )
    else:
        assert all(each.T_camera_pattern is None for each in found)


ROW = "0.1,0.2,0.3,0,0,0,1\n"


@pytest.mark.parametrize(
    ("name", "content", "described", "said"),
    [
        ("f.csv", "1,2,3,0.1,0.2,0.3\n", {}, r"f.csv:1: found 3 numbers of a rotation.*add 'rotation'"),
        ("f.csv", "1,2,3,10,20,30\n", {"rotation": "rotvec"}, r"f.csv:1: found an angle of 30, .*'degrees: true'"),
        ("f.csv", ROW, {"rotation": "euler-xyz"}, r"rotation: found 'euler-xyz', expected euler-xyz-extrinsic"),
        ("f.csv", ROW, {"rotation": "euler-xxz-extrinsic"}, r"found 'euler-xxz-extrinsic', expected quaternion-xyzw"),
        ("f.csv", ROW, {"rotation": "rotvec"}, r"f.csv:1: found 4 numbers of a rotation, expected the 3 of rotvec"),
        ("f.csv", "1,2,3,4,5\n", {}, r"f.csv:1: found 5 numbers, expected 6 or 7"),
        ("f.csv", f"hand,{ROW}", {}, r"f.csv:1: found 'hand' beside numbers.*'columns'.*'key'"),
        ("f.csv", f"{ROW}1,2,x,0,0,0,1\n", {}, r"f.csv:2: found 'x' as number 3, expected a finite number"),
        ("f.csv", "a,b\n1,2\n", {}, r"f.csv:2: missing column 'x', expected x, y, z, qx, qy, qz, qw; .*'columns'"),
        ("f.json", '{"a": [1], "b": [2]}', {}, r"found the keys a, b, expected a pose.*'key'"),
        ("f.json", '{"a": [1], "b": [2]}', {"key": "arm"}, r"f.json: found no poses 'arm', but the keys a, b"),
        ("f.json", "[[1, 2", {}, r"f.json: line 1, column 7: not JSON"),
        ("f.json", json.dumps([np.diag([1, 1, -1, 1]).ravel().tolist()]), {}, r"f.json: 0: found no rigid transform"),
        ("f.xml", '<!DOCTYPE x [<!ENTITY a "b">]><x>&a;</x>', {}, r"f.xml: this is not valid XML"),
        ("f.xml", "<a>" * 60 + "</a>" * 60, {}, r"f.xml: found more than 50 elements inside"),
        ("f.csv", "a\0b", {}, r"f.csv: this is no CSV file: found a zero byte"),
        ("f.npy", "not numpy", {}, r"f.npy: these are no arrays of numbers"),
        ("f.toml", "a = ", {}, r"f.toml: this is not valid TOML"),
        ("f.csv", ROW, {"pattern": {}}, r"f.csv: found no poses of the pattern, expected some.*'file' or 'key'"),
        (
            "f.csv",
            ROW,
            {"units": "mm", "pattern": {"file": "two.csv"}},
            r"found 2 poses of the pattern and 1 of the arm",
        ),
        ("f.csv", ROW, {"key": "arm", "columns": ["x"]}, r"columns and key exclude each other"),
    ],
)
def test_what_is_no_pose_is_one_line(tmp_path: Path, name: str, content: str, described: Described, said: str) -> None:
    (tmp_path / name).write_text(content)
    (tmp_path / "two.csv").write_text(2 * ROW)
    with pytest.raises(InputError, match=said) as caught:
        samples_of(tmp_path, {"file": name, **described})
    assert "\n" not in str(caught.value)


def test_pickled_objects_are_not_loaded(tmp_path: Path) -> None:
    np.save(tmp_path / "f.npy", np.array([{"a": 1}]), allow_pickle=True)
    with pytest.raises(InputError, match=re.escape("f.npy: these are no arrays of numbers")):
        samples_of(tmp_path, {"file": "f.npy"})


def test_poses_of_other_numbers_do_not_become_pairs(tmp_path: Path) -> None:
    for i, name in ((0, "arm-0"), (1, "arm-1"), (0, "board-0"), (2, "board-2")):
        np.save(tmp_path / f"{name}.npy", ARM[i])
    with pytest.raises(InputError, match="2 poses of the arm and 2 of the pattern, of which 1 have the same number"):
        samples_of(tmp_path, {"file": "arm-*.npy", "pattern": {"file": "board-*.npy"}})
