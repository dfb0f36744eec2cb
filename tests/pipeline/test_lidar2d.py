"""A 2D LiDAR, collected in simulation and calibrated."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import jsonschema
import numpy as np
import pytest

from calibration.engine.dataset.modalities import LIDAR2D
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.engine.evaluation.specification import parse_evaluation
from calibration.engine.evaluation.truth import find_truth
from calibration.engine.geometry.transforms import inverse
from calibration.pipeline.collection.collecting import collect_dataset
from calibration.pipeline.collection.report import SCHEMA_FILE, report
from calibration.pipeline.collection.request import CollectionRequest
from calibration.pipeline.collection.results import CollectionResults
from calibration.robot.simulation.kinematics import place, stream
from calibration.robot.simulation.motion import read_motion
from calibration.robot.simulation.motion_information import expected_dataset, expected_noise
from calibration.robot.simulation.scene import Scene
from calibration.robot.simulation.sensors import SimulatedLidar2d
from calibration.robot.simulation.system import System, read_system
from tests.pipeline.systems import with_scanner
from tests.robot.simulation.conftest import DATASETS, detects

POSES = 12
LIDAR = "lidar_right"


def lidar_of(system: System) -> SimulatedLidar2d:
    lidar = system.sensors[LIDAR]
    assert isinstance(lidar, SimulatedLidar2d)
    return lidar


@pytest.fixture(scope="module")
def system(tmp_path_factory: pytest.TempPathFactory) -> System:
    return read_system(with_scanner(tmp_path_factory.mktemp("system")))


@pytest.fixture(scope="module")
def collected(tmp_path_factory: pytest.TempPathFactory) -> tuple[CollectionResults, Path]:
    folder, output = with_scanner(tmp_path_factory.mktemp("system")), tmp_path_factory.mktemp("output")
    return collect_dataset(CollectionRequest(folder, motion=f"generate:{POSES}"), output), output


def test_the_error_against_the_truth_matches_the_covariance(collected: tuple[CollectionResults, Path]) -> None:
    results, folder = collected
    assert results.verdict == "pass"
    assert len(results.kept) == POSES
    dataset = read_dataset(folder)
    assert dataset.sensors[LIDAR].modality == LIDAR2D
    truth, found = find_truth(dataset), calibrate(dataset, Options(), StartingNoise(3, 1.5))
    ((edge, covariance),) = found.label_covariances.items()
    D = inverse(found.transforms[edge]) @ truth.transforms[edge]
    error = np.concatenate([D[:3, 3], 0.5 * np.array([D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1]])])
    assert error @ np.linalg.solve(covariance, error) < 22.5  # one in a thousand is more
    assert np.linalg.norm(error[:3]) < 0.01
    assert found.noise_levels.lidar2d_range == pytest.approx(0.01, rel=0.1)
    assert found.noise_levels.lidar2d_border == pytest.approx(np.radians(0.25) / 12**0.5, rel=0.35)


def test_what_is_written_of_it_keeps_to_the_schema(collected: tuple[CollectionResults, Path]) -> None:
    written = json.loads(json.dumps(report(collected[0], Path()).document))
    jsonschema.validate(written, json.loads(SCHEMA_FILE.read_text()))


def test_its_dataset_holds_whole_scans_and_no_file_of_it(collected: tuple[CollectionResults, Path]) -> None:
    _, folder = collected
    document = json.loads((folder / "dataset.json").read_text(), parse_constant=pytest.fail)  # no NaN, no Infinity
    assert document["sensors"][LIDAR]["msg_type"] == "LaserScan"
    message = document["collections"]["000"]["data"][LIDAR]
    assert len(message["ranges"]) == 1081
    assert message["angle_increment"] == pytest.approx(np.radians(0.25))
    assert not list(folder.glob(f"{LIDAR}*"))
    label = document["collections"]["000"]["labels"]["pattern_1"][LIDAR]
    assert set(label["idxs_limit_points"]) <= {label["idxs"][0], label["idxs"][-1]}
    assert cv2.imread(str(folder / "contact_sheet.png")) is not None


def test_its_ends_are_evaluated_in_the_cameras_images(collected: tuple[CollectionResults, Path]) -> None:
    dataset = calibrate(read_dataset(collected[1])).dataset
    table = parse_evaluation(f"lidar-to-rgb:{LIDAR}:rgb_left").run(dataset, find_truth(dataset))
    assert 0 < table.average("RMS (pix)") < 6


def test_the_expected_scan_lines_equal_those_of_the_simulated_scans(system: System) -> None:
    exact = replace(lidar_of(system), noise=0.0, resolution=0.0)
    system = replace(system, sensors={**system.sensors, LIDAR: exact}, scene=Scene())
    placement = place(system, read_motion(DATASETS / "rlbot" / "motion.json"))
    detected = detects(system, LIDAR, "pattern_1", placement)
    assert 3 < detected.sum() < len(detected)
    dataset = expected_dataset(system, placement)
    assert dataset.sensors[LIDAR].camera is None
    for number, labels in dataset.detections("pattern_1", LIDAR):
        boards = system.boards({name: T[number] for name, T in placement.patterns.items()})
        seen = exact.scan(placement.sensors[LIDAR][number], system.scene, boards, stream(0))
        on = np.flatnonzero(seen.board[0] == 0)
        np.testing.assert_allclose(labels.points, exact.directions()[0, on] * seen.ranges[0, on, None], atol=1e-9)
        assert labels.limits.tolist() == [0, len(on) - 1]
    assert {i for i, _ in dataset.detections("pattern_1", LIDAR)} == set(np.flatnonzero(detected))


def test_a_scan_line_needs_range_angle_and_visibility(system: System) -> None:
    placement = place(system, read_motion(DATASETS / "rlbot" / "motion.json"))
    usual = detects(system, LIDAR, "pattern_1", placement)
    lidar = lidar_of(system)
    for changed in (
        replace(lidar, reach=(0.1, 1.0)),
        replace(lidar, reach=(5.0, 30.0)),
        replace(lidar, angles=(2.0, 3.0)),
    ):
        other = replace(system, sensors={**system.sensors, LIDAR: changed})
        assert usual.any()
        assert not detects(other, LIDAR, "pattern_1", placement).any()


def test_its_expected_noise_is_its_own(system: System) -> None:
    scales = expected_noise(system).scales
    assert scales["lidar2d_range"] == pytest.approx(np.hypot(0.01, 0.001 / 12**0.5))
    assert scales["lidar2d_border"] == pytest.approx(np.radians(0.25) / 12**0.5)
