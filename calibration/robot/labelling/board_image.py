"""Image of a flat board: a smooth map from its plane to pixels, interpolated from known points.

Without distortion the map is a homography; distortion changes it smoothly. So near any position it is the
homography of the whole board plus a quadratic, fitted to the homography's residuals at the surrounding points.
No camera intrinsics are needed.

Positions on the board are in squares: one unit is the side of a square.
"""

from dataclasses import dataclass

import numpy as np

from calibration.base.arrays import Array, BoolArray
from calibration.engine.estimation.residuals.statistics import median

WEIGHT_REACH = 1.5
"""Distance (squares) at which the weight of a point is 1/e of that at the requested position."""
RIDGE_WEIGHT = 1e-3
"""Regularisation of the quadratic in directions that the points do not determine; in weights of a point."""
LEAST_MISFIT, LEAST_SHARE = 0.15, 0.005
"""Misfits below these are never rejected: px, and fraction of a square's side in the image.

The fraction allows for strong distortion near the border of a board, where neighbours are on one side only.
"""
MAX_CLEAR_MISFIT = 0.65
"""If all misfits are below this share of their limits, there is no outlier."""
MIN_OUTLIER_RATIO = 5.0
"""A corner is an outlier if its misfit exceeds this multiple of the median."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """Predicted positions in the image, by the surrounding points."""

    pixels: Array
    """(M, 2)."""
    jacobians: Array
    """(M, 2, 2): Jacobians of the image's x and y, px (rows), by the board's x and y, squares (columns)."""
    support: Array
    """(M,): the summed weights of the surrounding points; below 1 there are fewer than two close ones."""
    spread: Array
    """(M,): the standard deviation of `pixels` for points whose standard deviation is 1."""


def homography(places: Array, pixels: Array) -> Array:
    """Estimate the homography (3, 3) from positions (N, 2) to pixels (N, 2) by the normalised DLT.

    R. Hartley and A. Zisserman, "Multiple View Geometry", 2nd edition, algorithm 4.2. Requires 4
    points of which no 3 are collinear; otherwise it returns one of many solutions.
    """
    A, B = _normalising_similarity(places), _normalising_similarity(pixels)
    x, y = (places @ A[:2, :2].T + A[:2, 2]).T
    u, v = (pixels @ B[:2, :2].T + B[:2, 2]).T
    zero, one = np.zeros_like(x), np.ones_like(x)
    rows = np.concatenate(
        [
            np.stack([x, y, one, zero, zero, zero, -u * x, -u * y, -u], -1),
            np.stack([zero, zero, zero, x, y, one, -v * x, -v * y, -v], -1),
        ]
    )
    h = np.linalg.eigh(rows.T @ rows)[1][:, 0].reshape(3, 3)
    return np.asarray(np.linalg.solve(B, h @ A), float)


def _normalising_similarity(points: Array) -> Array:
    """Return the similarity (3, 3) that moves points to zero mean and a mean distance of sqrt(2)."""
    centre = points.mean(axis=0)
    scale = np.sqrt(2) / (float(np.sqrt(((points - centre) ** 2).sum(-1).mean())) or 1.0)
    return np.array([[scale, 0, -scale * centre[0]], [0, scale, -scale * centre[1]], [0, 0, 1]])


def project(H: Array, places: Array) -> tuple[Array, Array]:
    """Map positions (..., 2) to pixels (..., 2) by a homography, with Jacobians (..., 2, 2); NaN on its horizon."""
    h = places @ H[:, :2].T + H[:, 2]
    depth = np.where(h[..., 2] == 0, np.nan, h[..., 2])[..., None]
    pixels = h[..., :2] / depth
    jacobians: Array = (H[:2, :2] - pixels[..., None] * H[2, :2]) / depth[..., None]
    return pixels, jacobians


def predict(places: Array, pixels: Array, wanted: Array) -> Prediction:
    """Predict the pixels of wanted positions.

    Args:
        places: (N, 2), positions of known points, in squares.
        pixels: (N, 2), their pixels.
        wanted: (M, 2), in squares.
    """
    around = _Around(places, wanted)
    return around.predict(pixels, around.near)


class _Around:
    """Weights and quadratic basis of the known points around each wanted position."""

    def __init__(self, places: Array, wanted: Array) -> None:
        self._places, self._wanted = places, wanted
        self._same = places is wanted
        offset = (places - wanted[:, None]) / WEIGHT_REACH  # (M, N, 2)
        x, y = offset[..., 0], offset[..., 1]
        xx, yy = x * x, y * y
        self.near: Array = np.exp(-xx - yy)
        """(M, N): weight of each known point for each wanted position, 0 to 1."""
        self._least_trust = 0.3 * self.near.sum(axis=0)
        self._basis = np.stack([np.ones_like(x), x, y, xx, x * y, yy], 1)  # (M, 6, N)

    def predict(self, pixels: Array, weights: Array) -> Prediction:
        """Predict the wanted positions from known points at pixels (N, 2) with weights (M, N)."""
        trusted = weights.sum(axis=0) > self._least_trust
        trusted = trusted if trusted.sum() >= 4 else np.ones(len(pixels), bool)
        H = homography(self._places[trusted], pixels[trusted])
        about, jacobians = project(H, self._wanted)
        left_over = pixels - (about if self._same else project(H, self._places)[0])
        weighted = self._basis * weights[:, None]
        moments = weighted @ np.swapaxes(self._basis, 1, 2) + RIDGE_WEIGHT * np.eye(6)
        sides = np.zeros((len(moments), 6, 3))
        sides[:, :, :2], sides[:, 0, 2] = weighted @ left_over, 1.0
        solved = np.linalg.solve(moments, sides)
        bend = solved[:, :3, :2]  # (M, 3, 2): value and slopes of the quadratic at the wanted position
        shares = (solved[:, None, :, 2] @ weighted)[:, 0]  # (M, N): contribution of each point to the value
        return Prediction(
            pixels=about + bend[:, 0],
            jacobians=jacobians + np.swapaxes(bend[:, 1:], 1, 2) / WEIGHT_REACH,
            support=weights.sum(-1),
            spread=np.sqrt((shares**2).sum(-1)),
        )


def fits_neighbours(places: Array, pixels: Array) -> BoolArray:
    """Return a mask (N,) of the points that agree with the prediction from the others.

    The misfit of a point is its distance from the prediction by the others, in standard deviations of
    that difference, up to a common factor. Outliers lose their weight over a few rounds.
    Lens distortion does not cause misfits, and the noise is estimated from the image itself.
    """
    around = _Around(places, places)
    others = around.near - np.eye(len(places))  # without each point itself
    weights = np.ones(len(places))
    for _ in range(4):
        predicted = around.predict(pixels, weights * others)
        misfit = np.linalg.norm(predicted.pixels - pixels, axis=-1) / np.sqrt(1 + predicted.spread**2)
        with np.errstate(invalid="ignore"):  # if the points determine no homography all is NaN, and no point agrees
            side = np.sqrt(np.abs(np.linalg.det(predicted.jacobians)))
        limit = np.maximum(LEAST_SHARE * side, max(LEAST_MISFIT, MIN_OUTLIER_RATIO * median(misfit)))
        if (misfit < MAX_CLEAR_MISFIT * limit).all():
            break  # no weight would change by much
        weights = 1 / (1 + (2 * misfit / limit) ** 4)
    fits: BoolArray = misfit <= limit
    return fits
