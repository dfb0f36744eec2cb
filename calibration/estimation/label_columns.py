"""Derivatives of a view's labels: by its pose, its camera's intrinsics, its LiDAR's errors, its pattern's shape.

The derivative of every residual by a displacement d of its point on the pattern, along the pattern's axes, is given by
the rows of the pose's translation: ``dr = r_t . d`` (`calibration.estimation.residuals`). So the column of anything
that displaces points is the product of these rows and a field of displacements: ``d = (0, 0, f(x, y))`` of a bent
pattern, ``d = b R^T u`` of a LiDAR whose ranges are b too long (the point is moved back along its ray u, which is
equivalent to moving the pattern along it). Intrinsics of a camera have rows of their own.
"""

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from calibration.dataset.pattern import Pattern
from calibration.estimation.normal_equations import Weighting
from calibration.estimation.pose_residuals import PoseTerm
from calibration.estimation.ray_residuals import BorderTerm
from calibration.estimation.views import Term
from calibration.frozen import frozen
from calibration.geometry.cameras import Camera
from calibration.geometry.types import Array

POSE = 6
"""Number of the first columns: the twist of the view's pose in the pattern's frame."""
SHAPE = ("size_x", "size_y", "bow_x", "bow_y", "twist", "border")
"""Columns of a pattern: its relative length along x and along y; the height of its centre above its ends (m), bent
about y or about x; the height of opposite corners (m); the outward offset of its border (m)."""
LENS = ("skew", "prism_x", "prism_y")
"""Columns of a camera that its model has no coefficients for: non-perpendicular axes, thin prism along x and y."""
RANGING = ("bias", "scale", "elevation", "sweep_x", "sweep_y", "sweep_z")
"""Columns of a LiDAR or a depth camera: range offset (m) and scale, elevation offset of its beams
(rad), and motion during a sweep (m per revolution, in its own frame)."""


@frozen
class ColumnNames:
    """Columns of the views of one sensor and one pattern."""

    camera: Camera | None
    """Camera of a sensor with corner labels."""
    poses: bool = False
    """Whether the labels are poses: all of their errors are noise."""

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the columns after those of the pose."""
        if self.poses:
            return ()
        own = (*self.camera.parameters, *LENS) if self.camera else RANGING
        return (*own, *SHAPE)

    def selection(self, weights: dict[str, float]) -> Array:
        """Return the combination (6 + E, 1) of columns with these weights."""
        out = np.zeros((POSE + len(self.names), 1))
        for name, weight in weights.items():
            out[POSE + self.names.index(name)] = weight
        return out


def squeeze(
    terms: Sequence[Term], camera: Camera | None, pattern: Pattern, T: Array, weighting: Weighting
) -> tuple[Array, Array]:
    """Return the products of all columns of views, M (V, 6 + E, 6 + E), and with the residuals, m (V, 6 + E).

    Args:
        terms: the labels of the views, with the intrinsics at the optimum.
        camera: their camera, if they are corners.
        pattern: the pattern.
        T: ``T_sensor_pattern`` (V, 4, 4), the pattern's frame at the centre of its corners.
        weighting: standard deviations and loss of the residuals.
    """
    products = [_products(_columns(term, camera, pattern, T, weighting)) for term in terms]
    M, m = (sum(part[1:], part[0]) for part in zip(*products, strict=True))
    return M, m


def _products(rows: Array) -> tuple[Array, Array]:
    """Return M and m of weighted rows (V, 7 + E, n), the last of them the residuals."""
    G = rows @ rows.transpose(0, 2, 1)
    return G[:, :-1, :-1], G[:, :-1, -1]


def _columns(term: Term, camera: Camera | None, pattern: Pattern, T: Array, weighting: Weighting) -> Array:
    """Return all columns of the labels as rows (V, 6 + E + 1, d L), weighted; the last are the residuals."""
    scale, huber = weighting.scales[term.kind], weighting.huber
    if isinstance(term, PoseTerm):
        rows = term.rows(T, scale, huber)
    elif camera is not None:
        term = term.seen_with(camera, range(len(camera.parameters)))
        rows = term.rows(T, scale, huber, len(LENS) + len(SHAPE))
        of_camera = POSE + len(camera.parameters)
        _fill_lens(rows[:, of_camera : of_camera + len(LENS)], rows[:, POSE:of_camera], camera)
        _fill_shape(rows[:, of_camera + len(LENS) : -1], term, pattern, rows[:, :3], term.places(T))
    else:
        rows = term.rows(T, scale, huber, len(RANGING) + len(SHAPE))
        _fill_ranging(rows[:, POSE : POSE + len(RANGING)], term, rows[:, :3], T)
        _fill_shape(rows[:, POSE + len(RANGING) : -1], term, pattern, rows[:, :3], term.places(T))
    return rows.reshape(len(T), rows.shape[1], -1)


def _fill_lens(out: Array, intrinsics: Array, camera: Camera) -> None:
    """Fill the columns of `LENS` (V, 3, 2, L), from those of fx: w (x, 0), of fy: w (0, y) and of cx: w (1, 0).

    ``u = fx (x + skew y + prism_x r^2)``, ``v = fy (y + prism_y r^2)`` with distorted (x, y)
    (J. Weng et al., "Camera calibration with distortion models and accuracy evaluation", 1992).
    """
    weight = intrinsics[:, 2, 0]
    across, down = intrinsics[:, 0, 0], intrinsics[:, 1, 1]
    scale = np.where(weight > 0, weight, 1.0)
    weighted_r2 = weight * ((across / scale) ** 2 + (down / scale) ** 2)
    out[:, 0, 1] = out[:, 1, 1] = out[:, 2, 0] = 0.0
    np.multiply(down, camera.fx, out=out[:, 0, 0])
    np.multiply(weighted_r2, camera.fx, out=out[:, 1, 0])
    np.multiply(weighted_r2, camera.fy, out=out[:, 2, 1])


def _fill_ranging(out: Array, term: Term, pull: Array, T: Array) -> None:
    """Fill the columns of `RANGING` (V, 6, 1, L).

    They are computed at the expected ends of the rays, not at the measured ones: with noise in the column of the
    scale, it would explain the noise itself.
    """
    ends = T[:, :3, :3] @ term.places(T) + T[:, :3, 3:]
    pull = np.einsum("vij,vjdl->vidl", T[:, :3, :3], pull)  # along the sensor's axes
    length = np.maximum(np.linalg.norm(ends, axis=1, keepdims=True), 1e-9)
    x, y, z = (ends[:, i] for i in range(3))
    flat = np.maximum(np.hypot(x, y), 1e-9)
    higher = np.stack([-x * z / flat, -y * z / flat, flat], 1)
    turn = np.arctan2(y, x) / (2 * np.pi)
    for k, each in enumerate((ends / length, ends, -higher)):
        out[:, k] = (pull * each[:, :, None]).sum(1)
    np.multiply(pull, -turn[:, None, None], out=out[:, 3:])


def _fill_shape(out: Array, term: Term, pattern: Pattern, pull: Array, places: Array) -> None:
    """Fill the columns of `SHAPE` (V, 6, d, L), of labels at some places (V, 3, L) on the pattern."""
    if places.strides[0] == 0:
        places = places[:1]  # the same in all views
    half = np.ptp(pattern.outline, axis=0) / 2
    middle = pattern.outline.mean(0) - pattern.centre[:2]
    a, b = ((places[:, i, None] - middle[i]) / half[i] for i in range(2))
    for k, (axis, factor) in enumerate(
        ((0, places[:, 0, None]), (1, places[:, 1, None]), (2, a * a - 1), (2, b * b - 1), (2, a * b))
    ):
        np.multiply(pull[:, axis], factor, out=out[:, k])
    out[:, 5] = 0.0
    if isinstance(term, BorderTerm):
        nearest = (np.einsum("si,vil->vls", term.normals, places[:, :2]) - term.offsets).argmax(-1)
        outward = np.moveaxis(term.normals[nearest], -1, 1)
        out[:, 5] = pull[:, 0] * outward[:, None, 0] + pull[:, 1] * outward[:, None, 1]
