"""Intrinsics: calibrated with correct covariances by the same solver; undetermined ones are named."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.base import InputError, UndeterminedError
from calibration.base.arrays import Array
from calibration.engine.dataset.modalities import DEPTH, RGB
from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.least_squares.normal_equations import Weighting, assemble
from calibration.engine.estimation.least_squares.observability import determined_parameters
from calibration.engine.estimation.options import ALL_EXACT
from calibration.engine.estimation.problem.blocks import FreeIntrinsics
from calibration.engine.estimation.start.build import Setup, build
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import Distortion, Equidistant, PlumbBob, Rational
from calibration.engine.geometry.transforms import inverse, local, transform
from tests.engine.estimation.scenes import Scene, board, errors, relabelled, relative, true_values
from tests.engine.estimation.systems import ALL, arm_with_patterns, camera_and_lidar, covering, eye_in_hand, jointed_arm

LENSES: dict[str, Distortion] = {
    "plumb_bob": PlumbBob(-0.10, 0.05, 0.001, -0.0005, 0.01),
    "rational": Rational(-0.3, 0.1, 0.001, -0.002, 0.02, 0.1, -0.1, 0.08),
    "equidistant": Equidistant(-0.02, 0.01, -0.003, 0.001),
}
BENT = LENSES["plumb_bob"]
EVERY = Options(intrinsics=("all",))


def lens(distortion: Distortion) -> Camera:
    return Camera(600.0, 590.0, 640.0, 480.0, 1280, 960, distortion)


def nominal(dataset: Dataset, size: float = 0.02) -> Dataset:
    """The dataset with the intrinsics of all cameras off by this share, coefficients by five times as much."""
    off = {}
    for name, sensor in dataset.sensors.items():
        if sensor.modality == RGB and sensor.camera is not None:
            core = 1 + size * np.array([1.0, -1.0, 0.5, -0.5])
            more = 1 + 5 * size * np.ones(len(sensor.camera.intrinsics) - 4)
            off[name] = sensor.camera.with_intrinsics(sensor.camera.intrinsics * np.concatenate([core, more]))
    return dataset.with_cameras(off)


def intrinsics_error(result: Calibration, dataset: Dataset, camera: str) -> Array:
    true = dataset.sensors[camera].camera
    assert true is not None
    found = result.intrinsics[camera]
    error: Array = found.values - true.intrinsics[[true.parameters.index(each) for each in found.parameters]]
    return error


def largest_error(result: Calibration, dataset: Dataset) -> float:
    """Relative to the value, coefficients absolute."""
    worst = []
    for name, found in result.intrinsics.items():
        size = np.array([1.0 if unit == "1" else 500.0 for unit in found.units])
        worst.append(np.abs(intrinsics_error(result, dataset, name) / size).max())
    return float(max(worst))


@pytest.mark.parametrize("size", [0.0, 0.02])
@pytest.mark.parametrize("name", LENSES)
def test_exact_labels_give_the_truth(name, size):
    dataset = covering(model=lens(LENSES[name])).dataset()
    result = calibrate(nominal(dataset, size), EVERY, StartingNoise(0.3, 0.3))
    assert result.converged, result.reason
    assert set(result.intrinsics) == {"c0", "c1"}
    assert largest_error(result, dataset) < 1e-6
    assert max(errors(dataset, result.transforms, result.gauge)) < 1e-8
    for camera, sensor in dataset.sensors.items():
        now = result.dataset.sensors[camera].camera
        assert now is not None
        np.testing.assert_allclose(now.intrinsics, sensor.camera.intrinsics, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(
    "make",
    [ALL["anchored stereo"], eye_in_hand, camera_and_lidar, ALL["arm with patterns"], jointed_arm],
    ids=["anchored stereo", "eye in hand", "camera and lidar", "arm with patterns", "joints"],
)
def test_intrinsics_in_every_structure(make):
    dataset = make(16).dataset()
    result = calibrate(nominal(dataset, 0.01), replace(EVERY, start="given"))
    assert result.converged, result.reason
    assert largest_error(result, dataset) < 1e-4
    assert max(errors(dataset, result.transforms, result.gauge)) < 1e-6


def test_one_camera_before_moving_patterns_has_only_intrinsics_to_calibrate():
    dataset = covering(cameras=1, model=lens(BENT)).dataset()
    result = calibrate(nominal(dataset), EVERY)
    assert result.converged
    assert result.gauge == "c0"
    assert result.covariances == {}
    assert largest_error(result, dataset) < 1e-6


def test_only_the_requested_intrinsics_change():
    dataset = nominal(covering(model=lens(BENT), pixel_noise=0.1).dataset(), 1e-4)
    result = calibrate(dataset, Options(intrinsics=("c1",), hold=("intrinsics-c1-k3", "intrinsics-c1-cx")))
    assert set(result.intrinsics) == {"c1"}
    found = result.intrinsics["c1"]
    assert found.parameters == ("fx", "fy", "cy", "k1", "k2", "p1", "p2")
    assert found.units == ("px", "px", "px", "1", "1", "1", "1")
    assert found.model == "plumb_bob"
    assert found.covariance.shape == (7, 7)
    assert result.dataset.sensors["c0"] == dataset.sensors["c0"]
    before, after = (each.sensors["c1"].camera for each in (dataset, result.dataset))
    assert before is not None
    assert after is not None
    same = np.flatnonzero(before.intrinsics == after.intrinsics)
    assert [before.parameters[i] for i in same] == ["cx", "k3"]


def test_a_fixed_block_equals_one_not_requested():
    dataset = covering(12, pixel_noise=0.3).dataset()
    plain = calibrate(dataset)
    held = calibrate(dataset, Options(intrinsics=("all",), hold=("intrinsics-c0", "intrinsics-c1")))
    assert held.intrinsics == {}
    assert held.cost == plain.cost
    assert held.degrees_of_freedom == plain.degrees_of_freedom
    for edge, T in plain.transforms.items():
        np.testing.assert_array_equal(held.transforms[edge], T)


def test_the_error_names_what_can_be_fixed():
    with pytest.raises(InputError, match=r"nothing to hold is called 'k3' \(there are .*intrinsics-c0-k3"):
        calibrate(covering(4).dataset(), Options(intrinsics=("c0",), hold=("k3",)))
    with pytest.raises(InputError, match="nothing to hold is called 'intrinsics-c0'"):
        calibrate(covering(4).dataset(), Options(hold=("intrinsics-c0",)))


@pytest.mark.parametrize(
    ("name", "what"),
    [("lidar", "a lidar3d sensor, expected all or cameras (cam)"), ("nobody", "no sensor, expected all or cameras")],
)
def test_what_has_no_intrinsics_to_calibrate(name, what):
    with pytest.raises(InputError) as error:
        calibrate(camera_and_lidar(4).dataset(), Options(intrinsics=("cam", name)))
    assert str(error.value).startswith(f"scene/dataset.json: intrinsics: '{name}' is {what}")


def test_depth_cameras_have_none_either():
    dataset = camera_and_lidar(4).dataset()
    depth = replace(dataset.sensors["lidar"], modality=DEPTH, camera=lens(BENT))
    with pytest.raises(InputError, match="'lidar' is a depth sensor"):
        build(replace(dataset, sensors={**dataset.sensors, "lidar": depth}), intrinsics=("lidar",))


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("name", LENSES)
@pytest.mark.many_scenes
def test_the_errors_are_as_large_as_stated(name):
    """NEES (Y. Bar-Shalom et al., 2001) of each camera's intrinsics and of the pose between them."""
    own, poses, scenes = [], [], 15
    model = lens(LENSES[name])
    for seed in range(scenes):
        dataset = covering(20, seed=seed, model=model, pixel_noise=0.3).dataset(seed)
        result = calibrate(dataset, replace(EVERY, loss="linear" if seed % 2 else "huber", assume=ALL_EXACT))
        for camera, found in result.intrinsics.items():
            e = intrinsics_error(result, dataset, camera)
            own.append(e @ np.linalg.solve(found.covariance, e) / len(e))
        edges = [dataset.sensors[each].edge for each in ("c0", "c1")]
        true = inverse(dataset.transforms[edges[0]][0]) @ dataset.transforms[edges[1]][0]
        e = local(relative(result)[edges[1]], true)
        poses.append(e @ np.linalg.solve(result.label_covariances[edges[1]], e) / 6)
    freedom = scenes * len(model.intrinsics)  # the two cameras see the same patterns
    assert abs(np.mean(own) - 1) < 4 * np.sqrt(2 / freedom)
    assert abs(np.mean(poses) - 1) < 4 * np.sqrt(2 / (6 * scenes))


def facing(tilt: float, n: int = 20, cameras: int = 1, **changes: object) -> Scene:
    """Patterns that face the camera, but for a tilt of up to so much (rad)."""
    scene = covering(n, cameras=cameras, model=lens(BENT), **changes)
    rng = np.random.default_rng(1)
    turns = np.concatenate([rng.uniform(-tilt, tilt, (n, 2)), rng.uniform(-3, 3, (n, 1))], -1)
    T, centre = scene.transforms["world", "board_link"], board().centre
    R = rotations.exp(turns)
    moved = transform(R, (T[:, :3, :3] @ centre + T[:, :3, 3]) - R @ centre)
    return replace(scene, transforms={**scene.transforms, ("world", "board_link"): moved})


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_focal_lengths_from_patterns_that_face_the_camera(noise):
    """A pattern twice as far in an image twice as large: only its tilt distinguishes them."""
    with pytest.raises(UndeterminedError) as error:
        calibrate(facing(0.0, pixel_noise=noise).dataset(), EVERY)
    message = str(error.value)
    assert "the labels do not determine 'intrinsics-c0' (f" in message
    assert {"fx", "fy"} <= set(message.split("(", 1)[1].split(")")[0].split(", "))
    name = message.rpartition("or hold one of them, such as '")[2].removesuffix("'")
    assert name.startswith("intrinsics-c0-")
    build(facing(0.0).dataset(), (name,), EVERY.intrinsics)  # it can be held


def test_focal_lengths_from_patterns_that_hardly_tilt_are_weak():
    dataset = facing(0.05, pixel_noise=0.3).dataset()
    result = calibrate(dataset, EVERY)
    assert any("'intrinsics-c0' (f" in each and each.endswith("mrad of a ray") for each in result.weak_directions)
    assert result.intrinsics["c0"].sigmas[0] > 20  # px, of 600
    assert largest_error(result, dataset) < 4 * result.intrinsics["c0"].sigmas[0]


def test_corners_in_the_centre_of_the_image_hardly_determine_k3():
    narrow = covering(20, model=lens(BENT), pixel_noise=0.3)
    T = narrow.transforms["world", "board_link"].copy()
    centre = T[:, :3, :3] @ board().centre + T[:, :3, 3]
    T[:, :3, 3] += np.array([0.0, 0.0, 1.0]) - centre
    result = calibrate(replace(narrow, transforms={**narrow.transforms, ("world", "board_link"): T}).dataset(), EVERY)
    named = [each.split(":")[0] for each in result.weak_directions]
    assert {f"'intrinsics-c{k}' (k3)" for k in (0, 1)} <= set(named)


def test_good_views_are_not_called_weak():
    assert calibrate(covering(30, model=lens(BENT), pixel_noise=0.3).dataset(), EVERY).weak_directions == ()


def test_few_views_report_weak_directions():
    """Two views of a plane give four equations for focal lengths and principal point (Z. Zhang, 2000)."""
    dataset = covering(2, cameras=1, model=lens(BENT), pixel_noise=0.3).dataset()
    result = calibrate(dataset, EVERY)
    assert any("intrinsics-c0" in each for each in result.weak_directions)
    assert result.intrinsics["c0"].sigmas[0] > 10


MILD = Rational(-0.1, 0.05, 0.001, -0.0005, 0.01, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("start", ["linear", "given"])
@pytest.mark.parametrize("distortion", [Rational(), MILD], ids=["none", "mild"])
def test_a_fraction_that_could_be_a_polynomial_is_one_and_that_is_said(distortion, start):
    """With little distortion k1 to k3 and k4 to k6 cancel each other."""
    dataset = covering(20, model=lens(distortion), pixel_noise=0.3).dataset(1)
    result = calibrate(nominal(dataset), replace(EVERY, start=start))
    assert result.converged, result.reason
    (note,) = (each for each in result.notes if "do not determine" in each)
    for name, found in result.intrinsics.items():
        assert found.parameters == ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
        assert all(f"'intrinsics-{name}-{each}'" in note for each in ("k4", "k5", "k6"))
        off = intrinsics_error(result, dataset, name)[:4]
        assert (np.abs(off) < 4 * found.sigmas[:4]).all()
        camera = result.dataset.sensors[name].camera
        assert camera is not None
        assert camera.intrinsics[-3:].tolist() == [0, 0, 0]
    assert note.endswith("held at what the dataset says")


def test_fixed_coefficients_are_those_of_the_dataset():
    """Not where an optimum has put them that nothing determines."""
    given = Rational(-0.1, 0.05, 0.001, -0.0005, 0.01, 0.02, -0.01, 0.003)
    dataset = covering(20, cameras=1, model=lens(given), pixel_noise=0.3).dataset(1)
    result = calibrate(nominal(dataset, 0.0), EVERY)
    camera = result.dataset.sensors["c0"].camera
    assert camera is not None
    held = [i for i, each in enumerate(camera.parameters) if each not in result.intrinsics["c0"].parameters]
    assert {"k4", "k5", "k6"} >= {camera.parameters[i] for i in held} > set()
    np.testing.assert_array_equal(camera.intrinsics[held], lens(given).intrinsics[held])


def test_a_fraction_that_the_labels_tell_is_whole():
    result = calibrate(covering(30, model=lens(LENSES["rational"]), pixel_noise=0.1).dataset(1), EVERY)
    assert result.intrinsics["c0"].parameters[-3:] == ("k4", "k5", "k6")
    assert not any("do not determine" in each for each in result.notes)


@pytest.fixture(scope="module")
def tangle() -> Setup:
    """Several patterns, an arm, partial views, free intrinsics of which two are fixed."""
    dataset = arm_with_patterns(5, pixel_noise=0.5, partial=0.4).dataset()
    return build(dataset, ("intrinsics-cam-fy", "intrinsics-cam-k2"), ("cam",))


@pytest.mark.parametrize("huber", [None, 1.0])
def test_the_equations_are_the_derivatives_of_the_cost(tangle, huber):
    problem, weighting = tangle.problem, Weighting({"pixel": 0.5}, huber)
    values = true_values(tangle)
    equations = assemble(problem, values, weighting)
    S, P = len(equations.g_shared), equations.g_local.shape[1]
    h = 1e-6 * np.concatenate([np.ones(S - 7), [100.0, 100.0, 100.0, 1.0, 1.0, 1.0, 1.0]])
    for k in range(S):
        step = np.zeros(S)
        step[k] = h[k]
        ahead, behind = (
            assemble(problem, problem.moved(values, s * step, np.zeros((5, P))), weighting) for s in (1, -1)
        )
        numerical = (ahead.total - behind.total) / (2 * h[k])
        assert 2 * equations.g_shared[k] == pytest.approx(numerical, rel=1e-4, abs=1e-3)


def test_without_residuals_the_hessian_is_the_derivative_of_the_gradient(tangle):
    dataset = arm_with_patterns(5, partial=0.4).dataset()
    setup = build(dataset, (), ("cam",))
    problem, weighting = setup.problem, Weighting({"pixel": 0.5}, None)
    values = true_values(setup)
    equations = assemble(problem, values, weighting)
    S, P = len(equations.g_shared), equations.g_local.shape[1]
    for k in range(S - 9, S):
        step = np.zeros(S)
        step[k] = h = 1e-4 if k < S - 5 else 1e-7
        ahead, behind = (
            assemble(problem, problem.moved(values, s * step, np.zeros((5, P))), weighting) for s in (1, -1)
        )
        size = np.sqrt(equations.H_shared[k, k] * np.diagonal(equations.H_shared))
        error = (ahead.g_shared - behind.g_shared) / (2 * h) - equations.H_shared[k]
        assert np.abs(error / size).max() < 1e-5
        np.testing.assert_array_equal(equations.H_shared[k], equations.H_shared[:, k])
        mixed = (ahead.g_local - behind.g_local) / (2 * h)
        np.testing.assert_allclose(equations.H_mixed[:, k], mixed, atol=1e-5 * np.abs(mixed).max())


def test_kinds_of_labels_share_all_parameters_between_them():
    setup = build(camera_and_lidar(range_noise=0.005, pixel_noise=0.2).dataset(), (), ("cam",))
    values = true_values(setup)
    weighting = Weighting({"pixel": 0.2, "range": 0.005, "border": 0.002}, None)
    equations = assemble(setup.problem, values, weighting)
    shares = determined_parameters(setup.problem, values, equations, weighting)
    assert sum(shares.values()) == pytest.approx(6 + 9 + 6 * setup.problem.collections)
    assert shares["pixel"] > 9


@pytest.mark.parametrize(
    ("parameter", "value", "possible"),
    [("fx", 600.0, True), ("fx", -600.0, False), ("fy", 0.0, False), ("cx", np.nan, False), ("k1", -0.5, False)],
)
def test_cameras_that_cannot_be(parameter, value, possible):
    """Of a radius r (1 - 0.5 r^2) the image is folded over from r = 0.82."""
    camera = lens(PlumbBob())
    rays = np.array([[0.1, -0.9, 0.2], [0.0, 0.2, 0.3]])
    intrinsics = FreeIntrinsics("left", camera, camera.parameters, rays)
    trial = camera.intrinsics
    trial[camera.parameters.index(parameter)] = value
    assert intrinsics.possible(trial) is possible


def test_a_step_to_a_camera_that_cannot_be_costs_infinity():
    setup = build(covering(3, pixel_noise=0.1).dataset(), (), ("c1",))
    values = true_values(setup)
    weighting = Weighting({"pixel": 1.0}, None)
    assert np.isfinite(assemble(setup.problem, values, weighting).total)
    folded = values[-1].copy()
    folded[4] = -2.0
    for trial in (folded, values[-1] * [-1, 1, 1, 1, 1, 1, 1, 1, 1]):
        assert assemble(setup.problem, (*values[:-1], trial), weighting).total == np.inf


def test_a_lens_that_folds_over_beyond_its_labels_is_possible():
    camera = lens(PlumbBob(-0.5))
    near = FreeIntrinsics("left", camera, camera.parameters, np.array([[0.5], [0.3]]))
    assert near.possible(camera.intrinsics)
    # what the nominal camera folds over already does not speak against others
    far = FreeIntrinsics("left", camera, camera.parameters, np.array([[0.9], [0.3]]))
    assert far.possible(camera.intrinsics)


def test_outliers_do_not_matter():
    dataset = covering(30, model=lens(BENT), pixel_noise=0.2).dataset()
    rng = np.random.default_rng(0)

    def spoil(_: int, __: str, labels):
        pixels = labels.pixels.copy()
        pixels[rng.integers(len(pixels))] += rng.choice([-30.0, 30.0], 2)
        return replace(labels, pixels=pixels)

    result = calibrate(nominal(relabelled(dataset, spoil), 0.01), EVERY)
    assert result.converged
    assert len(result.rejected) >= 55
    for camera, found in result.intrinsics.items():
        assert np.abs(intrinsics_error(result, dataset, camera) / found.sigmas).max() < 5
