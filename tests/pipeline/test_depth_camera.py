"""Depth cameras from end to end: simulated, labelled, read, calibrated to the truth."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.least_squares.noise_levels import NoiseLevels
from calibration.engine.evaluation.truth import find_truth
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import inverse
from calibration.pipeline.collection.collecting import collect_dataset
from calibration.pipeline.collection.request import CollectionRequest
from calibration.pipeline.collection.results import CollectionResults
from tests.pipeline.conftest import DATASETS
from tests.pipeline.systems import with_depth_camera
from tests.thorough import thorough

POSES = 10


def collected(system: Path, output: Path) -> CollectionResults:
    return collect_dataset(CollectionRequest(system, motion=f"generate:{POSES}"), output)


@pytest.fixture(scope="module")
def rgb_and_depth(tmp_path_factory: pytest.TempPathFactory) -> tuple[CollectionResults, Path]:
    """t2rgb, whose left camera measures depths instead."""
    system, output = tmp_path_factory.mktemp("system"), tmp_path_factory.mktemp("output")
    for name in ("robot.urdf", "simulation.yml"):
        (system / name).write_bytes((DATASETS / "t2rgb" / name).read_bytes())
    config = (DATASETS / "t2rgb" / "config.yml").read_text()
    (system / "config.yml").write_text(config.replace("modality: rgb", "modality: depth", 1))
    return collected(system, output), output


@pytest.fixture(scope="module")
def with_lidar(tmp_path_factory: pytest.TempPathFactory) -> tuple[CollectionResults, Path]:
    """rlbot with a depth camera, whose lens is bent, beside its camera and its LiDAR."""
    output = tmp_path_factory.mktemp("output")
    return collected(with_depth_camera(tmp_path_factory.mktemp("system")), output), output


def errors_in_sigmas(folder: Path) -> np.ndarray:
    """The squared error of each free transform over its covariance: chi-squared of 6 degrees of freedom."""
    dataset = read_dataset(folder)
    truth, found = find_truth(dataset), calibrate(dataset)
    assert truth is not None
    values = []
    for edge, covariance in found.label_covariances.items():
        if edge in truth.transforms:
            D = inverse(found.transforms[edge]) @ truth.transforms[edge]
            error = np.concatenate([D[:3, 3], rotations.log(D[:3, :3])])
            values.append(error @ np.linalg.solve(covariance, error))
    return np.array(values)


@pytest.mark.parametrize("rig", ["rgb_and_depth", thorough("with_lidar")])
def test_the_error_against_the_truth_matches_the_covariance(rig: str, request: pytest.FixtureRequest) -> None:
    results, folder = request.getfixturevalue(rig)
    assert results.verdict == "pass"
    assert len(results.kept) == POSES
    assert results.proof.translation_mm < 1
    assert results.proof.rotation_deg < 0.05
    errors = errors_in_sigmas(folder)
    assert len(errors) == len(results.proof.sigmas) == (1 if rig == "rgb_and_depth" else 2)
    assert (errors < 22.5).all()  # one in a thousand is more
    assert all(sigma.translation_mm < 0.7 for sigma in results.proof.sigmas.values())


@pytest.mark.thorough
def test_the_borders_of_the_two_kinds_of_sensors_have_their_own_noise(
    with_lidar: tuple[CollectionResults, Path],
) -> None:
    levels = calibrate(read_dataset(with_lidar[1])).noise_levels
    pixel, step = 2 * np.tan(np.radians(65) / 2) / 640, 2 * np.pi / 1875
    assert levels.depth_border == pytest.approx(pixel / 12**0.5, rel=0.15)
    assert levels.border == pytest.approx(step / 12**0.5, rel=0.25)


def test_a_rejected_border_label_is_named_by_its_point(rgb_and_depth: tuple[CollectionResults, Path]) -> None:
    dataset = read_dataset(rgb_and_depth[1])
    found = calibrate(dataset, Options(noise_levels=NoiseLevels(depth_border=1e-4)))
    limits = {c.key: set(c.labels["pattern_1", "left_camera"].limits.tolist()) for c in dataset.collections}
    rejected = [label for label in found.rejected if label.kind == "depth_border"]
    assert len(rejected) > 100
    assert all(label.label in limits[label.collection] for label in rejected)


def test_its_files_and_labels(rgb_and_depth: tuple[CollectionResults, Path]) -> None:
    results, folder = rgb_and_depth
    document = json.loads((folder / "dataset.json").read_text())
    image = cv2.imread(str(folder / "left_camera_000.png"), cv2.IMREAD_UNCHANGED)
    assert (image.dtype, image.shape) == (np.uint16, (480, 640))
    labels = document["collections"]["000"]["labels"]["pattern_1"]["left_camera"]
    depths = image.ravel()[labels["idxs"]]
    assert depths.min() > 8000
    assert depths.max() < 40_000
    assert document["sensors"]["left_camera"]["camera_info"]["width"] == 640
    assert results.records[0].labels["left_camera"] == len(labels["idxs"])


def test_the_contact_sheet_shows_the_pattern_in_the_depth_image(rgb_and_depth: tuple[CollectionResults, Path]) -> None:
    sheet = cv2.imread(str(rgb_and_depth[1] / "contact_sheet.png"))
    pixels = sheet.reshape(-1, 3)
    assert (pixels == (90, 200, 90)).all(-1).sum() > 100 * POSES  # on the pattern
    assert (pixels == (60, 120, 255)).all(-1).sum() > 50 * POSES  # on its border
