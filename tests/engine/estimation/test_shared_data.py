"""Real and independent synthetic data: the figures that a correct program finds (the data's own README)."""

from pathlib import Path

import numpy as np
import pytest

from calibration.engine.dataset.modalities import LIDAR3D
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.engine.geometry.transforms import distance, local

PLAIN = Options(loss="linear")
SEEDS = range(5)


def camera_to_camera(dataset, source: str, target: str) -> np.ndarray:
    return dataset.transform(dataset.sensors[source].frame, dataset.sensors[target].frame)[0]


def test_a_real_dataset_has_one_optimum_whatever_the_noise(shared_data: Path):
    dataset = read_dataset(shared_data / "t2rgb-paper")
    truth = camera_to_camera(dataset, "left_camera", "right_camera")
    results = [calibrate(dataset, PLAIN, StartingNoise(0.5, 0.5, seed)) for seed in SEEDS]
    for result in results:
        assert result.converged
        assert result.gauge == "left_camera"
        held = dataset.sensors["left_camera"].edge
        np.testing.assert_array_equal(result.dataset.transforms[held], dataset.transforms[held])
        assert result.rms_px == pytest.approx(results[0].rms_px, rel=1e-9)
        translation, rotation = distance(truth, camera_to_camera(result.dataset, "left_camera", "right_camera"))
        assert 1e3 * translation == pytest.approx(0.42, abs=0.01)
        assert np.degrees(rotation) == pytest.approx(0.0275, abs=0.001)
    robust = calibrate(dataset, noise=StartingNoise(0.5, 0.5, 3))
    assert robust.converged
    assert robust.noise_levels.pixel < 0.6 * results[0].noise_levels.pixel  # its errors are far from Gaussian
    assert len(robust.rejected) > 50


def test_a_rig_is_within_a_hundredth_of_maximum_likelihood(shared_data: Path):
    dataset = read_dataset(shared_data / "synthetic" / "t2rgb")
    truth = camera_to_camera(dataset, "right_camera", "left_camera")
    for seed in SEEDS:
        result = calibrate(dataset, PLAIN, StartingNoise(0.5, 0.5, seed))
        assert result.converged
        translation, rotation = distance(truth, camera_to_camera(result.dataset, "right_camera", "left_camera"))
        assert 1e3 * translation == pytest.approx(0.1525, rel=0.01)
        assert np.degrees(rotation) == pytest.approx(0.00445, rel=0.01)
        (edge,) = result.label_covariances
        assert result.label_sigma_mm(edge) == pytest.approx(0.217, rel=0.03)
        assert result.noise_levels.pixel == pytest.approx(0.3, rel=0.02)


def test_an_arm_is_within_a_hundredth_of_maximum_likelihood(shared_data: Path):
    dataset = read_dataset(shared_data / "synthetic" / "riwbot")
    (camera,) = dataset.sensors.values()
    for seed in SEEDS:
        result = calibrate(dataset, PLAIN, StartingNoise(0.5, 0.5, seed))
        assert result.converged
        translation, rotation = distance(dataset.transforms[camera.edge][0], result.transforms[camera.edge])
        assert 1e3 * translation == pytest.approx(0.0376, rel=0.01)
        assert np.degrees(rotation) == pytest.approx(0.00116, rel=0.01)
        assert result.label_sigma_mm(camera.edge) == pytest.approx(0.068, rel=0.03)


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("loss", ["linear", "huber"])
def test_a_lidars_error_matches_its_covariance(shared_data: Path, loss):
    dataset = read_dataset(shared_data / "synthetic" / "rlbot")
    lidar = next(s for s in dataset.sensors.values() if s.modality == LIDAR3D)
    for seed in SEEDS:
        result = calibrate(dataset, Options(loss=loss), StartingNoise(0.5, 0.5, seed))
        assert result.converged
        error = local(result.transforms[lidar.edge], dataset.transforms[lidar.edge][0])
        assert 1e3 * np.linalg.norm(error[:3]) < 2.5
        covariance = result.label_covariances[lidar.edge]
        assert (np.abs(error) < 3 * np.sqrt(np.diagonal(covariance))).all()
        assert error @ np.linalg.solve(covariance, error) < 22.5  # 99.9 % of chi-squared with 6 degrees of freedom
        assert result.label_sigma_mm(lidar.edge) < 1.61  # with limit points, better than planes alone
        assert result.noise_levels.range == pytest.approx(0.01, rel=0.03)
