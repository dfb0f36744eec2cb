"""Chains of links: their poses, how each parameter moves them, and views of several groups evaluated together."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from calibration.base.arrays import Array
from calibration.engine.estimation.least_squares.normal_equations import Weighting, assemble
from calibration.engine.estimation.problem.blocks import Block, FreeJoint, Values
from calibration.engine.estimation.problem.problem import Problem, table_of
from calibration.engine.estimation.residuals.corner_residuals import CornerTerm
from calibration.engine.estimation.residuals.views import Chain, Link, ViewGroup
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.frames import JOINT_PARAMETERS, JointModel
from calibration.engine.geometry.lenses import Equidistant, PlumbBob
from calibration.engine.geometry.transforms import inverse, local, retract
from tests.engine.estimation.scenes import PINHOLE, WIDE, board
from tests.engine.estimation.tangled import random_poses, tangled
from tests.properties import at_most

N = 4
JOINT = FreeJoint(JointModel(False, (0.0, 0.6, 0.8)), JOINT_PARAMETERS[3:])
BLOCKS = (
    Block("a"),
    Block("held", held=True),
    Block("moving", per_collection=True),
    Block("other moving", per_collection=True),
    Block("b"),
    Block("c"),
    Block("joint", parameters=JOINT),
    Block("held moving", per_collection=True, held=True),
)
POSES = [i for i, block in enumerate(BLOCKS) if not block.joint]
CONSTANTS = st.sampled_from([None, "one", "many"])
LINKS = st.lists(st.tuples(st.booleans(), CONSTANTS), min_size=1, max_size=4)


def values_of(rng: np.random.Generator) -> Values:
    return tuple(
        rng.normal(size=7) if b.joint else random_poses(rng, *([N] if b.per_collection else [])) for b in BLOCKS
    )


def corners(views: int, camera: Camera = PINHOLE, count: int = 6) -> CornerTerm:
    return CornerTerm(camera, board().corners[:count], np.zeros((views, 2, count)), None)


def twist(before: Array, after: Array) -> Array:
    """Motion of poses, in the pattern's frame."""
    return local(before, after)


@at_most(25)
@given(links=LINKS, first=CONSTANTS, joint=st.integers(-1, 3), groups=st.integers(1, 3), seed=st.integers(0, 99))
@example(links=[(False, None), (True, None)], first=None, joint=-1, groups=3, seed=0)
@example(links=[(False, None), (False, "one")], first=None, joint=-1, groups=3, seed=0)
def test_the_jacobians_of_any_chains_are_their_derivatives(links, first, joint, groups, seed):
    """Groups of one form, whatever their blocks are, go in one batch."""
    rng = np.random.default_rng(seed)
    values = values_of(rng)

    def constant(kind, views):
        return None if kind is None else random_poses(rng, *([views] if kind == "many" else []))

    views = []
    for _ in range(groups):
        collections = np.sort(rng.permutation(N)[: rng.integers(1, N + 1)])
        order = rng.permutation(POSES)[: len(links)].tolist()
        if 0 <= joint < len(links):
            order[joint] = BLOCKS.index(next(block for block in BLOCKS if block.joint))
        given = zip(order, links, strict=True)
        chain = tuple(Link(b, inverted, constant(after, len(collections))) for b, (inverted, after) in given)
        term = corners(len(collections))
        views.append(ViewGroup("s", "p", collections, Chain(constant(first, len(collections)), chain), (term,)))
    problem = Problem(BLOCKS, tuple(views), N)
    (batch,) = problem.batches
    T, J = batch.linearise(table_of(BLOCKS, values), values)

    def poses(at: Values) -> Array:
        return np.concatenate([problem.poses(group, at) for group in views])

    np.testing.assert_allclose(T, poses(values), atol=1e-12)
    S, P = problem.sizes
    h = 1e-6
    J_shared, J_local = batch.spread(J, (S, P), slice(0, 0))
    for k, axis in enumerate(np.eye(S + P)):
        after = poses(problem.moved(values, h * axis[:S], np.broadcast_to(h * axis[S:], (N, P))))
        expected = J_shared[:, :, k] if k < S else J_local[:, :, k - S]
        np.testing.assert_allclose(expected, twist(T, after) / h, atol=1e-4 * np.abs(J).max(initial=1))


def test_a_chain_is_the_product_of_what_it_is_made_of():
    rng = np.random.default_rng(0)
    before, after, A, P = random_poses(rng), random_poses(rng, 2), random_poses(rng), random_poses(rng, N)
    chain = Chain(before, (Link(0, True, after), Link(1, False)))
    collections = np.array([1, 3])
    T = chain.poses((A, P), collections)
    for v, c in enumerate((1, 3)):
        np.testing.assert_allclose(T[v], before @ np.linalg.inv(A) @ after[v] @ P[c])
    np.testing.assert_allclose(chain.inverse().poses((A, P), collections), inverse(T), atol=1e-12)
    for k in (0, 1):
        parts = (chain.part(-1, k), Chain(None, (replace(chain.links[k], after=None),)), chain.part(k, 2))
        np.testing.assert_allclose(parts[0].then(parts[1]).then(parts[2]).poses((A, P), collections), T, atol=1e-12)


def test_some_views_of_a_chain_are_those_of_all():
    problem, values = tangled()
    for group in problem.groups:
        np.testing.assert_allclose(
            problem.poses(group.take(slice(1, 3)), values), problem.poses(group, values)[1:3], atol=1e-14
        )


def test_fixed_blocks_are_neither_shared_nor_local_and_do_not_move():
    problem = Problem(BLOCKS, (), N)
    assert (problem.shared, problem.local) == ([0, 4, 5, 6], [2, 3])
    assert problem.sizes == (22, 12)
    rng = np.random.default_rng(1)
    values = values_of(rng)
    before = [v.copy() for v in values]
    shared, own = rng.normal(size=22), rng.normal(size=(N, 12))
    moved = problem.moved(values, shared, own)
    for i, step in ((0, shared[:6]), (4, shared[6:12]), (5, shared[12:18]), (2, own[:, :6]), (3, own[:, 6:])):
        np.testing.assert_allclose(moved[i], retract(values[i], step))
    np.testing.assert_allclose(moved[6], values[6] + np.concatenate([np.zeros(3), shared[18:]]))
    for held in (1, 7):
        assert moved[held] is values[held]
    for value, old in zip(values, before, strict=True):
        np.testing.assert_array_equal(value, old)


def seen(views: int, camera: Camera, count: int = 30, sensor: str = "s") -> ViewGroup:
    chain = Chain(None, (Link(2, False),))
    return ViewGroup(sensor, "p", np.arange(views) % N, chain, (corners(views, camera, count),))


@pytest.mark.parametrize(
    ("groups", "batches"),
    [
        ([seen(4, PINHOLE), seen(3, WIDE), seen(4, PINHOLE, 20)], [11]),
        ([seen(4, PINHOLE, 30), seen(3, PINHOLE, 14)], [4, 3]),  # would be filled up too much
        ([seen(70, PINHOLE), seen(70, WIDE)], [70, 70]),  # many views of several cameras
        ([seen(70, PINHOLE), seen(70, WIDE, sensor="t"), seen(70, PINHOLE)], [140, 70]),
        ([seen(600, PINHOLE), seen(70, PINHOLE)], [600, 70]),  # many labels
        ([seen(1025, PINHOLE)], [1024, 1]),
        ([seen(4, PINHOLE), seen(3, replace(PINHOLE, distortion=Equidistant(-0.02, 0.01)))], [4, 3]),  # two models
    ],
)
def test_small_groups_go_together_and_big_ones_in_parts(groups, batches):
    problem = Problem(BLOCKS, tuple(groups), N)
    assert [batch.views for batch in problem.batches] == batches
    assert [len(batch.terms[0].counts) for batch in problem.batches] == batches


def test_views_of_several_cameras_and_patterns_cost_what_they_cost_alone():
    rng = np.random.default_rng(0)
    other = replace(PINHOLE, fx=700.0, cx=600.0, distortion=PlumbBob(0.1, 0.0, 0.01, 0.0, 0.0))
    T = [np.eye(4) + 0.0 * random_poses(rng, 3) for _ in range(4)]
    terms = []
    for k, (camera, count) in enumerate(((PINHOLE, 30), (WIDE, 20), (other, 30), (PINHOLE, 16))):
        T[k][:, :3, 3] = rng.uniform((-0.1, -0.1, 1.0), (0.1, 0.1, 1.5), (3, 3))
        partial = rng.random((3, count)) < 0.8 if k == 2 else None
        pixels = camera.project(T[k][:, None, :3, 3] + board().corners[:count]).swapaxes(1, 2)
        terms.append(replace(corners(3, camera, count), pixels=pixels + rng.normal(size=pixels.shape), seen=partial))
    views = [ViewGroup("s", "p", np.arange(3), Chain(None, (Link(2, False),)), (term,)) for term in terms]
    (batch,) = Problem(BLOCKS, tuple(views), N).batches
    for huber in (None, 1.0):
        together = batch.terms[0].linearise(np.concatenate(T), 0.5, huber)
        alone = [term.linearise(at, 0.5, huber) for term, at in zip(terms, T, strict=True)]
        for whole, *parts in zip(together, *alone, strict=True):
            np.testing.assert_allclose(whole, np.concatenate(parts), rtol=1e-12, atol=1e-9)


def test_repeated_collections_have_the_poses_and_costs_of_the_originals() -> None:
    problem, values = tangled(noise=0.3)
    which = np.array([3, 0, 3, 1])

    many = problem.repeating(which)

    repeated = tuple(T[which] if b.per_collection else T for b, T in zip(problem.blocks, values, strict=True))
    weighting = Weighting({term.kind: 1.0 for group in problem.groups for term in group.terms}, None)
    cost = assemble(problem, values, weighting).cost
    assert cost[which].min() > 0
    np.testing.assert_allclose(assemble(many, repeated, weighting).cost, cost[which], rtol=1e-9)
