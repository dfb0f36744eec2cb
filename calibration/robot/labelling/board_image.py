"""Image of a flat board: the map from its plane to pixels, refinement of its corners, comparison with the print.

Without distortion the map is a homography; distortion changes it smoothly. So near any position it is the
homography of the whole board plus a quadratic, fitted to the homography's residuals at the surrounding points.
No camera intrinsics are needed.

Positions on the board are in squares: one unit is the side of a square.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.statistics import median
from calibration.robot.labelling.detection import Image

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


WINDOW_LIMITS = (2, 6)
"""Limits of the half-width of the refinement window (px)."""
QUICK_STOP = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 40, 1e-4)
"""Termination of OpenCV's refinement: iterations, and step in pixels."""
MAX_ITERATIONS, CONVERGED_STEP_PX = 40, 1e-7
"""Termination of the refinement here: iterations after which it has failed, and step (px) at which it has converged."""
MIN_MOMENTS_RATIO = 1e-4
"""Corners need gradients in several directions: minimum determinant of their moments over the squared trace."""
TEXELS_PER_SQUARE = 32
"""Texels of a drawn board per side of a square."""
PATCH_HALF_SIDE = 0.35
"""Half the side of the patch that is compared around a corner (squares)."""
PATCH_SAMPLES = 8
"""Samples of a patch, along each side."""


def refine(image: Image, pixels: Array, jacobians: Array, clearance: float) -> tuple[Array, BoolArray]:
    """Refine corners to sub-pixel accuracy.

    The corner c solves ``sum w g g' (p - c) = 0`` over the pixels p of a window about c, with g the
    gradient there and w a Gaussian weight (W. Foerstner and E. Guelch, "A fast operator for detection
    and precise location of distinct points", 1987; OpenCV's ``cornerSubPix``, whose weights these are).
    It is computed here in double precision to all stored digits, because OpenCV's
    result depends on the machine in the fourth decimal.

    The window is as wide as the squares allow: smaller ones have more noise, larger ones contain other
    corners. By measurement the best half-width is the clearance, at its shortest in the image.

    Args:
        image: (H, W), grey.
        pixels: (K, 2), approximate corners.
        jacobians: (K, 2, 2), pixels per square there.
        clearance: distance around a corner without other print, along x and y (squares).

    Returns:
        The corners (K, 2), and a mask (K,) of the successful ones: within their window, and that in the image.
    """
    known: BoolArray = np.logical_and(np.isfinite(jacobians).all(axis=(1, 2)), np.isfinite(pixels).all(axis=-1))
    half = np.clip(np.floor(clearance * shortest(jacobians)), *WINDOW_LIMITS).astype(int)
    refined, found = np.where(known[:, None], pixels, 0.0), np.zeros(len(pixels), bool)
    for each in np.unique(half[known]).tolist():
        chosen = known & (half == each)
        refined[chosen], found[chosen] = _refine_in_windows(image, refined[chosen], each)
    return refined, found


def shortest(jacobians: Array) -> Array:
    """Length (K,) of a unit of the board in the image, in the direction in which it is shortest, px; 0 if unknown."""
    known = np.isfinite(jacobians.sum(axis=(1, 2)))
    return np.linalg.svd(np.where(known[:, None, None], jacobians, 0.0), compute_uv=False)[:, 1]


def angles(jacobians: Array) -> Array:
    """Angle (K,) between the board's two directions in the image, rad, at most a right one; 0 if unknown."""
    known = np.isfinite(jacobians.sum(axis=(1, 2)))
    J = np.where(known[:, None, None], jacobians, 0.0)
    dots = np.abs((J[..., 0] * J[..., 1]).sum(-1))
    between: Array = np.arctan2(np.abs(np.linalg.det(J)), dots)
    return between


def _refine_in_windows(image: Image, start: Array, half: int) -> tuple[Array, BoolArray]:
    """Refine corners (K, 2) with windows of one size; failed ones have arbitrary values."""
    corners, found = _refine_by_opencv(image, start, half), np.zeros(len(start), bool)
    low, high = np.maximum(start - half, half + 1), np.minimum(start + half, np.array(image.shape[::-1]) - half - 3)
    # Of the corners that go on only, compacted when some of them end: most iterations end none.
    active, at = np.arange(len(start)), corners.copy()
    cells, moments = np.full((len(start), 2), -1), np.zeros((len(start), 5, 16))
    for _ in range(MAX_ITERATIONS):
        kept = (at >= low) & (at < high)
        if not kept.all():
            kept = kept.all(axis=-1)
            active, at, low, high, cells, moments = (each[kept] for each in (active, at, low, high, cells, moments))
        whole = np.floor(at).astype(int)
        if (whole != cells).any():
            elsewhere = (whole != cells).any(axis=-1)
            moments[elsewhere] = _moments_of_windows(image, whole[elsewhere], half).reshape(-1, 5, 16)
            cells = whole
        ends = np.empty((len(at), 2, 2))  # weights of the pixels before and behind, along x and y
        ends[:, 1] = at - whole
        ends[:, 0] = 1 - ends[:, 1]
        share = (ends[:, :, 1, None] * ends[:, None, :, 0]).reshape(-1, 4)
        products = (share[:, :, None] * share[:, None]).reshape(-1, 16, 1)
        a, b, c, u, v = (moments @ products)[..., 0].T
        det = a * c - b * b
        regular = det > MIN_MOMENTS_RATIO * (a + c) ** 2
        step = np.empty_like(at)
        step[:, 0], step[:, 1] = c * u - b * v, a * v - b * u
        step /= np.where(regular, det, 1.0)[:, None]
        at = at + step
        ended = (np.abs(step) < CONVERGED_STEP_PX).all(axis=-1)
        going_on = regular & ~ended
        if not going_on.all():
            ended &= regular
            corners[active[ended]], found[active[ended]] = at[ended], True
            active, at, low, high, cells, moments = (each[going_on] for each in (active, at, low, high, cells, moments))
            if not len(active):
                break
    return corners, found


def _moments_of_windows(image: Image, whole: IntArray, half: int) -> Array:
    """Sums over windows whose middles lie in pixels (K, 2), to the right of and below their centres: (K, 5, 4, 4).

    A gradient between pixels is a mean of those at the four around, with weights s (4,) that the window's place in the
    pixel gives. So sums of products of gradients are quadratic forms ``s^T M s``: M of ``w gx gx``, ``w gx gy``, ``w gy
    gy``, ``w gx (gx x + gy y)`` and ``w gy (gx x + gy y)``, with x and y from the window's middle and its weights w.
    """
    ticks = np.arange(-half, half + 1)
    fall = np.exp(-((ticks / half) ** 2))
    w = (fall[:, None] * fall).ravel()
    wx, wy = w * np.tile(ticks, len(ticks)), w * np.repeat(ticks, len(ticks))
    patch = np.arange(-half - 1, half + 3)  # one more on each side for the gradients, and one to interpolate
    seen = image[(whole[:, 1, None] + patch)[:, :, None], (whole[:, 0, None] + patch)[:, None]].astype(float)
    gradients = (seen[:, 1:-1, 2:] - seen[:, 1:-1, :-2], seen[:, 2:, 1:-1] - seen[:, :-2, 1:-1])
    ends = ((0, -1), (1, None))
    gx, gy = (
        np.stack([g[:, top:bottom, left:right] for top, bottom in ends for left, right in ends], 1).reshape(
            len(whole), 4, w.size
        )
        for g in gradients
    )
    both = np.concatenate([gx, gy], 1).swapaxes(1, 2)
    of_x, of_y = np.concatenate([gx * w, gx * wx, gx * wy], 1) @ both, np.concatenate([gy * w, gy * wy], 1) @ both
    xx, xy, yy = of_x[:, :4, :4], of_x[:, :4, 4:], of_y[:, :4, 4:]
    u = of_x[:, 4:8, :4] + of_x[:, 8:, 4:]
    v = of_x[:, 4:8, 4:] + of_y[:, 4:, 4:]
    return np.stack([xx, xy, yy, u, v], 1)


def _refine_by_opencv(image: Image, start: Array, half: int) -> Array:
    """Refine corners (K, 2) approximately by OpenCV, as an initial guess."""
    inside = ((start >= 0) & (start <= np.array(image.shape[::-1]) - 1)).all(axis=-1)
    corners = start.copy()
    if inside.any():
        quick = start[inside].astype(np.float32).reshape(-1, 1, 2)
        corners[inside] = cv2.cornerSubPix(image, quick, (half, half), (-1, -1), QUICK_STOP).reshape(-1, 2)
    return corners


class PrintedPatches:
    """Print around the corners of a board, to be recognised in images."""

    def __init__(self, drawing: Image, texels: int, corners: Array) -> None:
        """Cut the patches from the board's drawing; `texels` is the side of a square, corners (K, 2) are in squares."""
        step = 2 * PATCH_HALF_SIDE / PATCH_SAMPLES
        ticks = step * (np.arange(PATCH_SAMPLES) - (PATCH_SAMPLES - 1) / 2)
        self._offsets = np.stack(np.meshgrid(ticks, ticks), -1).reshape(-1, 2)
        side = max(1, round(texels * step))
        at = (corners[:, None] + self._offsets) * texels - 0.5
        self._printed = _sample_image(np.asarray(cv2.blur(drawing, (side, side)), np.uint8), at)

    def likeness(self, image: Image, pixels: Array, jacobians: Array) -> Array:
        """Return the correlation of the image around each corner with the print, (K,).

        Normalised: 1 if equal up to brightness and contrast; of a patch that the
        image's edge cuts, the part in the image is compared.

        Args:
            image: (H, W), grey.
            pixels: (K, 2), every corner of the board.
            jacobians: (K, 2, 2), pixels per square there.
        """
        height, width = image.shape
        at = pixels[:, None] + self._offsets @ np.swapaxes(jacobians, 1, 2)
        inside = _is_inside(at, width, height)
        at = np.where(inside[..., None], at, 0.0)
        a, b = (_normalise_patches(patch, inside) for patch in (_sample_image(image, at), self._printed))
        likeness: Array = (a * b).sum(-1)
        return likeness


def _sample_image(image: Image, at: Array) -> Array:
    x, y = np.moveaxis(at, -1, 0).astype(np.float32)
    return cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(float)


def _normalise_patches(patches: Array, inside: BoolArray) -> Array:
    """Normalise patches (K, P) to mean 0 and norm 1 over the mask; 0 without contrast."""
    mean = (patches * inside).sum(-1, keepdims=True) / np.maximum(inside.sum(-1, keepdims=True), 1)
    contrast = (patches - mean) * inside
    normalised: Array = contrast / np.maximum(np.linalg.norm(contrast, axis=-1, keepdims=True), 1e-9)
    return normalised


def _is_inside(at: Array, width: int, height: int) -> BoolArray:
    """Return a mask of the pixels (..., 2) inside the image."""
    x, y = at[..., 0], at[..., 1]
    return (x > -0.5) & (x < width - 0.5) & (y > -0.5) & (y < height - 0.5)
