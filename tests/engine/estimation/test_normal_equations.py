"""The normal equations: against differences of the cost, and the elimination against the dense system."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.base.arrays import Array
from calibration.engine.estimation.least_squares.normal_equations import NormalEquations, Weighting, assemble
from calibration.engine.estimation.least_squares.observability import covariances
from calibration.engine.estimation.problem import problem as problem_module
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.problem.problem import Problem
from tests.engine.estimation.tangled import COLLECTIONS, tangled

PLAIN = Weighting({"pixel": 0.5, "range": 0.005}, None)
ROBUST = Weighting({"pixel": 0.5, "range": 0.005}, 1.0)


def parameters(problem: Problem) -> int:
    return shared_parameters(problem) + COLLECTIONS * 6 * len(problem.local)


def shared_parameters(problem: Problem) -> int:
    return sum(problem.blocks[i].dimension for i in problem.shared)


def moved(problem: Problem, values: Values, step: Array) -> Values:
    """By one long vector: shared blocks first, then collection by collection."""
    S = shared_parameters(problem)
    return problem.moved(values, step[:S], step[S:].reshape(COLLECTIONS, -1))


def gradient(equations: NormalEquations) -> Array:
    return np.concatenate([equations.g_shared, equations.g_local.ravel()])


def dense(equations: NormalEquations) -> Array:
    """The whole Hessian."""
    N, S6, P6 = equations.H_mixed.shape
    H = np.zeros((S6 + N * P6, S6 + N * P6))
    H[:S6, :S6] = equations.H_shared
    for i in range(N):
        own = slice(S6 + i * P6, S6 + (i + 1) * P6)
        H[:S6, own], H[own, :S6], H[own, own] = equations.H_mixed[i], equations.H_mixed[i].T, equations.H_local[i]
    return H


@pytest.mark.parametrize("weighting", [PLAIN, ROBUST])
def test_the_gradient_of_every_block_is_half_that_of_the_cost(weighting):
    problem, values = tangled(noise=0.5)
    g = gradient(assemble(problem, values, weighting))
    h = 1e-6
    for k, axis in enumerate(np.eye(parameters(problem))):
        ahead, behind = (assemble(problem, moved(problem, values, s * h * axis), weighting).cost.sum() for s in (1, -1))
        assert 2 * g[k] == pytest.approx((ahead - behind) / (2 * h), rel=1e-4, abs=1e-5 * np.abs(g).max())


def test_without_residuals_the_hessian_is_the_derivative_of_the_gradient():
    problem, values = tangled()
    H, h = dense(assemble(problem, values, PLAIN)), 1e-6
    unit = np.eye(parameters(problem))
    unseen = (unit == H).all(1)  # the patterns that a collection does not see: a unit Hessian, so that they stay
    assert unseen.sum() == 6 * (1 + 3)
    assert parameters(problem) == 6 * (3 + 2 * COLLECTIONS) + 5 + 3 + 1
    for k in np.flatnonzero(~unseen):
        ahead, behind = (gradient(assemble(problem, moved(problem, values, s * h * unit[k]), PLAIN)) for s in (1, -1))
        np.testing.assert_allclose(H[k], (ahead - behind) / (2 * h), rtol=1e-5, atol=1e-7 * np.abs(H).max())


@pytest.mark.parametrize("damping", [0.0, 1e-3, 10.0])
def test_the_eliminated_step_is_that_of_the_dense_system(damping):
    problem, values = tangled(noise=0.5)
    equations = assemble(problem, values, PLAIN)
    shared, local, predicted = equations.step(damping)
    H, g = dense(equations), gradient(equations)
    step = np.linalg.solve(H + damping * np.diag(np.diagonal(H)), -g)
    np.testing.assert_allclose(np.concatenate([shared.ravel(), local.ravel()]), step, rtol=1e-6, atol=1e-12)
    assert predicted == pytest.approx(-2 * g @ step - step @ H @ step)


def test_a_small_step_lowers_the_cost_by_what_it_predicts():
    problem, values = tangled(noise=0.5)
    equations = assemble(problem, values, PLAIN)
    shared, local, predicted = equations.step(1e4)
    after = assemble(problem, problem.moved(values, shared, local), PLAIN)
    assert equations.cost.sum() - after.cost.sum() == pytest.approx(predicted, rel=1e-3)


def test_a_singular_system_gives_nan():
    problem, values = tangled(noise=0.5)
    equations = assemble(problem, values, PLAIN)
    equations.H_shared[:6], equations.H_shared[:, :6] = 0, 0
    equations.H_mixed[:, :6] = 0
    shared, local, predicted = equations.step(0.0)
    assert np.isnan([*shared.ravel(), *local.ravel(), predicted]).all()


def test_the_local_step_solves_each_collection_by_itself():
    problem, values = tangled(noise=0.5)
    equations = assemble(problem, values, PLAIN)
    damping = np.geomspace(1e-3, 10, COLLECTIONS)
    step = equations.local_step(damping)
    for i in range(COLLECTIONS):
        H = equations.H_local[i]
        expected = np.linalg.solve(H + damping[i] * np.diag(np.diagonal(H)), -equations.g_local[i])
        np.testing.assert_allclose(step[i].ravel(), expected, rtol=1e-9, atol=1e-15)


def test_the_covariance_is_the_block_of_the_dense_inverse():
    problem, values = tangled(noise=0.5)
    equations = assemble(problem, values, ROBUST)
    inverse = np.linalg.inv(dense(equations))
    blocks = covariances(problem, equations)
    assert list(blocks) == problem.shared
    for block, covariance in blocks.items():
        part = problem.shared_parameters[block]
        np.testing.assert_allclose(covariance, inverse[part, part], rtol=1e-6, atol=1e-9 * np.abs(covariance).max())
        np.testing.assert_array_equal(covariance, covariance.T)


def test_the_cost_of_a_collection_is_that_of_its_views():
    problem, values = tangled(noise=0.5)
    cost = assemble(problem, values, PLAIN).cost
    expected = np.zeros(COLLECTIONS)
    for group in problem.groups:
        term = group.terms[0]
        magnitudes = term.magnitudes(problem.poses(group, values)) / PLAIN.scales[term.kind]
        expected[group.collections] += np.nansum(magnitudes**2, -1)
    np.testing.assert_allclose(cost, expected)
    assert cost[5] == pytest.approx(expected[5])


def test_a_few_views_at_a_time_give_the_same(monkeypatch):
    problem, values = tangled(noise=0.5)
    whole = assemble(problem, values, ROBUST)
    monkeypatch.setattr(problem_module, "VIEWS_AT_A_TIME", 1)
    monkeypatch.setattr(problem_module, "LABELS_PER_CHUNK", 0)
    alone = replace(problem)
    assert {batch.views for batch in alone.batches} == {1}
    one_by_one = assemble(alone, values, ROBUST)
    np.testing.assert_allclose(dense(one_by_one), dense(whole), rtol=1e-10, atol=1e-9 * np.abs(dense(whole)).max())
    np.testing.assert_allclose(gradient(one_by_one), gradient(whole), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(one_by_one.cost, whole.cost)
