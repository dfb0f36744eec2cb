import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.base import InputError
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import from_xyz_rpy
from calibration.robot.simulation.motion import (
    Motion,
    joined,
    motion_document,
    moving_joints,
    moving_model,
    read_motion,
)

POSE = {"position": {"x": 1, "y": 2, "z": 3}, "orientation": {"x": 0, "y": 0, "z": 0.6, "w": 0.8}}
JOINTS = {"joints": {"a": 1.5, "b": -2}}


def written(tmp_path: Path, document: Any) -> Path:
    path = tmp_path / "motion.json"
    path.write_text(document if isinstance(document, str) else json.dumps(document))
    return path


def equal(a: Motion, b: Motion) -> bool:
    return (
        len(a) == len(b)
        and np.array_equal(a.positions, b.positions)  # type: ignore[arg-type]
        and np.array_equal(a.orientations, b.orientations)  # type: ignore[arg-type]
        and a.joints.keys() == b.joints.keys()
        and all(np.array_equal(a.joints[name], b.joints[name]) for name in a.joints)
    )


def test_poses_of_a_model_read_back_equal(tmp_path: Path) -> None:
    motion = moving_model(
        from_xyz_rpy(np.random.default_rng(0).normal(size=(12, 3)), np.linspace(0, 6, 36).reshape(12, 3))
    )
    again = read_motion(written(tmp_path, motion_document(motion)))
    assert equal(motion, again)
    assert motion_document(again) == motion_document(motion)
    assert list(motion_document(motion)) == [str(i) for i in range(1, 13)]


def test_joints_read_back_equal(tmp_path: Path) -> None:
    motion = moving_joints({"a": np.array([0.1234567, -0.0]), "b": np.array([1.0, 2.0])})
    again = read_motion(written(tmp_path, motion_document(motion)))
    assert equal(motion, again)
    assert motion.joints["a"].tolist() == [0.123457, 0.0]
    assert again.model_poses is None


def test_atoms_own_sequence(shared_data: Path) -> None:
    motion = read_motion(shared_data / "t2rgb-paper" / "movement_sequence.json")
    assert len(motion) == 22
    assert motion.model_poses is not None
    np.testing.assert_allclose(motion.model_poses[0, :3, 3], [2.265628, -0.339705, 0.733298], atol=1e-6)
    q = rotations.to_quaternion(motion.model_poses[0, :3, :3])
    np.testing.assert_allclose(q, [-0.277191, -0.284896, 0.657677, 0.639891], atol=1e-6)


def test_a_pose_may_move_both(tmp_path: Path) -> None:
    motion = read_motion(written(tmp_path, {"1": {**POSE, **JOINTS}}))
    assert motion.joints["b"].tolist() == [-2]
    assert motion.positions is not None
    assert motion.positions.tolist() == [[1, 2, 3]]


def test_a_part_of_a_motion() -> None:
    motion = moving_joints({"a": np.arange(5.0)}).take([3, 1])
    assert motion.joints["a"].tolist() == [3, 1]
    assert len(motion) == 2


def without(document: dict[str, Any], *keys: str) -> dict[str, Any]:
    copy = json.loads(json.dumps(document))
    inner = copy
    for key in keys[:-1]:
        inner = inner[key]
    del inner[keys[-1]]
    return copy


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ("[", "line 1, column 2: the file ends in the middle of its JSON; is it truncated?"),
        ("[]", "found an empty list, expected an object"),
        ({}, "found 0 poses, expected 1 to 10000"),
        ({"1": POSE, "3": POSE}, "missing pose '2'; the keys of 2 poses run from '1' to '2'"),
        ({"1": {}}, "1: found neither position and orientation nor joints"),
        ({"1": 5}, "1: found 5, expected keys: position, orientation, joints"),
        ({"1": without(POSE, "position", "y")}, "1.position: missing key 'y'"),
        ({"1": POSE, "2": without(POSE, "orientation")}, "2: missing key 'orientation'"),
        ({"1": without(POSE, "position")}, "1: missing key 'position'"),
        ('{"1": {"position": {"x": NaN}, "orientation": {}}}', "1.position.x: found nan, expected a number"),
        ({"1": {**POSE, "speed": 1}}, "1: unknown key 'speed' (known: position, orientation, joints)"),
        (
            {"1": JOINTS, "2": {**POSE, **JOINTS}},
            "2: every pose has what the first one has: '2' has a position, '1' has none",
        ),
        ({"1": JOINTS, "2": without(JOINTS, "joints", "a")}, "2.joints: missing key 'a'"),
        (
            {"1": JOINTS, "2": {"joints": {**JOINTS["joints"], "c": 1}}},
            "2.joints: unknown key 'c' (known: a, b)",
        ),
        ({"1": {"joints": {"a": "up"}}}, "1.joints.a: found 'up', expected a number"),
        (
            {"1": {**POSE, "orientation": dict.fromkeys("xyzw", 0)}},
            "1.orientation: found a quaternion of length 0, expected length 1",
        ),
        (
            {"1": {**POSE, "orientation": {"x": 0, "y": 0, "z": 0, "w": 2}}},
            "1.orientation: found a quaternion of length 2, expected length 1",
        ),
    ],
)
def test_errors_are_one_line(tmp_path: Path, document: Any, message: str) -> None:
    path = written(tmp_path, document)
    with pytest.raises(InputError) as error:
        read_motion(path)
    assert str(error.value) == f"{path}: {message}"


def test_motions_joined() -> None:
    model = Motion(np.arange(12.0).reshape(4, 3), np.tile([0.0, 0, 0, 1], (4, 1)), {"a": np.arange(4.0)})
    arm = Motion(None, None, {"a": np.arange(4.0), "b": -np.arange(4.0)})
    for motion in (model, arm):
        parts = [motion.take(range(1)), motion.take([]), motion.take([1, 2]), motion.take(np.array([3]))]
        assert [len(part) for part in parts] == [1, 0, 2, 1]
        assert motion_document(joined(parts)) == motion_document(motion)
