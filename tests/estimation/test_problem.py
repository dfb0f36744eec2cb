"""Chains of links: their poses, and how the twist of each block moves them."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration.estimation.problem import Block, Chain, Link, Problem
from calibration.geometry.transforms import inverse, local, retract
from tests.estimation.tangled import random_poses, tangled

N = 4
LOCAL = (2, 3)
"""Of five blocks, those of which each collection has its own."""
links = st.lists(
    st.tuples(st.integers(0, 4), st.booleans(), st.sampled_from([None, "one", "many"])), min_size=1, max_size=6
)


@settings(max_examples=25, deadline=None)
@given(links=links, first=st.sampled_from([None, "one", "many"]), seed=st.integers(0, 99))
def test_the_jacobians_of_any_chain_are_its_derivatives(links, first, seed):
    rng = np.random.default_rng(seed)
    collections = np.array([0, 2, 3])
    values = tuple(random_poses(rng, N) if b in LOCAL else random_poses(rng) for b in range(5))
    constant = {None: None, "one": random_poses(rng), "many": random_poses(rng, 3)}
    chain = Chain(constant[first], tuple(Link(b, inverted, constant[after]) for b, inverted, after in links))
    held = [False, True, False, False, False]
    T, jacobians = chain.jacobians(values, slice(None), collections, held)
    np.testing.assert_allclose(T, chain.poses(values, slice(None), collections), atol=1e-12)
    assert {b for b, _ in jacobians} == {b for b, _, _ in links} - {1}
    h = 1e-6
    for b, J in jacobians:
        for k, axis in enumerate(np.eye(6)):
            moved = [
                retract(v, np.broadcast_to(h * axis, (*v.shape[:-2], 6))) if i == b else v for i, v in enumerate(values)
            ]
            after = chain.poses(tuple(moved), slice(None), collections)
            twist = local(np.broadcast_to(np.eye(4), after.shape), after @ inverse(T))  # in the sensor's frame
            np.testing.assert_allclose(
                np.broadcast_to(J, (3, 6, 6))[:, :, k], twist / h, atol=1e-4 * max(1, np.abs(J).max())
            )


def test_a_chain_is_the_product_of_what_it_is_made_of():
    rng = np.random.default_rng(0)
    before, after, A, P = random_poses(rng), random_poses(rng, 2), random_poses(rng), random_poses(rng, N)
    chain = Chain(before, (Link(0, True, after), Link(1, False)))
    T = chain.poses((A, P), slice(None), np.array([1, 3]))
    for v, c in enumerate((1, 3)):
        np.testing.assert_allclose(T[v], before @ np.linalg.inv(A) @ after[v] @ P[c])


def test_some_views_of_a_chain_are_those_of_all():
    problem, values = tangled()
    for group in problem.groups:
        all_views = problem.poses(group, values)
        some = slice(1, 3)
        np.testing.assert_allclose(group.chain.poses(values, some, group.collections[some]), all_views[some])


def test_held_blocks_are_neither_shared_nor_local_and_do_not_move():
    blocks = (Block("a"), Block("b", held=True), Block("c", per_collection=True), Block("d", True, True), Block("e"))
    problem = Problem(blocks, (), N)
    assert (problem.shared, problem.local) == ([0, 4], [2])
    rng = np.random.default_rng(1)
    values = tuple(random_poses(rng, N) if b.per_collection else random_poses(rng) for b in blocks)
    before = [v.copy() for v in values]
    shared, own = rng.normal(size=12), rng.normal(size=(N, 6))
    moved = problem.moved(values, shared, own)
    for i, step in ((0, shared[:6]), (4, shared[6:]), (2, own)):
        np.testing.assert_allclose(moved[i], retract(values[i], step))
    assert moved[1] is values[1]
    assert moved[3] is values[3]
    for value, old in zip(values, before, strict=True):
        np.testing.assert_array_equal(value, old)
