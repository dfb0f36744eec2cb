"""What the data say about the unknowns: their covariance, and the directions that they leave open."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from calibration.estimation.intrinsics import root_mean_square
from calibration.estimation.normal_equations import NormalEquations, Weighting
from calibration.estimation.problem import NoiseKind, Problem, Values
from calibration.geometry.types import Array, IntArray

SINGULAR = 1e-12
"""Information in one direction relative to the best one, below which rounding has made it."""
HOPELESS = 0.25
"""A direction with a greater standard deviation than this (in sizes of the pattern, and in rad) is not determined."""
MOVING = 0.3
"""Blocks, and parameters of joints, that move by more than this times what moves most are named too,"""
INVOLVED = 0.02
"""and by more than this where the direction is not determined: a joint turns little where a pattern far away moves."""
WEAK = 0.005
"""A direction with a greater standard deviation (m or rad) is reported as weak."""


@dataclass(frozen=True, eq=False)
class WeakDirection:
    """A common motion of the shared blocks that the data hardly determine."""

    block: int
    """The block that moves most."""
    kind: str
    """"translation", "rotation", or "ray" of a camera's intrinsics."""
    axis: Array
    """(3,): the unit axis, in the block's child frame."""
    sigma: float
    """The standard deviation of that motion, m or rad; infinite where nothing determines it. Of intrinsics by how much
    they turn rays: those of the labels where it is not determined, where it is weak all over the image."""
    others: tuple[int, ...]
    """Blocks that move along, those that move most first."""
    parameters: Mapping[int, tuple[str, ...]] = field(default_factory=dict)
    """Of each joint or camera among the blocks, the parameters that change; the one that changes most first."""

    def describe(self, names: list[str]) -> str:
        """One phrase that names transform and axis, or joint or intrinsics and parameters."""
        unit = {"translation": "mm", "rotation": "mrad", "ray": "mrad of a ray"}[self.kind]
        size = f"{1e3 * self.sigma:.3g} {unit}" if np.isfinite(self.sigma) else "without bound"
        along = f" together with {_listed([self._name(other, names) for other in self.others])}" if self.others else ""
        if self.block in self.parameters:
            return f"{self._name(self.block, names)}{along}: {size}"
        x, y, z = np.round(self.axis, 2) + 0.0
        what = "moving along" if self.kind == "translation" else "turning about"
        return f"'{names[self.block]}' {what} ({x:g}, {y:g}, {z:g}) of its frame{along}: {size}"

    def to_hold(self, names: list[str]) -> str:
        """The name by which the parameter of a joint or a camera that changes least is held; empty without one."""
        return next((f"{names[block]}-{each[-1]}" for block, each in self.parameters.items() if each), "")

    def _name(self, block: int, names: list[str]) -> str:
        parameters = self.parameters.get(block)
        return f"'{names[block]}' ({', '.join(parameters)})" if parameters else f"'{names[block]}'"


def open_directions(
    problem: Problem, equations: NormalEquations, size: float
) -> tuple[list[WeakDirection], list[WeakDirection]]:
    """The directions that are not determined, and those that are weak.

    The information on the shared blocks (the Schur complement) is taken apart into its principal
    directions, translations measured in sizes of the pattern and intrinsics by how they turn the labels' rays, so
    that they compare with radians.

    Args:
        problem: the problem.
        equations: the normal equations at the optimum, in standard deviations.
        size: the pattern's (see `calibration.dataset.pattern.Pattern.size`), m.
    """
    S = equations.schur
    parts = _parts(problem, size)
    unit = np.concatenate([np.full(part.length, part.unit) for part in parts])
    information, directions = np.linalg.eigh(unit[:, None] * S * unit)
    undetermined, weak = [], []
    for value, direction in zip(information, directions.T, strict=True):
        singular = value <= SINGULAR * information[-1]
        sigma = np.inf if singular else 1 / np.sqrt(value)
        hopeless = singular or sigma > HOPELESS
        named = _named(parts, direction, sigma, INVOLVED if hopeless else MOVING)
        if hopeless:
            undetermined.append(named)
        elif named.sigma > WEAK and named.kind != "ray":
            weak.append(named)
    return undetermined, weak if undetermined else weak + _weak_intrinsics(problem, equations)


def _weak_intrinsics(problem: Problem, equations: NormalEquations) -> list[WeakDirection]:
    """The cameras whose intrinsics leave rays open somewhere in the image, with the parameters that do most of it.

    At the labels parameters make up for each other; where the image has no labels they do not.
    """
    weak = []
    covariance = covariances(problem, equations)
    for block in problem.shared:
        if (intrinsics := problem.blocks[block].intrinsics) is not None:
            bends, C = intrinsics.bends, covariance[block]
            sigma = float(np.sqrt(np.einsum("ian,ij,jan->", bends, C, bends) / bends.shape[-1]))
            own = root_mean_square(bends) * np.sqrt(np.diagonal(C))
            most = [intrinsics.free[k] for k in np.argsort(-own, kind="stable") if own[k] > MOVING * own.max()]
            if sigma > WEAK:
                weak.append(WeakDirection(block, "ray", np.zeros(3), sigma, (), {block: tuple(most)}))
    return weak


@dataclass(frozen=True)
class _Part:
    """Parameters that make one motion: a block's translation or rotation, or one parameter of a joint or a camera."""

    block: int
    kind: str
    length: int
    parameter: str = ""
    unit: float = 1.0
    """What is taken for one, as a change of the parameters: the size of the pattern, 1 rad, or what a camera has."""
    extent: float = 1.0
    """How far that moves the block, m or rad."""


def _parts(problem: Problem, size: float) -> list[_Part]:
    """The parts of the shared blocks, in the order of their parameters; ``size`` is the pattern's, m."""
    parts: list[_Part] = []
    for i in problem.shared:
        if joint := problem.blocks[i].joint:
            kinds = ["translation" if joint.model.unit(p) == "m" else "rotation" for p in joint.free]
            each = zip(kinds, joint.free, strict=True)
            parts += [_Part(i, kind, 1, name, *(2 * [size] if kind == "translation" else ())) for kind, name in each]
        elif intrinsics := problem.blocks[i].intrinsics:
            units, extents = intrinsics.unit, intrinsics.unit * intrinsics.reach
            rays = zip(intrinsics.free, units.tolist(), extents.tolist(), strict=True)
            parts += [_Part(i, "ray", 1, *part) for part in rays]
        else:
            parts += [_Part(i, "translation", 3, "", size, size), _Part(i, "rotation", 3)]
    return parts


def _named(parts: list[_Part], direction: Array, sigma: float, moving_from: float) -> WeakDirection:
    """Name one direction (S,), in units of the parts, by the block and the axis that move most.

    Others are named from ``moving_from`` times that motion.
    """
    pieces = np.split(direction, np.cumsum([part.length for part in parts])[:-1])
    length = np.array([np.linalg.norm(piece) for piece in pieces])
    most = parts[k := int(length.argmax())]
    axis = np.zeros(3)
    axis[: most.length] = pieces[k] / length[k]
    axis = axis * np.sign(axis[np.abs(axis).argmax()])
    moving = [int(m) for m in np.argsort(-length, kind="stable") if length[m] > moving_from * length[k]]
    blocks = dict.fromkeys(parts[m].block for m in moving)
    parameters = {b: tuple(parts[m].parameter for m in moving if parts[m].block == b) for b in blocks}
    return WeakDirection(
        block=most.block,
        kind=most.kind,
        axis=axis,
        sigma=float(sigma * length[k] * most.extent),
        others=tuple(block for block in blocks if block != most.block),
        parameters={block: each for block, each in parameters.items() if each[0]},
    )


def _listed(names: list[str]) -> str:
    """The first three names, and how many more there are."""
    more = [f"{len(names) - 3} more"] if len(names) > 3 else []
    return " and ".join([*names[:3], *more])


def covariances(problem: Problem, equations: NormalEquations, more: Array | None = None) -> dict[int, Array]:
    """The covariance of each shared block.

    (6, 6) of its twist (translation, rotation), m and rad, or (k, k) of the free parameters of a joint or a
    camera. The inverse of the Schur complement; held blocks have none. By Cramer and Rao no unbiased
    estimate can be better than this.

    Args:
        problem: the problem.
        equations: the normal equations at the optimum, in standard deviations.
        more: (S, S), what something else adds (see `calibration.estimation.consider`).
    """
    inverse = np.linalg.inv(equations.schur)
    inverse = inverse if more is None else inverse + more
    blocks = {}
    for block, part in problem.shared_parameters.items():
        blocks[block] = 0.5 * (inverse[part, part] + inverse[part, part].T)
    return blocks


def determined_parameters(
    problem: Problem, values: Values, equations: NormalEquations, weighting: Weighting
) -> Mapping[NoiseKind, float]:
    """How many of the parameters the labels of each kind have determined; they sum to all parameters.

    A kind's share is ``trace(M C)`` over its views, with M the information of its labels on the view's
    pose and C that pose's covariance (W. Foerstner's redundancy numbers, 1979).
    """
    kinds = {term.kind for group in problem.groups for term in group.terms}
    if len(kinds) == 1:
        observed = sum(np.count_nonzero(np.bincount(_collections_of(problem, block))) for block in problem.local)
        shared = sum(problem.blocks[i].dimension for i in problem.shared)
        return {kinds.pop(): shared + 6.0 * observed - _known_beforehand(problem, values, equations)}
    shares = dict.fromkeys(kinds, 0.0)
    pose_covariance = _PoseCovariance(problem, equations)
    for group in problem.groups:
        T, jacobians = group.chain.jacobians(values, slice(None), group.collections, problem.held)
        if (free := problem.free_intrinsics(group)) is not None:
            C = pose_covariance.with_intrinsics(group.collections, jacobians, free[0])
        else:
            C = pose_covariance.of(group.collections, jacobians)
        for term in problem.terms(group, values):
            _, M, _ = term.linearise(T, slice(None), weighting.scales[term.kind], weighting.huber)
            shares[term.kind] += float(np.einsum("vij,vji->", M, C))
    return shares


def _known_beforehand(problem: Problem, values: Values, equations: NormalEquations) -> float:
    """How many of the shared parameters the priors have determined: the trace of their share of the information."""
    if not problem.has_priors:
        return 0.0
    covariance = np.linalg.inv(equations.schur)
    known = 0.0
    for block, at in problem.shared_parameters.items():
        if (intrinsics := problem.blocks[block].intrinsics) is not None:
            _, _, information = intrinsics.pull(values[block])
            known += float(np.einsum("ij,ji->", information, covariance[at, at]))
    return known


class _PoseCovariance:
    """The covariance of views' poses from that of the blocks on their chain."""

    def __init__(self, problem: Problem, equations: NormalEquations) -> None:
        self._shared, self._local = problem.shared_parameters, problem.local_parameters
        self._schur_inverse = np.linalg.inv(equations.schur)
        self._gain = np.linalg.solve(equations.H_local, np.swapaxes(equations.H_mixed, 1, 2))  # (N, P, S)
        self._local_inverse = np.linalg.inv(equations.H_local)

    def of(self, collections: IntArray, jacobians: list[tuple[int, Array]]) -> Array:
        """(v, 6, 6), for a twist in the sensor's frame; jacobians as `Chain.jacobians` gives them."""
        return self._propagated(collections, *self._columns(len(collections), jacobians))

    def with_intrinsics(self, collections: IntArray, jacobians: list[tuple[int, Array]], block: int) -> Array:
        """(v, 6 + m, 6 + m), for that twist and the m free intrinsics of a block."""
        at = self._shared[block]
        J_shared, J_local = self._columns(len(collections), jacobians)
        own = np.zeros((len(collections), at.stop - at.start, J_shared.shape[-1]))
        own[:, :, at] = np.eye(own.shape[1])
        none = np.zeros((*own.shape[:2], J_local.shape[-1]))
        return self._propagated(collections, np.concatenate([J_shared, own], 1), np.concatenate([J_local, none], 1))

    def _columns(self, v: int, jacobians: list[tuple[int, Array]]) -> tuple[Array, Array]:
        """The Jacobian (v, 6, S) to the shared parameters, and (v, 6, P) to the local ones."""
        J_shared = np.zeros((v, 6, len(self._schur_inverse)))
        J_local = np.zeros((v, 6, self._local_inverse.shape[-1]))
        for block, J in jacobians:
            if block in self._local:
                J_local[:, :, self._local[block]] = J
            else:
                J_shared[:, :, self._shared[block]] = J
        return J_shared, J_local

    def _propagated(self, collections: IntArray, J_shared: Array, J_local: Array) -> Array:
        J = J_shared - J_local @ self._gain[collections]
        shared: Array = J @ self._schur_inverse @ np.swapaxes(J, 1, 2)
        local: Array = J_local @ self._local_inverse[collections] @ np.swapaxes(J_local, 1, 2)
        return shared + local


def _collections_of(problem: Problem, block: int) -> IntArray:
    """The collections of the views that depend on a block, one after the other."""
    groups = [g for g in problem.groups if any(link.block == block for link in g.chain.links)]
    return np.concatenate([group.collections for group in groups])
