"""The proof of a dataset: an answer for every dataset, also for those that do not calibrate."""

import json
import math
import shutil
from pathlib import Path

from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.options import ALL_EXACT, Options
from calibration.robot.simulation.proof import prove
from tests.robot.simulation.conftest import DATASETS


def test_the_proof_has_the_engines_result(tmp_path: Path) -> None:
    proof = prove(DATASETS / "rlbot")
    found = calibrate(read_dataset(DATASETS / "rlbot"), Options(assume=ALL_EXACT))
    assert proof.converged
    assert proof.reason == ""
    assert proof.rms_px == round(found.rms_px, 4)
    assert proof.sigmas is not None
    assert list(proof.sigmas) == ["lidar_right"]  # the camera is anchored
    assert (
        abs(
            proof.sigmas["lidar_right"].translation_mm
            - found.sigma_mm(("tripod_right_support", "lidar_right_base_link"))
        )
        < 1e-4
    )
    assert proof.translation_mm is not None
    assert 0 < proof.translation_mm < 5
    assert proof.error_sigmas is not None
    assert 0.2 < proof.error_sigmas < 2
    assert proof.chance is not None
    assert 0.01 < proof.chance < 1


def test_without_a_truth_there_is_no_error(tmp_path: Path) -> None:
    shutil.copy(DATASETS / "t2rgb" / "dataset.json", tmp_path)
    proof = prove(tmp_path)
    assert proof.converged
    assert proof.translation_mm is None
    assert proof.rotation_deg is None


def test_what_cannot_be_calibrated_is_an_answer(tmp_path: Path) -> None:
    document = json.loads((DATASETS / "t2rgb" / "dataset.json").read_text())
    document["collections"] = {}
    (tmp_path / "dataset.json").write_text(json.dumps(document))
    proof = prove(tmp_path)
    assert not proof.converged
    assert proof.reason.startswith("dataset.json: ")
    assert str(tmp_path) not in proof.reason


def test_joints_are_proven_too(tmp_path: Path) -> None:
    proof, found = prove(DATASETS / "spjbot"), calibrate(read_dataset(DATASETS / "spjbot"), Options(assume=ALL_EXACT))
    assert [(joint.joint, joint.parameter, joint.unit) for joint in proof.joints] == [
        ("j2_joint", "origin_yaw", "rad"),
        ("j3_joint", "origin_z", "m"),
        ("j4_joint", "origin_yaw", "rad"),
    ]
    for joint, true in zip(proof.joints, (0.02, 0.105, -0.015), strict=True):
        assert joint.error is not None
        assert abs(abs(joint.value - true) - joint.error) < 1e-6
        assert 0 < joint.error < 3 * joint.sigma
        assert abs(joint.sigma - found.joints[joint.joint].sigmas[0]) < 1e-8
    lengths, angles = ([each.error for each in proof.joints if each.unit == unit] for unit in ("m", "rad"))
    assert (proof.joint_mm, proof.joint_deg) == (round(1e3 * lengths[0], 4), round(math.degrees(max(angles)), 6))
    shutil.copy(DATASETS / "spjbot" / "dataset.json", tmp_path)
    alone = prove(tmp_path)
    assert [joint.error for joint in alone.joints] == [None, None, None]
    assert alone.joint_mm is alone.joint_deg is None
    assert [joint.value for joint in alone.joints] == [joint.value for joint in proof.joints]
