"""A problem with everything at once: what the normal equations are tried on."""

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.estimation.problem.blocks import Block, FreeJoint, Values
from calibration.engine.estimation.problem.problem import Problem
from calibration.engine.estimation.residuals.corner_residuals import CornerTerm
from calibration.engine.estimation.residuals.ray_residuals import RangeTerm
from calibration.engine.estimation.residuals.views import Chain, Link, ViewGroup
from calibration.engine.geometry import rotations
from calibration.engine.geometry.frames import JOINT_PARAMETERS, JointModel
from calibration.engine.geometry.transforms import apply, inverse, transform
from tests.engine.estimation.scenes import PINHOLE, WIDE, board, looks

COLLECTIONS = 6
CORNERS = board().corners - board().centre
A, HELD, P, F, Q, C, J1, J2, J3 = range(9)
BLOCKS = (
    Block("a"),
    Block("held", held=True),
    Block("moving", per_collection=True),
    Block("fixed"),
    Block("other moving", per_collection=True),
    Block("c"),
    Block(
        "joint-1", parameters=FreeJoint(JointModel(False, (0.0, 0.6, 0.8)), JOINT_PARAMETERS[:4] + JOINT_PARAMETERS[6:])
    ),
    Block(
        "joint-2", parameters=FreeJoint(JointModel(True, (0.6, 0.8, 0.0)), ("origin_y", "origin_yaw", "position_bias"))
    ),
    Block("joint-3", parameters=FreeJoint(JointModel(False, (0.0, 0.0, 1.0)), ("origin_roll",))),
)


def random_poses(rng: np.random.Generator, *shape: int) -> Array:
    return transform(rotations.exp(rng.normal(size=(*shape, 3))), rng.normal(size=(*shape, 3)))


def tangled(noise: float = 0.0, seed: int = 0) -> tuple[Problem, Values]:
    """Chains of inverted and straight links with constants between, and values at which labels have this noise (px)."""
    rng = np.random.default_rng(seed)
    values = tuple(random_poses(rng, COLLECTIONS) if b.per_collection else random_poses(rng) for b in BLOCKS[:J1])
    values += tuple(np.random.default_rng(seed + 1).normal(size=7) for _ in BLOCKS[J1:])
    one, many = random_poses(rng), random_poses(rng, COLLECTIONS)

    plan = [
        ("left", "moving", [0, 1, 2, 3], (Link(A, True, many[:4]), Link(P, False))),
        ("right", "moving", [0, 2, 3, 4], (Link(HELD, True), Link(C, True, one), Link(P, False))),
        ("left", "fixed", [1, 2, 4], (Link(C, True), Link(A, False, one), Link(F, False))),
        ("right", "other", [0, 3, 4], (Link(HELD, False, many[:3]), Link(C, False), Link(Q, False))),
        ("lidar", "moving", [1, 3], (Link(A, False), Link(P, True, one), Link(F, True, many[2:4]))),
        ("left", "other", [3, 4], (Link(P, False, one), Link(Q, False))),
        (
            "arm",
            "fixed",
            [0, 1, 5],
            (Link(J2, False), Link(J1, False, many[:3]), Link(C, False), Link(J3, False), Link(F, False)),
        ),
        ("arm", "moving", [0, 2], (Link(J3, False, one), Link(A, True), Link(J1, True, one), Link(P, False))),
    ]
    transforms = [block.pose(value) for block, value in zip(BLOCKS, values, strict=True)]
    groups = []
    for k, (sensor, pattern, which, links) in enumerate(plan):
        collections = np.array(which)
        views = looks(len(which), seed=10 * seed + k)
        views[:, :3, 3] = apply(views, board().centre[None])[:, 0]
        rest = Chain(None, links).poses(transforms, collections)
        term = _ranges(views, noise, rng) if sensor == "lidar" else _corners(views, noise, rng, partial=k == 1)
        groups.append(ViewGroup(sensor, pattern, collections, Chain(views @ inverse(rest), links), (term,)))
    return Problem(BLOCKS, tuple(groups), COLLECTIONS), values


def _corners(T: Array, noise: float, rng: np.random.Generator, partial: bool) -> CornerTerm:
    camera = WIDE if partial else PINHOLE
    pixels = camera.project(apply(T, CORNERS)).swapaxes(1, 2)
    seen = rng.random((len(T), len(CORNERS))) < 0.7 if partial else None
    return CornerTerm(camera, CORNERS, pixels + noise * rng.normal(size=pixels.shape), seen)


def _ranges(T: Array, noise: float, rng: np.random.Generator) -> RangeTerm:
    points = apply(T, CORNERS)
    lengths = np.linalg.norm(points, axis=-1)
    rays = (points / lengths[..., None]).swapaxes(1, 2)
    return RangeTerm(rays, lengths + 0.01 * noise * rng.normal(size=lengths.shape), np.ones(lengths.shape, bool))
