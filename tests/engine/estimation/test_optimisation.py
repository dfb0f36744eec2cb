"""Weights that fit the residuals, and patterns that are not left in their mirrored pose."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.least_squares import minimisation
from calibration.engine.estimation.least_squares.minimisation import (
    HUBER_THRESHOLD,
    Evaluation,
    WeightedOptimum,
    minimise,
    optimise,
)
from calibration.engine.estimation.least_squares.noise_levels import NoiseLevels, estimate_scales, scales_of
from calibration.engine.estimation.least_squares.normal_equations import Squares, Weighting, assemble
from calibration.engine.estimation.problem.problem import Values
from calibration.engine.estimation.residuals.planar_pose import mirrored_poses
from calibration.engine.estimation.start import ambiguous_views
from calibration.engine.estimation.start.ambiguous_views import unflipped
from calibration.engine.estimation.start.build import Setup, build
from calibration.engine.estimation.start.linear_start import linear_start
from calibration.engine.geometry.transforms import distance, inverse, translation
from tests.engine.estimation.scenes import shaken, true_values
from tests.engine.estimation.systems import ALL, camera_and_lidar, ring, stereo, two_bodies

NOISY = {"pixel_noise": 0.3, "range_noise": 0.01, "partial": 0.3}
FLIPPED = [1, 4, 5]


def optimum(setup: Setup, robust: bool, values: Values | None = None) -> WeightedOptimum:
    return optimise(setup.problem, values or true_values(setup), NoiseLevels(), robust)


def mirrored(setup: Setup, values: Values, which: list[int], camera: int = 0) -> Values:
    """The moving pattern as its mirror image in the first camera that sees it in each of these collections, or -1:
    the last."""
    out = list(values)
    pattern = setup.block(setup.pattern_edge("board"))
    out[pattern] = values[pattern].copy()
    for i in which:
        group = [g for g in setup.problem.groups if i in g.collections and g.terms[0].kind == "pixel"][camera]
        v = np.flatnonzero(group.collections == i)
        T = setup.problem.poses(group, values)[v]
        before = T @ inverse(values[pattern][[i]])
        out[pattern][i] = (inverse(before) @ mirrored_poses(T))[0]
    return tuple(out)


@pytest.mark.parametrize("scene", [stereo, ring, two_bodies], ids=lambda s: s.__name__)
@pytest.mark.parametrize("robust", [False, True])
@pytest.mark.parametrize("camera", [0, -1])
def test_mirrored_patterns_are_found_and_put_right(scene, robust, camera):
    setup = build(scene(12, **NOISY).dataset(1))
    best = optimum(setup, robust)
    trapped = minimise(setup.problem, mirrored(setup, best.optimum.values, FLIPPED, camera), best.weighting)
    pattern = setup.block(setup.pattern_edge("board"))
    stuck = distance(trapped.values[pattern], best.optimum.values[pattern])[1] > 0.3
    assert set(np.flatnonzero(stuck)) <= set(FLIPPED)
    assert stuck.any()
    values, flipped = unflipped(setup.problem, trapped.values, best.weighting, trapped.equations.cost)
    assert flipped.tolist() == stuck.tolist()
    again = minimise(setup.problem, values, best.weighting)
    assert again.cost == pytest.approx(best.optimum.cost, abs=1e-4)
    for i, value in enumerate(trapped.values):
        if i != pattern:
            np.testing.assert_array_equal(values[i], value)


@pytest.mark.thorough(but_first=8)
@pytest.mark.parametrize("scene", ALL)
@pytest.mark.parametrize("robust", [False, True])
@pytest.mark.parametrize("exact", [False, True])
def test_at_the_optimum_nothing_is_flipped(scene, robust, exact):
    """Nor is rounding taken for a flip where labels are exact."""
    setup = build(ALL[scene](**({"border": False} if exact else NOISY)).dataset(2))
    best = optimum(setup, robust)
    values, flipped = unflipped(setup.problem, best.optimum.values, best.weighting, best.optimum.equations.cost)
    assert not flipped.any()
    for before, after in zip(best.optimum.values, values, strict=True):
        np.testing.assert_array_equal(before, after)


@pytest.mark.parametrize("scene", ["stereo", "eye in hand", "camera and lidar"])
@pytest.mark.parametrize("robust", [False, True])
def test_the_weights_are_those_of_the_residuals(scene, robust):
    setup = build(ALL[scene](20, **NOISY).dataset(3))
    best = optimum(setup, robust)
    estimated = estimate_scales(setup.problem, best.optimum.values, best.parameters, robust)
    assert estimated == pytest.approx(dict(best.weighting.scales), rel=1e-4)
    assert best.weighting.huber == (HUBER_THRESHOLD if robust else None)
    observed = len(setup.problem.shared) + sum(len(setup.dataset.keys) for _ in setup.problem.local)
    assert sum(best.parameters.values()) == pytest.approx(6 * observed, rel=1e-6)


@pytest.mark.parametrize("scene", ["stereo", "camera and lidar"])
@pytest.mark.parametrize("robust", [False, True])
def test_the_equations_are_those_of_the_weights(scene, robust):
    setup = build(ALL[scene](**NOISY).dataset(4))
    best = optimum(setup, robust)
    again = assemble(setup.problem, best.optimum.values, best.weighting)
    for name in ("cost", "H_shared", "H_mixed", "H_local"):
        expected = getattr(again, name)
        atol = 1e-5 * np.abs(expected).max()  # those of the last but one step, which differs by next to nothing
        np.testing.assert_allclose(getattr(best.optimum.equations, name), expected, atol=atol)
    gradient = best.optimum.equations.g_shared / np.sqrt(np.diagonal(best.optimum.equations.H_shared))
    assert np.abs(gradient).max() < 1e-3


def test_plain_least_squares_costs_its_degrees_of_freedom():
    setup = build(stereo(**NOISY).dataset())
    best = optimum(setup, robust=False)
    labels = sum(int(t.counts.sum()) * t.dimension for g in setup.problem.groups for t in g.terms)
    assert best.optimum.cost == pytest.approx(labels - 6 - 12 * 6)


def test_outliers_pull_no_harder_than_the_threshold():
    setup = build(stereo(20, **NOISY).dataset(5))
    best = optimum(setup, robust=True)
    plain = minimise(setup.problem, best.optimum.values, Weighting(best.weighting.scales, None))
    edge = setup.block(("world", "right"))
    assert distance(plain.values[edge], best.optimum.values[edge])[0] < 1e-3
    setup.problem.groups[0].terms[0].pixels[3, 0, :3] += 200.0
    spoiled = minimise(setup.problem, best.optimum.values, best.weighting)
    spoiled_plain = minimise(setup.problem, best.optimum.values, Weighting(best.weighting.scales, None))
    moved, moved_plain = (distance(s.values[edge], best.optimum.values[edge])[0] for s in (spoiled, spoiled_plain))
    assert moved < 2e-4
    assert moved_plain > 20 * moved


def test_patterns_that_start_mirrored_are_put_right():
    """At a distance the two poses of a pattern look alike in one camera; the other one distinguishes them."""
    scene = stereo(40, pixel_noise=0.5, partial=0.3)
    left, boards = scene.transforms["world", "left"], scene.transforms["world", "board_link"]
    far = {**scene.transforms, ("world", "board_link"): translation(2 * left[:3, 2]) @ boards}
    setup = build(replace(scene, transforms=far).dataset())
    start = linear_start(setup, true_values(setup)).values
    for robust in (False, True):
        trapped = optimise(setup.problem, start, NoiseLevels(), robust)
        optimum = trapped.optimum
        assert unflipped(setup.problem, optimum.values, trapped.weighting, optimum.equations.cost)[1].any()
        result = calibrate(setup.dataset, Options(loss="huber" if robust else "linear"))
        assert result.converged
        assert result.noise_levels.pixel < trapped.weighting.scales["pixel"]
        assert result.noise_levels.pixel == pytest.approx(0.5, rel=0.05)


def evaluation(setup: Setup, values: Values, weighting: Weighting) -> Evaluation:
    squares: Squares = {}
    return Evaluation(values, weighting, assemble(setup.problem, values, weighting, squares), squares)


@pytest.mark.parametrize("robust", [False, True])
def test_weights_that_fit_but_for_the_number_of_parameters_have_not_settled(robust):
    setup = build(stereo(**NOISY).dataset(4))
    best = optimum(setup, robust)
    squares = evaluation(setup, best.optimum.values, best.weighting).squares
    scales = scales_of(setup.problem, squares, {}, robust)
    now = evaluation(setup, best.optimum.values, Weighting(scales, best.weighting.huber))
    found = minimisation._Noise(setup.problem, {}, robust)(now)
    assert found.scales == pytest.approx(dict(best.weighting.scales), rel=1e-3)
    assert found.scales["pixel"] > 1.01 * scales["pixel"]


def test_weights_that_go_round_in_circles_stay_as_they_are_in_the_end():
    setup = build(stereo(**NOISY).dataset(4))
    best = optimum(setup, robust=True)
    squares = evaluation(setup, best.optimum.values, best.weighting).squares
    found = Weighting(scales_of(setup.problem, squares, {}, True), HUBER_THRESHOLD)
    noise, stayed = minimisation._Noise(setup.problem, {}, True), []
    for k in range(40):
        scales = {kind: scale * (1 + 1e-5 * (-1) ** k) for kind, scale in found.scales.items()}
        now = evaluation(setup, best.optimum.values, Weighting(scales, HUBER_THRESHOLD))
        found = noise(now)
        stayed.append(found is now.weighting)
    assert not any(stayed[:10])
    assert all(stayed[-5:])


@pytest.mark.parametrize("order", [1, -1])
def test_of_several_starts_one_without_a_cost_does_not_count(order):
    """And each collection has its own limit in all of them."""
    setup = build(camera_and_lidar(**NOISY).dataset(4))
    best, which = optimum(setup, robust=True), np.array([1, 4])
    near = shaken(setup, best.optimum.values, 0.02)
    near = tuple(
        T if block.per_collection else known
        for T, known, block in zip(near, best.optimum.values, setup.problem.blocks, strict=True)
    )
    nowhere = tuple(
        np.full_like(T, np.nan) if block.per_collection else T
        for T, block in zip(near, setup.problem.blocks, strict=True)
    )
    with np.errstate(all="ignore"):
        values, cost = ambiguous_views._best_settled(
            setup.problem, [near, nowhere][::order], which, best.weighting, np.array([-1e9, np.inf])[::order]
        )
    free = 1 if order == 1 else 0
    assert cost[free] == pytest.approx(best.optimum.equations.cost[which[free]], abs=0.01)
    pattern = setup.block(setup.pattern_edge("board"))
    off = distance(values[pattern], best.optimum.values[pattern][which])
    assert max(each[free] for each in off) < 1e-3
