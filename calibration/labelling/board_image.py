"""The image of a flat board: a smooth map from its plane to pixels, known at some points.

For a camera without distortion the map is a homography; distortion bends it a little, everywhere
smoothly. So near any place it is the homography of the whole board plus a quadratic, fitted to what
the homography leaves over at the points around. No camera intrinsics are needed.

Places on the board are in squares: one unit is the side of a square.
"""

from dataclasses import dataclass

import numpy as np

from calibration.estimation.median import median
from calibration.geometry.types import Array, BoolArray

REACH = 1.5
"""A point at this distance (squares) weighs 1/e of one beside the place that is asked for."""
RIDGE = 1e-3
"""What holds the quadratic still where the points do not determine it; in weights of a point."""
LEAST_MISFIT, LEAST_SHARE = 0.15, 0.005
"""Corners that fit their neighbours this well are never in doubt: px, and of the side of a square there.

The share is what strong distortion leaves over near the border of a board, where neighbours are on one side only.
"""
DOUBTFUL = 5.0
"""A corner is in doubt when it misfits its neighbours by so many medians of all misfits."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """Where places of the board lie in the image, by the points around them."""

    pixels: Array
    """(M, 2)."""
    jacobians: Array
    """(M, 2, 2): what one square along the board's x and y (columns) is in pixels along the image's x and y (rows)."""
    support: Array
    """(M,): the summed weights of the points around; below 1 there are not two beside it."""
    spread: Array
    """(M,): the standard deviation of `pixels` for points whose standard deviation is 1."""


def homography(places: Array, pixels: Array) -> Array:
    """The homography (3, 3) from places (N, 2) to pixels (N, 2), linear least squares on normalised points.

    R. Hartley and A. Zisserman, "Multiple View Geometry", 2nd edition, algorithm 4.2. It needs 4
    points of which no 3 lie on a line; otherwise it is one of many through them.
    """
    A, B = _normalisation(places), _normalisation(pixels)
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


def _normalisation(points: Array) -> Array:
    """The similarity (3, 3) that brings points to their centre, sqrt(2) away from it on average."""
    centre = points.mean(axis=0)
    scale = np.sqrt(2) / (float(np.sqrt(((points - centre) ** 2).sum(-1).mean())) or 1.0)
    return np.array([[scale, 0, -scale * centre[0]], [0, scale, -scale * centre[1]], [0, 0, 1]])


def project(H: Array, places: Array) -> tuple[Array, Array]:
    """Places (..., 2) to pixels (..., 2) by a homography, and its Jacobians (..., 2, 2); NaN on its horizon."""
    h = places @ H[:, :2].T + H[:, 2]
    depth = np.where(h[..., 2] == 0, np.nan, h[..., 2])[..., None]
    pixels = h[..., :2] / depth
    jacobians: Array = (H[:2, :2] - pixels[..., None] * H[2, :2]) / depth[..., None]
    return pixels, jacobians


def predict(places: Array, pixels: Array, wanted: Array) -> Prediction:
    """Where the wanted places lie.

    Args:
        places: (N, 2), the points that are known, in squares.
        pixels: (N, 2), where they lie.
        wanted: (M, 2), in squares.
    """
    around = _Around(places, wanted)
    return around.predict(pixels, around.near)


class _Around:
    """The known points around each wanted place."""

    def __init__(self, places: Array, wanted: Array) -> None:
        self._places, self._wanted = places, wanted
        offset = (places - wanted[:, None]) / REACH  # (M, N, 2)
        x, y = offset[..., 0], offset[..., 1]
        self.near: Array = np.exp(-x * x - y * y)
        """(M, N): how near each known point is to each wanted place, 0 to 1."""
        self._basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], -1)  # (M, N, 6)

    def predict(self, pixels: Array, weights: Array) -> Prediction:
        """Where the wanted places lie, for known points at pixels (N, 2) with weights (M, N)."""
        trusted = weights.sum(axis=0) > 0.3 * self.near.sum(axis=0)
        trusted = trusted if trusted.sum() >= 4 else np.ones(len(pixels), bool)
        H = homography(self._places[trusted], pixels[trusted])
        about, jacobians = project(H, self._wanted)
        left_over = pixels - project(H, self._places)[0]
        weighted = np.swapaxes(self._basis * weights[..., None], 1, 2)
        moments = weighted @ self._basis + RIDGE * np.eye(6)
        fit = np.linalg.inv(moments)[:, :3] @ weighted  # (M, 3, N): what each point adds to the value and the slopes
        bend = fit @ left_over  # (M, 3, 2): the quadratic's value and slopes at the wanted place
        return Prediction(
            pixels=about + bend[:, 0],
            jacobians=jacobians + np.swapaxes(bend[:, 1:], 1, 2) / REACH,
            support=weights.sum(-1),
            spread=np.sqrt((fit[:, 0] ** 2).sum(-1)),
        )


def fits_neighbours(places: Array, pixels: Array) -> BoolArray:
    """Which points (N,) lie where the others say.

    The misfit of a point is its distance from where the others predict it, in standard deviations of
    that difference, up to a factor common to all. Points that misfit lose their say in a few rounds.
    Lens distortion is no misfit, and noise is judged by the noise of the image itself.
    """
    around = _Around(places, places)
    others = around.near - np.eye(len(places))  # none speaks for itself
    weights = np.ones(len(places))
    for _ in range(4):
        predicted = around.predict(pixels, weights * others)
        misfit = np.linalg.norm(predicted.pixels - pixels, axis=-1) / np.sqrt(1 + predicted.spread**2)
        with np.errstate(invalid="ignore"):  # where points tell no homography all is NaN, and nothing fits
            side = np.sqrt(np.abs(np.linalg.det(predicted.jacobians)))
        limit = np.maximum(LEAST_SHARE * side, max(LEAST_MISFIT, DOUBTFUL * median(misfit)))
        weights = 1 / (1 + (2 * misfit / limit) ** 4)
    fits: BoolArray = misfit <= limit
    return fits
