"""Undetermined directions, named by transform and axis; determined parameters, counted."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.base import UndeterminedError
from calibration.base.arrays import Array
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.least_squares.normal_equations import NormalEquations, Weighting, assemble
from calibration.engine.estimation.least_squares.observability import (
    MIN_UNDETERMINED_SIGMA,
    MIN_WEAK_SIGMA,
    WeakDirection,
    covariances,
    determined_parameters,
    open_directions,
)
from calibration.engine.estimation.problem.problem import Block, Problem
from calibration.engine.estimation.start.build import build
from calibration.engine.geometry.lenses import Distortion, DoubleSphere, Equidistant, Eucm, Omni, PlumbBob, Rational
from tests.engine.estimation.scenes import true_values
from tests.engine.estimation.systems import ALL, eye_to_hand, rotating
from tests.engine.estimation.tangled import tangled

NAMES = ["held", "camera", "pattern"]
PROBLEM = Problem((Block("held", held=True), Block("camera"), Block("pattern")), (), 1)
SIZE = 0.2
GOOD = np.full(12, 1e-4)


def equations(sigma: Array, directions: Array | None = None) -> NormalEquations:
    """Equations whose covariance has these standard deviations (m, rad) on the axes, or these orthonormal columns."""
    Q = np.eye(12) if directions is None else directions
    H = (Q * np.where(np.isinf(sigma), 0.0, 1 / sigma**2)) @ Q.T
    return NormalEquations(np.zeros(1), H, np.zeros(12), np.zeros((1, 0, 0)), np.zeros((1, 0, 13)))


def with_sigma(index: int, sigma: float) -> Array:
    out = GOOD.copy()
    out[index] = sigma
    return out


@pytest.mark.parametrize(
    ("index", "block", "kind", "axis"),
    [
        (0, 1, "translation", [1, 0, 0]),
        (4, 1, "rotation", [0, 1, 0]),
        (8, 2, "translation", [0, 0, 1]),
        (11, 2, "rotation", [0, 0, 1]),
    ],
)
def test_a_weak_axis_is_named(index, block, kind, axis):
    undetermined, (weak,) = open_directions(PROBLEM, equations(with_sigma(index, 0.012)), SIZE)
    assert undetermined == []
    assert (weak.block, weak.kind, weak.others) == (block, kind, ())
    np.testing.assert_allclose(weak.axis, axis, atol=1e-9)
    assert weak.sigma == pytest.approx(0.012)
    motion, unit = ("moving along", "mm") if kind == "translation" else ("turning about", "mrad")
    x, y, z = axis
    assert weak.describe(NAMES) == f"'{NAMES[block]}' {motion} ({x}, {y}, {z}) of its frame: 12 {unit}"


def test_a_common_motion_names_all_moving_blocks():
    direction = np.zeros(12)
    direction[:3], direction[6:9] = [-0.6, 0.0, -0.56], [0.0, 0.5, 0.2]
    direction /= np.linalg.norm(direction)
    Q, _ = np.linalg.qr(np.column_stack([direction, np.eye(12)[:, 1:]]))
    _, (weak,) = open_directions(PROBLEM, equations(with_sigma(0, 0.02), Q), SIZE)
    assert (weak.block, weak.kind, weak.others) == (1, "translation", (2,))
    np.testing.assert_allclose(weak.axis, np.array([0.6, 0, 0.56]) / np.hypot(0.6, 0.56), atol=1e-3)
    assert weak.sigma == pytest.approx(0.02 * np.linalg.norm(direction[:3]), rel=1e-3)
    assert "together with 'pattern'" in weak.describe(NAMES)


@pytest.mark.parametrize(("index", "limit"), [(0, MIN_UNDETERMINED_SIGMA * SIZE), (9, MIN_UNDETERMINED_SIGMA)])
def test_beyond_a_quarter_of_the_pattern_or_radian_nothing_is_determined(index, limit):
    (below, above) = (open_directions(PROBLEM, equations(with_sigma(index, limit * f)), SIZE) for f in (0.99, 1.01))
    assert (len(below[0]), len(below[1])) == (0, 1)
    assert (len(above[0]), len(above[1])) == (1, 0)


def test_a_direction_without_information_has_no_bound():
    (undetermined,), weak = open_directions(PROBLEM, equations(with_sigma(7, np.inf)), SIZE)
    assert weak == []
    assert undetermined.sigma == np.inf
    assert undetermined.describe(NAMES) == "'pattern' moving along (0, 1, 0) of its frame: without bound"


def test_exact_labels_do_not_hide_what_is_open():
    """With next to no noise everything seems precise, but a direction is 10^12 times worse than the others."""
    sigma = with_sigma(7, 1e-2)
    sigma[sigma < 1e-2] = 1e-9
    (undetermined,), _ = open_directions(PROBLEM, equations(sigma), SIZE)
    assert undetermined.sigma == np.inf


def test_good_directions_are_not_mentioned():
    assert open_directions(PROBLEM, equations(np.full(12, 0.9 * MIN_WEAK_SIGMA)), SIZE) == ([], [])


def test_an_arm_that_hardly_tilts_is_weak_along_its_axis():
    rng = np.random.default_rng(0)
    axis = np.array([0.0, 0.6, 0.8])  # of the flange
    turns = np.linspace(-0.5, 0.5, 12)[:, None] * axis + 0.021 * rng.normal(size=(12, 3))
    scene = replace(rotating(eye_to_hand(12), turns), pixel_noise=1.2)
    result = calibrate(scene.dataset())
    assert result.converged
    (weak,) = result.weak_directions
    assert "'world-cam'" in weak
    assert "'board'" in weak
    assert "moving along" in weak
    named = np.array([float(x) for x in weak.split("(")[1].split(")")[0].split(",")])
    frame = "cam" if weak.startswith("'world-cam'") else "board_link"
    assert abs(named @ scene.dataset().transform(frame, "flange")[0][:3, :3] @ axis) > 0.98
    assert result.label_sigma_mm(("world", "cam")) > 1e3 * MIN_WEAK_SIGMA


def test_an_arm_that_tilts_less_than_the_noise_is_refused():
    rng = np.random.default_rng(0)
    turns = np.linspace(-0.5, 0.5, 12)[:, None] * [0.0, 0.6, 0.8] + 0.03 * rng.normal(size=(12, 3))
    with pytest.raises(UndeterminedError, match=r"do not determine '(world-cam|board)' moving along .* together with"):
        calibrate(replace(rotating(eye_to_hand(12), turns), pixel_noise=20.0).dataset())


@pytest.mark.parametrize("huber", [None, 1.5])
def test_the_kinds_of_labels_share_all_parameters_between_them(huber):
    weighting = Weighting({"pixel": 0.5, "range": 0.005, "border": 0.005}, huber)
    problem, values = tangled(noise=0.5)
    shares = determined_parameters(problem, values, assemble(problem, values, weighting), weighting)
    seen = 6 * (3 + 5 + 3) + 9  # three shared blocks; a pattern in five collections, one in three; joints
    assert sum(shares.values()) == pytest.approx(seen)
    assert 0 < shares["range"] < shares["pixel"]


@pytest.mark.parametrize("scene", ALL)
def test_one_kind_of_label_determines_all_parameters(scene):
    setup = build(ALL[scene](8, pixel_noise=0.3, range_noise=0.01).dataset())
    scales = {"pixel": 0.3, "range": 0.01, "border": 0.005, "lidar2d_range": 0.01, "lidar2d_border": 0.005}
    weighting = Weighting(scales, None)
    values = true_values(setup)
    result = assemble(setup.problem, values, weighting)
    shares = determined_parameters(setup.problem, values, result, weighting)
    patterns = [b.name for b in setup.problem.blocks if b.per_collection]
    seen = sum(len({c for g in setup.problem.groups if g.pattern == p for c in g.collections}) for p in patterns)
    assert sum(shares.values()) == pytest.approx(6 * (len(setup.problem.shared) + seen))
    for covariance in covariances(setup.problem, result).values():
        assert (np.linalg.eigvalsh(covariance) > 0).all()


@pytest.mark.parametrize(
    ("lens", "moving", "held"),
    [
        (PlumbBob(), ("k2", "k1", "k3"), ("k3",)),
        (Rational(), ("k3", "k6", "k4"), ("k4", "k6")),
        (Rational(), ("k1", "k3"), ("k3",)),
        (Equidistant(), ("k4", "k3"), ("k4",)),
        (DoubleSphere(0.1, 0.5), ("alpha", "xi", "fx"), ("xi",)),
        (Eucm(0.5, 1.1), ("alpha", "beta"), ("beta",)),
        (Omni(1.0), ("xi", "k1"), ("k1",)),
        (DoubleSphere(0.1, 0.5), ("fx", "xi"), ()),
    ],
)
def test_a_lens_says_which_coefficients_are_held_first(
    lens: Distortion, moving: tuple[str, ...], held: tuple[str, ...]
) -> None:
    direction = WeakDirection(0, "ray", np.zeros(3), np.inf, (), {0: moving})
    assert direction.coefficients_to_hold(lens) == held
