"""What a cell's own results say of a calibration."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.comparison.methods import applicable, method_of
from calibration.dataset.model import Dataset
from calibration.dataset.truth import truth_of
from calibration.errors import ExitCode, InputError
from calibration.estimation.calibrate import calibrate
from calibration.estimation.starting_noise import StartingNoise
from calibration.evaluation.specification import parse_evaluation
from calibration.pipeline.matrix import cell as cells
from calibration.pipeline.matrix.cell import CellResult, Comparison, LoadedSystem, run_comparison
from tests.estimation.systems import jointed_arm
from tests.evaluation.scene import T_LINK_OPTICAL, arm, range_pair, rgb, with_corners
from tests.pipeline.matrix.test_judgement import CELL


def test_joints_are_told_with_their_sigmas() -> None:
    scene = jointed_arm(free={"j2": ("position_bias",), "j3": ("origin_yaw",)}, pixel_noise=0.2)
    calibration = calibrate(scene.dataset())
    found = cells._described(CELL, calibration).details["joints"]
    told = [(each["name"], each["parameter"], each["unit"]) for each in found]
    asked = [(joint.name, parameter) for joint in calibration.joints.values() for parameter in joint.parameters]
    assert [each[:2] for each in told] == asked
    assert {each[2] for each in told} <= {"m", "rad"}
    assert calibration.converged
    values = np.concatenate([joint.values for joint in calibration.joints.values()])
    assert [each["value"] for each in found] == values.tolist()
    assert all(0 < each["sigma"] < 1 for each in found)


def test_other_methods_calibrate_no_joints() -> None:
    dataset = jointed_arm().dataset()
    assert applicable(dataset) == []
    with pytest.raises(InputError, match=r"^Shah calibrates no joints, and the dataset asks for j3$"):
        method_of("shah").calibrate(dataset)


def loaded(name: str, dataset: Dataset) -> LoadedSystem:
    """A system as if it had been read from a file that had no transforms, whose own are the truth."""
    empty: dict[str, Any] = {key: {"transforms": {}} for key in dataset.keys}
    document = {"_metadata": {}, "calibration_config": {"calibration_patterns": {"board": {}}}, "collections": empty}
    return LoadedSystem(name, replace(dataset, document=document), truth_of(dataset), None)


def lidars() -> LoadedSystem:
    """Two LiDARs and a camera that see a pattern; LiDAR "one" is anchored."""
    dataset, T_world_pattern = range_pair(n=4, kinds=("lidar3d", "lidar3d"))
    eye = rgb("eye")
    still = {
        ("world", eye.calibration_parent): np.eye(4),
        eye.edge: np.eye(4),
        ("eye_link", "eye_optical"): T_LINK_OPTICAL,
    }
    dataset = replace(dataset, sensors={"eye": eye, **dataset.sensors}).with_transforms(still)
    return loaded("pair", with_corners(dataset, T_world_pattern, np.random.default_rng(1), 0.0))


def compared(system: LoadedSystem, output: Path, *noise: float, method: str = "icp") -> CellResult:
    start = StartingNoise(*noise) if noise else None
    return run_comparison(Comparison(system.name, method, start), system, output)


def test_a_method_that_depends_on_the_start_starts_from_the_noise(tmp_path: Path) -> None:
    system = lidars()
    here, near, far = (compared(system, tmp_path, *noise) for noise in ((0.0, 0.0), (0.02, 0.02), (3.0, 0.0)))
    assert here.truth is not None
    assert near.truth is not None
    assert here.truth.translation_mm < near.truth.translation_mm + 1e-3
    assert near.truth.translation_mm < 20  # it has come nearer
    assert (near.start, near.translation_noise, near.rotation_noise, near.seed) == ("given", 0.02, 0.02, 1)
    assert near.detail == "built in"
    assert near.name == "pair, icp, 0.02 m, 0.02 rad, seed 1"
    assert near.dataset == "pair/icp/translation-0.02_rotation-0.02_seed-1/dataset.json"
    assert (tmp_path / near.dataset).is_file()
    assert not far.converged
    assert "starts from the dataset's transforms, which lie too far off" in far.reasons[0]


def test_a_pair_is_judged_without_the_other_sensors(tmp_path: Path) -> None:
    """From 0.02 m of noise the camera stays 20 mm off; the row has the error of the LiDARs only."""
    system = lidars()
    table = compared(replace(system, evaluation=parse_evaluation("lidar-to-lidar:one:two")), tmp_path, 0.02, 0.0)
    assert table.table is not None
    assert (tmp_path / table.table).is_file()
    none = compared(replace(system, evaluation=parse_evaluation("lidar-to-rgb:one:eye")), tmp_path, 0.02, 0.0)
    assert (none.converged, none.table, none.rms_px) == (True, None, None)
    assert none.truth == table.truth
    assert none.truth is not None
    assert none.truth.translation_mm < 15


def test_a_method_that_takes_no_start_has_one_row(tmp_path: Path) -> None:
    found = compared(loaded("robot", arm(n=6)), tmp_path, method="shah")
    assert found.converged
    assert (found.start, found.translation_noise, found.seed) == (None, None, None)
    assert found.name == "robot, shah"
    assert found.dataset == "robot/shah/dataset.json"
    assert found.detail is not None


def test_a_method_that_fails_tells_nothing_of_itself(tmp_path: Path) -> None:
    found = compared(replace(lidars(), dataset=arm(n=6)), tmp_path, 0.5, 0.0)
    assert (found.converged, found.detail, found.error) == (False, None, ExitCode.BAD_INPUT)
    assert "it needs two LiDARs" in found.reasons[0]
