"""Errors of held intrinsics: of a nominal calibration, as assumptions scale it, or given."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.base.arrays import Array
from calibration.engine.estimation.covariance.lens_errors import LensErrors, lens_errors
from calibration.engine.estimation.options import ALL_EXACT, Assumptions
from calibration.engine.estimation.problem.blocks import Prior
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import Distortion, Equidistant, PlumbBob, Rational

PLAIN = Camera(550.0, 560.0, 322.0, 238.0, 640, 480)
LENSES = (
    PlumbBob(),
    PlumbBob(-0.3, 0.1, 0.001, -0.001),
    PlumbBob(-0.3, 0.1, 0.001, -0.001, 0.05),
    Rational(-0.3, 0.1, 0.001, -0.002, 0.02, 0.1, -0.1, 0.08),
    Equidistant(-0.02, 0.01, -0.003, 0.001),
    Equidistant(),
)


def covariance(lens: LensErrors) -> Array:
    C: Array = lens.root @ lens.root.T
    return C


def sigma(lens: LensErrors, parameter: str) -> float:
    k = lens.parameters.index(parameter)
    return float(np.sqrt(covariance(lens)[k, k]))


def in_the_image(camera: Camera, lens: LensErrors, errors: Array) -> float:
    """Root mean square over the image, px, of what errors (k, n) of the intrinsics do to the projection of rays.

    A shift in the middle of the image is taken out: the pose of a sensor takes it up.
    """
    u, v = np.meshgrid(np.linspace(40, camera.width - 40, 9), np.linspace(30, camera.height - 30, 7))
    pixels = np.stack([u.ravel(), v.ravel()], -1)
    rays = np.stack(camera.from_pixels(*pixels.T), -1)
    at = [camera.parameters.index(parameter) for parameter in lens.parameters]
    moved = []
    for error in errors:
        values = camera.intrinsics
        values[at] += error
        off = camera.with_intrinsics(values).to_pixels(rays[:, 0], rays[:, 1]) - pixels
        moved.append(np.square(off - off.mean(0)).sum(-1).mean())
    return float(np.sqrt(np.sum(moved)))


@pytest.mark.parametrize("distortion", LENSES)
def test_errors_of_a_nominal_calibration_nearly_cancel_in_the_image(distortion: Distortion) -> None:
    """Independent errors of the same size would not, of many coefficients: they are why the block is correlated."""
    camera = replace(PLAIN, distortion=distortion)
    lens = lens_errors(camera, Assumptions(), None)
    assert 0.0003 < sigma(lens, "fx") / camera.fx < 0.003
    assert 0.2 < sigma(lens, "cx") < 1
    together = in_the_image(camera, lens, lens.root.T)
    alone = in_the_image(camera, lens, np.diag(np.sqrt(np.diagonal(covariance(lens)))))
    assert 0.1 < together < 1
    assert len(lens.parameters) <= 8 or alone > 1.5 * together


def test_coefficients_that_camera_info_has_count() -> None:
    def parameters(distortion: Distortion) -> tuple[str, ...]:
        return lens_errors(replace(PLAIN, distortion=distortion), Assumptions(), None).parameters[4:]

    assert [parameters(each) for each in LENSES] == [
        ("k1", "k2", "p1", "p2"),
        ("k1", "k2", "p1", "p2"),
        ("k1", "k2", "p1", "p2", "k3"),
        ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
        ("k1", "k2", "k3", "k4"),
        ("k1", "k2", "k3", "k4"),
    ]


@pytest.mark.parametrize("size", [0.1, 1.0, 10.0])
def test_a_larger_image_of_the_same_lens_has_the_same_relative_errors_of_its_board(size: float) -> None:
    def flat(scale: float) -> Array:
        camera = Camera(550 * scale, 550 * scale, 320 * scale, 240 * scale, round(640 * scale), round(480 * scale))
        root = lens_errors(camera, Assumptions(), None).root[:, -3:]
        return root / np.array([scale] * 4 + [1] * 4)[:, None]

    np.testing.assert_allclose(flat(size), flat(1.0), rtol=0.2, atol=0.1 * np.abs(flat(1.0)).max())


def test_what_is_stated_scales_all_of_it() -> None:
    nominal = lens_errors(PLAIN, Assumptions(), None)
    stated = lens_errors(PLAIN, Assumptions(principal_point=3 * sigma(nominal, "cx")), None)
    np.testing.assert_allclose(stated.root, 3 * nominal.root)
    larger = Assumptions(principal_point=sigma(nominal, "cx"), distortion=5 * sigma(nominal, "k1"))
    np.testing.assert_allclose(lens_errors(PLAIN, larger, None).root, 5 * nominal.root)
    assert (nominal.source, stated.source) == ("nominal", "assume")


def test_what_is_stated_as_exact_is_known_and_narrows_the_rest() -> None:
    nominal = lens_errors(PLAIN, Assumptions(), None)
    undistorted = lens_errors(PLAIN, Assumptions(distortion=0.0), None)
    for name in ("k1", "k2", "p1", "p2"):
        assert sigma(undistorted, name) < 1e-9 * sigma(nominal, name)
    assert 0.1 * sigma(nominal, "fx") < sigma(undistorted, "fx") < sigma(nominal, "fx")
    both = lens_errors(PLAIN, Assumptions(distortion=0.0, principal_point=0.0, focal_length=0.001), None)
    fx, fy = sigma(both, "fx") / PLAIN.fx, sigma(both, "fy") / PLAIN.fy
    assert fx == pytest.approx(0.001, rel=0.1)
    assert fy == pytest.approx(0.001, rel=0.1)
    assert sigma(both, "cx") < 1e-9


def test_exact_intrinsics_keep_what_they_would_be_worth() -> None:
    exact = lens_errors(PLAIN, ALL_EXACT, None)
    assert exact.is_exact
    np.testing.assert_array_equal(exact.root, lens_errors(PLAIN, Assumptions(), None).root)


def test_a_given_covariance_counts_whatever_is_assumed() -> None:
    C = np.array([[4.0, 0.5], [0.5, 1.0]])
    lens = lens_errors(PLAIN, ALL_EXACT, Prior((0, 2), np.array([550.0, 322.0]), C))
    assert (lens.parameters, lens.source, lens.is_exact) == (("fx", "cx"), "covariance", False)
    np.testing.assert_allclose(covariance(lens), C)
