"""Given covariances of intrinsics: a prior if they are calibrated, considered if they are fixed."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.covariance.fixed_inputs import CAMERA_INFO
from calibration.engine.estimation.least_squares.noise_levels import NoiseLevels
from calibration.engine.estimation.least_squares.normal_equations import Weighting, assemble
from calibration.engine.estimation.least_squares.observability import determined_parameters
from calibration.engine.estimation.options import ALL_EXACT
from calibration.engine.estimation.problem.blocks import CalibratedIntrinsics
from calibration.engine.estimation.start.build import build
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import PlumbBob
from calibration.engine.geometry.transforms import inverse, local
from tests.engine.estimation.scenes import WIDE, camera, relative, true_values
from tests.engine.estimation.systems import covering, stereo

CAMERA = Camera(600.0, 590.0, 640.0, 480.0, 1280, 960, PlumbBob(-0.10, 0.05, 0.001, -0.0005, 0.01))
SIGMAS = np.array([3.0, 3.0, 4.0, 4.0, 0.01, 0.01, 0.001, 0.001, 0.005])
NOISE = NoiseLevels(pixel=0.3)


def covariance(seed: int = 0) -> Array:
    """(9, 9): with these sigmas, and correlated."""
    A = np.random.default_rng(seed).normal(size=(9, 9))
    C = A @ A.T + 3 * np.eye(9)
    d = SIGMAS / np.sqrt(np.diagonal(C))
    scaled: Array = C * d * d[:, None]
    return scaled


def known(C: Array | None = None, parameters: tuple[str, ...] = CAMERA.parameters) -> CalibratedIntrinsics:
    at = [CAMERA.parameters.index(each) for each in parameters]
    C = covariance() if C is None else C
    return CalibratedIntrinsics("plumb_bob", parameters, CAMERA.intrinsics[at], C[np.ix_(at, at)])


def drawn(seed: int, n: int = 20) -> Dataset:
    """Views of two cameras with intrinsics drawn from the prior; they are in the dataset."""
    rng = np.random.default_rng(seed)
    root = np.linalg.cholesky(covariance())
    cameras = [CAMERA.with_intrinsics(CAMERA.intrinsics + root @ rng.normal(size=9)) for _ in range(2)]
    scene = covering(n, pixel_noise=0.3)
    return replace(scene, sensors=[camera(f"c{k}", model=each) for k, each in enumerate(cameras)]).dataset(seed)


def scores(options: Options, scenes: int) -> tuple[float, float]:
    """NEES over its expectation of the intrinsics, and of the pose between the cameras."""
    own, poses = [0.0], []
    for seed in range(scenes):
        truth = drawn(seed)
        result = calibrate(truth.with_cameras({"c0": CAMERA, "c1": CAMERA}), options)
        assert result.converged
        for name, found in result.intrinsics.items():
            at = [CAMERA.parameters.index(each) for each in found.parameters]
            e = found.values - truth.sensors[name].camera.intrinsics[at]
            own.append(e @ np.linalg.solve(found.covariance, e) / len(e))
        edge = truth.sensors["c1"].edge
        apart = inverse(truth.transforms[truth.sensors["c0"].edge][0]) @ truth.transforms[edge][0]
        e = local(relative(result)[edge], apart)
        poses.append(e @ np.linalg.solve(result.covariances[edge], e) / 6)
    return float(np.mean(own[1:] or own)), float(np.mean(poses))


BOTH = {"c0": known(), "c1": known()}
SCENES = 15


@pytest.mark.many_scenes
def test_considered_intrinsics_widen_the_result_as_much_as_they_move_it():
    options = Options(loss="linear", assume=ALL_EXACT, noise_levels=NOISE, intrinsics_covariance=BOTH)
    _, poses = scores(options, SCENES)
    assert abs(poses - 1) < 4 * np.sqrt(2 / (6 * SCENES))
    _, overconfident = scores(replace(options, intrinsics_covariance={}), 5)
    assert overconfident > 10


@pytest.mark.many_scenes
def test_a_prior_is_one_more_measurement():
    own, poses = scores(
        Options(loss="linear", assume=ALL_EXACT, noise_levels=NOISE, intrinsics=("all",), intrinsics_covariance=BOTH),
        SCENES,
    )
    assert abs(own - 1) < 4 * np.sqrt(2 / (9 * SCENES))
    assert abs(poses - 1) < 4 * np.sqrt(2 / (6 * SCENES))


@pytest.mark.many_scenes
def test_one_camera_calibrated_but_for_two_fixed_parameters_the_other_considered():
    hold = ("intrinsics-c0-k1", "intrinsics-c0-cx")
    own, poses = scores(
        Options(
            loss="linear",
            assume=ALL_EXACT,
            noise_levels=NOISE,
            intrinsics=("c0",),
            intrinsics_covariance=BOTH,
            hold=hold,
        ),
        SCENES,
    )
    assert abs(own - 1) < 4 * np.sqrt(2 / (7 * SCENES))
    assert 0.3 < poses < 1.3  # the labels tell part of what is considered, as views that disagree: it counts twice


def test_considered_intrinsics_change_nothing_but_the_covariance():
    dataset = covering(12, model=CAMERA, pixel_noise=0.3).dataset()
    plain = calibrate(dataset, Options(assume=ALL_EXACT))
    wider = calibrate(dataset, Options(assume=ALL_EXACT, intrinsics_covariance={"c0": known(), "elsewhere": known()}))
    assert (wider.cost, wider.degrees_of_freedom, wider.intrinsics) == (plain.cost, plain.degrees_of_freedom, {})
    for edge, T in plain.transforms.items():
        np.testing.assert_array_equal(wider.transforms[edge], T)
    for edge, C in plain.covariances.items():
        more = wider.covariances[edge] - C
        assert np.linalg.eigvalsh(more)[0] > -1e-9 * np.trace(more)
        assert np.trace(more) > np.trace(C)


def test_what_is_considered_is_how_the_optimum_moves():
    """K Sigma K^T against calibrations with each parameter off by a little."""
    dataset = covering(10, model=CAMERA).dataset()
    sigma = 1e-4 * SIGMAS
    C = np.diag(sigma**2)
    result = calibrate(dataset, Options(assume=ALL_EXACT, noise_levels=NOISE, intrinsics_covariance={"c1": known(C)}))
    edge = dataset.sensors["c1"].edge
    plain = calibrate(dataset, Options(assume=ALL_EXACT, noise_levels=NOISE))
    moves = []
    for step in np.diag(sigma):
        ahead = calibrate(
            dataset.with_cameras({"c1": CAMERA.with_intrinsics(CAMERA.intrinsics + step)}),
            Options(assume=ALL_EXACT, noise_levels=NOISE),
        )
        moves.append(local(plain.transforms[edge], ahead.transforms[edge]))
    expected = np.array(moves).T @ np.array(moves)
    more = result.covariances[edge] - plain.covariances[edge]
    np.testing.assert_allclose(more, expected, rtol=0.02, atol=0.02 * np.abs(expected).max())


def test_what_is_a_prior_is_not_considered_too():
    dataset = covering(5, model=CAMERA, pixel_noise=0.3).dataset()
    for intrinsics, causes in ((("all",), set()), (("c0",), {"c1"})):
        model = calibrate(dataset, Options(intrinsics=intrinsics, intrinsics_covariance=BOTH)).solution.model
        assert {cause.subject for cause in model.causes if cause.kind == CAMERA_INFO} == causes


def test_a_prior_decides_where_the_labels_do_not():
    """Far and small patterns in the middle of the image."""
    dataset = stereo(10, pixel_noise=0.3).dataset()
    cameras = {name: sensor.camera for name, sensor in dataset.sensors.items()}
    tight = {
        name: CalibratedIntrinsics("plumb_bob", each.parameters, each.intrinsics, np.diag((1e-3 * SIGMAS) ** 2))
        for name, each in cameras.items()
    }
    free, pulled = (
        calibrate(dataset, Options(intrinsics=("all",), intrinsics_covariance=each)) for each in ({}, tight)
    )
    for name in cameras:
        assert (pulled.intrinsics[name].sigmas < free.intrinsics[name].sigmas).all()
        assert (pulled.intrinsics[name].sigmas <= 1.001e-3 * SIGMAS).all()
        off = pulled.intrinsics[name].values - cameras[name].intrinsics
        assert (np.abs(off) < 4e-3 * SIGMAS).all()
    # what the prior has determined the labels have not: they keep their degrees of freedom
    assert pulled.degrees_of_freedom == pytest.approx(free.degrees_of_freedom + 18, abs=1)


@pytest.mark.parametrize("loss", ["linear", "huber"])
def test_the_noise_is_estimated_beside_a_prior(loss):
    truth = drawn(3, 30)
    result = calibrate(
        truth.with_cameras({"c0": CAMERA, "c1": CAMERA}),
        Options(loss=loss, intrinsics=("all",), intrinsics_covariance=BOTH),
    )
    assert result.noise_levels.pixel == pytest.approx(0.3, rel=0.05)


def test_the_parameters_may_be_a_subset_in_any_order():
    dataset = covering(8, model=CAMERA, pixel_noise=0.3).dataset()
    one, other = (
        calibrate(dataset, Options(intrinsics=("c0",), intrinsics_covariance={"c0": known(parameters=each)}))
        for each in (("k1", "fx", "cy"), ("fx", "cy", "k1"))
    )
    np.testing.assert_allclose(one.intrinsics["c0"].covariance, other.intrinsics["c0"].covariance, rtol=1e-9)
    assert one.intrinsics["c0"].parameters == CAMERA.parameters


def test_the_prior_s_share_of_the_equations():
    dataset = covering(6, model=CAMERA, pixel_noise=0.3).dataset()
    weighting = Weighting({"pixel": 0.3}, None)
    setups = [build(dataset, ("intrinsics-c0-fy",), ("c0",), each) for each in ({}, {"c0": known()})]
    values = true_values(setups[0])
    off = values[-1] + SIGMAS
    without, with_it = (assemble(s.problem, (*values[:-1], off), weighting) for s in setups)
    information = np.linalg.inv(covariance())
    free = [0, 2, 3, 4, 5, 6, 7, 8]
    assert with_it.total - without.total == pytest.approx(SIGMAS @ information @ SIGMAS)
    np.testing.assert_allclose(
        with_it.H_shared[-8:, -8:] - without.H_shared[-8:, -8:], information[np.ix_(free, free)], rtol=1e-3, atol=1.0
    )
    np.testing.assert_allclose(
        with_it.g_shared[-8:] - without.g_shared[-8:], (information @ SIGMAS)[free], rtol=1e-5, atol=1e-3
    )
    other = build(dataset, (), ("all",), {"c0": known()})
    everything = true_values(other)
    all_free = assemble(other.problem, everything, weighting)
    both = determined_parameters(other.problem, everything, all_free, weighting)["pixel"]
    assert 6 + 6 * 6 + 9 < both < 6 + 6 * 6 + 18  # nothing is known of the other camera
    counted = determined_parameters(setups[1].problem, values, with_it, weighting)["pixel"]
    assert 6 + 6 * 6 < counted < 6 + 6 * 6 + 8


def test_a_covariance_of_another_lens():
    wrong = replace(known(), model="equidistant")
    with pytest.raises(InputError, match="intrinsics of 'c0': it is of a lens equidistant, the dataset has plumb_bob"):
        build(covering(3).dataset(), intrinsics_covariance={"c0": wrong})
    wrong = replace(known(), parameters=(*CAMERA.parameters[:-1], "k6"))
    with pytest.raises(InputError, match="found 'k6', expected some of fx, fy, cx, cy, k1, k2, p1, p2, k3"):
        build(covering(3).dataset(), intrinsics_covariance={"c0": wrong})


def test_a_covariance_of_other_intrinsics():
    """Considered errors are those of the intrinsics in the dataset; a prior may lie elsewhere."""
    dataset = covering(6, model=WIDE).dataset()
    with pytest.raises(InputError, match="it is of fy = 590, more than a standard deviation from the 790 of the"):
        build(dataset, intrinsics_covariance={"c0": known()})
    assert build(dataset, intrinsics=("c0",), intrinsics_covariance={"c0": known()}).problem.has_priors


def test_a_covariance_of_no_camera_of_the_dataset():
    with pytest.raises(InputError, match=r"intrinsics-covariance: it is of left, expected one of the cameras \(c0, c1"):
        build(covering(3).dataset(), intrinsics_covariance={"left": known()})


def test_a_prior_that_the_labels_contradict_is_reported():
    truth = drawn(3)
    nominal = truth.with_cameras({"c0": CAMERA, "c1": CAMERA})
    options = Options(assume=ALL_EXACT, noise_levels=NOISE, intrinsics=("all",), intrinsics_covariance=BOTH)
    assert calibrate(nominal, options).warnings == ()
    values = CAMERA.intrinsics + np.array([0, 15 * SIGMAS[1], 0, 0, 0, 0, 0, 0, 0])
    off = replace(known(), values=values)
    (warning,) = calibrate(nominal, replace(options, intrinsics_covariance={**BOTH, "c1": off})).warnings
    assert warning.startswith("'intrinsics-c1': the labels contradict the given covariance: fy comes out ")
    assert warning.endswith(" standard deviations from the 635 that was given")
