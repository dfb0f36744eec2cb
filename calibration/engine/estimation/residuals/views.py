"""Views and their chains: the pose of every view as a product of constants and unknowns.

A *view* is one sensor that sees one pattern in one collection. Its labels only depend on the
pose ``T_sensor_pattern``, a product of constants and of unknown transforms, the *blocks*. Free intrinsics
of a camera are a block that is in no chain: its views depend on the pose and on
them. Views of the same sensor and pattern share the same chain of blocks and form a *group*; all arrays of a
group have its views as their first axis.

The pattern frame of this module is the pattern's, moved to the centre of its corners: a twist about
the centre rotates the pattern without moving it, which decouples rotation and translation.

Every label of a view depends on one rigid pose ``T_sensor_pattern``. So its residuals are differentiated by a twist of
that pose in the *pattern's* frame, about the centre of its corners, once, and only the Hessian ``J^T J`` (6x6), the
gradient ``J^T r`` (6) and the cost leave the modules `corner_residuals`, `ray_residuals` and `pose_residuals`, whatever
the chain behind the pose. Free intrinsics of a camera are further columns of the same rows.
Points are stored as structure of arrays, and processed in chunks of views that fit into the processor's cache.

Products with tall matrices are made in pieces so small that BLAS starts no threads: on a busy machine threads wait for
each other, for longer than such products take.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.modalities import NoiseKind
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import inverse

MAX_MULTIPLICATIONS = 1 << 18
"""Most multiplications in a product of matrices for which OpenBLAS starts no threads."""


def product(A: Array, B: Array) -> Array:
    """Return ``A @ B`` (n, m) of a tall A (n, k) and a small B (k, m)."""
    out = np.empty((len(A), B.shape[1]))
    rows = _rows_per_piece(B.size)
    for start in range(0, len(A), rows):
        np.matmul(A[start : start + rows], B, out=out[start : start + rows])
    return out


def sum_of_products(A: Array, B: Array) -> Array:
    """Return ``A^T B`` (k, m) of two tall matrices (n, k) and (n, m)."""
    rows = _rows_per_piece(A.shape[1] * B.shape[1])
    total: Array = A[:rows].T @ B[:rows]
    for start in range(rows, len(A), rows):
        total += A[start : start + rows].T @ B[start : start + rows]
    return total


def _rows_per_piece(multiplications: int) -> int:
    """Return the number of rows in a piece, where each row takes so many multiplications."""
    return max(1, MAX_MULTIPLICATIONS // max(1, multiplications))


LABELS_PER_CHUNK = 19200
"""Labels per chunk: enough to be worth the calls on them, while their numbers fit into a cache; and BLAS starts no
threads for their product with the (4, 3) numbers of a pose (`calibration.engine.estimation.residuals.views`)."""
MAX_VIEWS_PER_CHUNK = 384
"""Most views per chunk, so that BLAS starts no threads for their rotations (v, 9) times (9, 54) numbers either."""

Linearised = tuple[Array, Array, Array]


# glibc maps fresh pages for every array above a threshold, and mapping them costs more than filling them. The threshold
# rises to the size of an array that is freed, at most 32 MB, and twice as much freed memory is kept for later arrays
# (M_MMAP_THRESHOLD and M_TRIM_THRESHOLD in mallopt(3)): they now reuse pages, in one calibration after another too.
np.empty(31 << 20, np.uint8)


def robust(squared: Array, huber: float | None) -> tuple[Array, Array | None]:
    """Return the cost (v,) of squared, normalised residuals (v, L), and the square root of their weights.

    Huber's loss: squared up to the threshold k, ``2 k e - k^2`` beyond it; its weight there is k / e.
    """
    if huber is None:
        return squared.sum(-1), None
    outside = np.flatnonzero(squared > huber * huber)
    if not len(outside):
        return squared.sum(-1), None
    e = np.sqrt(squared.take(outside))
    loss, weight = squared.copy(), np.ones(squared.shape)
    loss.put(outside, 2 * huber * e - huber * huber)
    weight.put(outside, np.sqrt(huber / e))
    return loss.sum(-1), weight


def total_loss(squared: Array, scale: float, huber: float | None) -> float:
    """Return the cost that `robust` gives to squared residuals of any shape, not normalised; NaN without a label."""
    flat = squared.ravel()
    limit = np.inf if huber is None else (huber * scale) ** 2
    cost = float(flat.compress(flat <= limit).sum()) / scale**2
    if huber is None:
        return cost
    e = np.sqrt(flat.compress(flat > limit)) / scale
    return cost + 2 * huber * float(e.sum()) - huber * huber * len(e)


def spread(rows: Array, out: Array) -> Array:
    """Fill the first six and the last of more rows (r, v, L) with rows (v, 7, L)."""
    out[:6], out[-1] = np.swapaxes(rows[:, :6], 0, 1), rows[:, 6]
    return out


def squeezed(rows: Array) -> tuple[Array, Array]:
    """Return Hessian (v, p, p) and gradient (v, p) of weighted rows (v, p + 1, n): the Jacobian's, and the residual."""
    G = rows @ rows.transpose(0, 2, 1)
    return G[:, :-1, :-1], G[:, :-1, -1]


def chunks(views: int, labels: int) -> Iterator[slice]:
    """Yield parts of the views with about `LABELS_PER_CHUNK` labels each, of 1 to `MAX_VIEWS_PER_CHUNK` views."""
    step = max(1, min(MAX_VIEWS_PER_CHUNK, LABELS_PER_CHUNK // max(1, labels)))
    for start in range(0, views, step):
        yield slice(start, min(start + step, views))


@dataclass(frozen=True, eq=False)
class Link:
    """Block in a chain, and the constant that follows it."""

    block: int
    inverted: bool
    after: Array | None = None
    """(4, 4), or (V, 4, 4) if it differs between collections; None for the identity."""


@dataclass(frozen=True, eq=False)
class Chain:
    """``T_sensor_pattern`` as ``before * link * link ...``, each link a block and a constant; no block occurs twice."""

    before: Array | None
    links: tuple[Link, ...]

    def poses(self, transforms: Sequence[Array], collections: IntArray) -> Array:
        """Return ``T_sensor_pattern`` (V, 4, 4), from the transform of each block, (4, 4) or (N, 4, 4)."""
        T = self.before
        for link in self.links:
            X = transforms[link.block]
            X = X[collections] if X.ndim == 3 else X
            T = times(times(T, inverse(X) if link.inverted else X), link.after)
        return per_view(T, len(collections))

    def part(self, start: int, end: int) -> "Chain":
        """Return the chain between two links: after the one at ``start``, or -1, and before that at ``end``."""
        return Chain(self.before if start < 0 else self.links[start].after, self.links[start + 1 : end])

    def then(self, other: "Chain") -> "Chain":
        """Return the product with another chain on the right."""
        if not self.links:
            return Chain(times(self.before, other.before), other.links)
        last = replace(self.links[-1], after=times(self.links[-1].after, other.before))
        return Chain(self.before, (*self.links[:-1], last, *other.links))

    def inverse(self) -> "Chain":
        """Return the inverse, with the links in reverse order."""
        constants = [self.before, *(link.after for link in self.links)]
        last, *others = [None if constant is None else inverse(constant) for constant in reversed(constants)]
        back = zip(reversed(self.links), others, strict=True)
        return Chain(last, tuple(Link(link.block, not link.inverted, after) for link, after in back))

    def take(self, views: IntArray | slice) -> "Chain":
        """Return the chain of only some of the views."""
        links = tuple(replace(link, after=_constant_of_views(link.after, views)) for link in self.links)
        return Chain(_constant_of_views(self.before, views), links)


class Term(Protocol):
    """Labels of a group's views, of one kind; see `calibration.engine.estimation.residuals.views`."""

    @property
    def kind(self) -> NoiseKind:
        """Kind of its residuals."""

    @property
    def dimension(self) -> int:
        """Residuals per label: 2 for a corner (axes weighted together), 1 for a distance, 3 for a half of a pose."""

    @property
    def counts(self) -> IntArray:
        """(V,): number of labels of each view."""

    @property
    def length(self) -> int:
        """L: places for labels in each view."""

    def take(self, views: IntArray | slice) -> "Term":
        """Return the term of only some of the views."""

    def seen_with(self, camera: Camera, free: Sequence[int]) -> "Term":
        """Return the same labels of a camera with other intrinsics, m of which (by their indices) are free."""

    def linearise(
        self, T: Array, scale: float, huber: float | None, squares: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """Cost (V,), Hessian (V, 6 + m, 6 + m) and gradient (V, 6 + m) for a twist in the pattern's frame.

        The m free intrinsics come after the six of the twist. A view that cannot be (a pattern behind its camera)
        costs infinity.

        Args:
            T: (V, 4, 4), ``T_sensor_pattern``.
            scale: the standard deviation that divides the residuals, px, m or rad.
            huber: the threshold in standard deviations beyond which the loss grows linearly.
            squares: (V, L), filled with the squared `magnitudes` where it is given.
        """

    def rows(self, T: Array, views: slice, scale: float, huber: float | None, spare: int = 0) -> tuple[Array, Array]:
        """Weighted rows (7 + m + spare, v, d, L): of the twist, of the m free intrinsics, spare ones, the residuals.

        `linearise` gives their products. Arguments as there, but of a part of the views, T (v, 4, 4); d is `dimension`,
        the spare rows are left for the caller. Also the expected positions of the labels on the pattern, m, in its
        frame: (v, 3, L), or (1, 3, L) if they are the same in all views.
        """

    def magnitudes(self, T: Array) -> Array:
        """Norm (V, L) of each label's residual in px, m or rad; NaN without a label."""


@dataclass(frozen=True, eq=False)
class ViewGroup:
    """Views of one sensor and one pattern."""

    sensor: str
    pattern: str
    collections: IntArray
    """(V,): collection of each view, ascending, each once."""
    chain: Chain
    terms: tuple[Term, ...]
    """With the nominal intrinsics of a camera; see `calibration.engine.estimation.problem.problem.Problem.terms`."""
    intrinsics: int | None = None
    """Block of the camera's intrinsics, if it has one."""

    def take(self, views: IntArray | slice) -> "ViewGroup":
        """Return the group with only some of the views."""
        terms = tuple(term.take(views) for term in self.terms)
        return replace(self, collections=self.collections[views], chain=self.chain.take(views), terms=terms)


def times(A: Array | None, B: Array | None) -> Array | None:
    """Return the product of transforms, in which None is the identity."""
    if A is None or B is None:
        return A if B is None else B
    return A @ B


def per_view(T: Array | None, views: int) -> Array:
    """Broadcast a transform, or one for each view, to (V, 4, 4)."""
    if T is not None and T.shape == (views, 4, 4):
        return np.ascontiguousarray(T)  # the usual case, at a fraction of the cost
    return np.ascontiguousarray(np.broadcast_to(np.eye(4) if T is None else T, (views, 4, 4)))


def _constant_of_views(constant: Array | None, views: slice | IntArray) -> Array | None:
    return constant[views] if constant is not None and constant.ndim == 3 else constant
