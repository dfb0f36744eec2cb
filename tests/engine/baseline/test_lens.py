"""Intrinsics against the accepted ones: all parameters of a camera together, by their covariance."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.base.records import document_of, read
from calibration.engine.baseline.calibration_document import CalibrationDocument, document_of_calibration
from calibration.engine.baseline.comparison import BaselineChange, compare
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.options import Options
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import Equidistant, PlumbBob
from tests.engine.estimation.systems import covering

LENS = Camera(600.0, 590.0, 640.0, 480.0, 1280, 960, PlumbBob(-0.10, 0.05, 0.001, -0.0005, 0.01))
ALL = Options(intrinsics=("all",))


def calibrated(model: Camera, seed: int) -> CalibrationDocument:
    dataset = covering(25, seed, 1, model=model, pixel_noise=0.15).dataset(seed)
    result = calibrate(dataset, ALL)
    return document_of_calibration(result, dataset, result.rms_px, ALL)


def lens(before: CalibrationDocument, now: CalibrationDocument) -> list[BaselineChange]:
    return [each for each in compare(before, now).changes if each.kind == "lens"]


@pytest.fixture(scope="module")
def accepted() -> CalibrationDocument:
    return calibrated(LENS, 1)


def test_the_same_lens_has_not_changed(accepted: CalibrationDocument) -> None:
    comparison = compare(accepted, calibrated(LENS, 2))
    (change,) = [each for each in comparison.changes if each.kind == "lens"]
    assert change.name == "c0's lens"
    assert change.p > comparison.significance
    assert change.sigmas < 6


def test_another_focal_length_has(accepted: CalibrationDocument) -> None:
    comparison = compare(accepted, calibrated(replace(LENS, fx=615.0, fy=604.75), 2))
    (change,) = [each for each in comparison.changes if each.kind == "lens"]
    assert change.p < comparison.significance


def test_the_covariance_outlives_the_file(accepted: CalibrationDocument) -> None:
    again = read(CalibrationDocument, document_of(accepted), "a baseline")
    found, expected = again.lens("c0"), accepted.lens("c0")
    assert found is not None
    assert expected is not None
    assert found[0] == LENS.parameters
    assert np.allclose(found[2], expected[2], rtol=1e-9)
    assert np.linalg.eigvalsh(found[2] / np.sqrt(np.outer(np.diag(found[2]), np.diag(found[2]))))[0] > -1e-4


def test_a_baseline_without_correlations_and_another_model_are_not_compared_so(accepted: CalibrationDocument) -> None:
    now = calibrated(LENS, 2)
    assert not lens(replace(accepted, lens_correlations={}), now)
    assert now.lens("c7") is None
    fisheye = calibrated(Camera(560.0, 557.0, 640.0, 480.0, 1280, 960, Equidistant(-0.02, 0.01, -0.003, 0.001)), 3)
    assert not lens(accepted, fisheye)
    assert {each.kind for each in compare(accepted, fisheye).changes} >= {"added", "removed"}
