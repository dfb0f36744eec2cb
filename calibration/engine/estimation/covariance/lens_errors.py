"""Errors of a held camera's intrinsics: as given with them, else as of a nominal calibration, as `assume` scales it.

The nominal calibration: a flat board, printed on a sheet of A3, fills a third of the image in 25 views, all over it,
turned, and tilted by up to 40 degrees. With the columns A of the intrinsics, the poses of the views eliminated, and B
of the board's bow and twist, all in standard deviations of the corners, the intrinsics of such a calibration err by::

    C = (A^T A)^-1 + W F W^T,    W = -(A^T A)^-1 A^T B

F is the variance of a board's flatness: it is the same in all views, so no number of views averages it out. The errors
of focal length, principal point and coefficients nearly cancel in the image, which is why they are one block. The
first term is what OpenCV's ``stdDeviationsIntrinsics`` are the roots of.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.model import LensUncertainty
from calibration.engine.dataset.pattern import Pattern, grid, rectangle
from calibration.engine.estimation.least_squares.label_columns import POSE_COLUMNS, ColumnNames, products
from calibration.engine.estimation.least_squares.normal_equations import Weighting
from calibration.engine.estimation.options import ALL_EXACT, OF_INTRINSICS, Assumptions
from calibration.engine.estimation.problem.blocks import PARAMETERS_IN_PIXELS, Prior
from calibration.engine.estimation.residuals.corner_residuals import CornerTerm
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import apply, transform

NUMBER_OF_VIEWS = 25
COLUMNS_OF_BOARD, ROWS_OF_BOARD, SIDE_OF_SQUARE = 9, 6, 0.04
"""Corners of the board, and the side of its squares, m."""
SHARE_OF_IMAGE = 1 / 3
"""Part of the image that it fills on average, facing the camera."""
RANGE_OF_CENTRES = 0.5
"""Places of its centre, from one end to the other, as a part of the image."""
MAX_TILT = np.radians(40.0)
"""Largest tilt against facing the camera, rad."""
SIGMA_OF_CORNERS = 0.125
"""Standard deviation of its corners, px."""
SIGMA_OF_BOW = 0.0001
"""Standard deviation of its bow, about each axis, and of its twist, m."""
MIN_RELATIVE_INFORMATION = 1e-10
"""Information on each parameter, in proportion to what is known of it alone, so that degenerate ones stay finite."""


@dataclass(frozen=True, eq=False)
class NominalLens:
    """Errors of a camera's intrinsics, as independent ones of standard deviation 1 and what each does, (n, k)."""

    parameters: tuple[str, ...]
    """n of `Camera.parameters`."""
    by_noise: Array
    """(n, n): by the noise of the corners."""
    by_flatness: Array
    """(n, 3): by a board that is not flat."""


@lru_cache(256)
def nominal_lens(camera: Camera) -> NominalLens:
    """Return how well the intrinsics of a camera are known from a nominal calibration."""
    coefficients = zip(camera.parameters, camera.intrinsics, strict=True)
    # others only where camera_info has them (they are not 0)
    always = (*PARAMETERS_IN_PIXELS, *camera.distortion.always)
    parameters = tuple(name for name, value in coefficients if name in always or value)
    columns, n = ColumnNames(camera), len(parameters)
    names = (*columns.of_sensor, *columns.of_pattern)
    M = _information_of_columns(
        camera, [POSE_COLUMNS + names.index(name) for name in (*parameters, "bow_x", "bow_y", "twist")]
    )
    scale = 1 / np.sqrt(np.maximum(np.diagonal(M)[:n], 1e-300))
    # a root of the information
    R = np.linalg.cholesky(scale[:, None] * M[:n, :n] * scale + MIN_RELATIVE_INFORMATION * np.eye(n))
    by_noise = scale[:, None] * np.linalg.inv(R).T
    return NominalLens(parameters, by_noise, by_noise @ (by_noise.T @ M[:n, n:]) * -SIGMA_OF_BOW)


def _information_of_columns(camera: Camera, columns: list[int]) -> Array:
    """Return the sums of products of some columns of `products` over all views, their poses eliminated."""
    pattern, T = board(), views(camera)
    corners = pattern.corners - pattern.centre
    pixels, visible = camera.project_visible(apply(T, corners))
    seen = visible & camera.contains(pixels)
    T, pixels, seen = (each[np.count_nonzero(seen, axis=1) > POSE_COLUMNS] for each in (T, pixels, seen))
    term = CornerTerm(camera, corners, np.swapaxes(np.where(seen[..., None], pixels, 0.0), 1, 2), seen)
    M = np.concatenate(
        [part for _, part in products([term], camera, pattern, T, Weighting({"pixel": SIGMA_OF_CORNERS}, None))]
    )
    mixed = M[:, :POSE_COLUMNS, columns]
    eliminated = np.swapaxes(mixed, 1, 2) @ np.linalg.solve(M[:, :POSE_COLUMNS, :POSE_COLUMNS], mixed)
    return np.asarray((M[:, columns][:, :, columns] - eliminated).sum(0))


def board() -> Pattern:
    """Return the board of the nominal calibration."""
    corners = grid(COLUMNS_OF_BOARD, ROWS_OF_BOARD, SIDE_OF_SQUARE, (0.0, 0.0))
    x, y = SIDE_OF_SQUARE * np.array([[-1.0, COLUMNS_OF_BOARD], [-1.0, ROWS_OF_BOARD]])
    return Pattern("board", "chessboard", "board", "camera", False, corners, rectangle(x[0], y[0], x[1], y[1]))


def views(camera: Camera) -> Array:
    """Return ``T_camera_pattern`` (v, 4, 4), the pattern's frame at the centre of its corners.

    The fractional parts of k^2 times an irrational number are as uneven as random ones, and the same everywhere.
    """
    k = np.arange(30, 30 + NUMBER_OF_VIEWS)
    across, down, far, tilt, direction, turn = (k * k * np.sqrt([[2], [3], [5], [7], [11], [13]])) % 1
    u = (camera.width - 1) / 2 + RANGE_OF_CENTRES * camera.width * (across - 0.5)
    v = (camera.height - 1) / 2 + RANGE_OF_CENTRES * camera.height * (down - 0.5)
    rays = camera.rays(np.stack([u, v], -1))
    usable = np.isfinite(rays).all(-1)
    length = (COLUMNS_OF_BOARD + 1) * SIDE_OF_SQUARE
    pixels = np.sqrt(SHARE_OF_IMAGE * camera.width * camera.height * (COLUMNS_OF_BOARD + 1) / (ROWS_OF_BOARD + 1))
    distance = length * np.sqrt(camera.fx * camera.fy) / pixels * (0.8 + 0.4 * far)
    axes = np.stack([np.cos(2 * np.pi * direction), np.sin(2 * np.pi * direction), np.zeros(NUMBER_OF_VIEWS)], -1)
    tilted = rotations.exp(MAX_TILT * tilt[:, None] * axes)
    turned = rotations.exp(2 * np.pi * turn[:, None] * np.array([0.0, 0.0, 1.0]))
    unit = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    return transform((rotations.towards(unit) @ tilted @ turned)[usable], (unit * distance[:, None])[usable])


LensSource = Literal["nominal", "assume", "covariance", "standard-deviations"]


@dataclass(frozen=True, eq=False)
class LensErrors:
    """Independent errors of standard deviation 1, and what each does to the intrinsics."""

    parameters: tuple[str, ...]
    """n of `Camera.parameters`."""
    root: Array
    """(n, k): ``root root^T`` is the covariance of the parameters."""
    source: LensSource
    is_exact: bool = False
    """Whether all of them are exactly known; the root is then of a nominal calibration."""


def lens_errors(camera: Camera, assume: Assumptions, given: Prior | LensUncertainty | None) -> LensErrors:
    """Return the errors of a camera's intrinsics.

    Args:
        camera: the camera.
        assume: what the user states of it: with 0 a parameter is exactly known, and the others are as well known as
            that makes them; a standard deviation above 0 scales all errors, by the largest ratio of one that is stated
            to the nominal one.
        given: what its own calibration says, and counts instead: the covariance that the user has given, or what
            the dataset has, unless all is assumed to be exact. Standard deviations alone are taken as those of the
            nominal calibration's corners, all in one ratio; its board stays as it is.
    """
    if isinstance(given, Prior):
        return _of_covariance(tuple(camera.parameters[i] for i in given.at), given.covariance)
    nominal = nominal_lens(camera)
    if given is not None and assume != ALL_EXACT:
        if given.covariance is not None:
            return _of_covariance(given.parameters, given.covariance)
        common = [name for name in nominal.parameters if name in given.parameters]
        stated = given.sigmas[[given.parameters.index(name) for name in common]]
        usual = np.linalg.norm(nominal.by_noise[[nominal.parameters.index(name) for name in common]], axis=1)
        ratio = float(np.exp(np.log(stated / usual).mean())) if common else 1.0
        root = np.concatenate([ratio * nominal.by_noise, nominal.by_flatness], 1)
        return LensErrors(nominal.parameters, root, "standard-deviations")
    root = np.concatenate([nominal.by_noise, nominal.by_flatness], 1)
    assumed = {name: value for name in OF_INTRINSICS if (value := getattr(assume, name)) is not None}
    source: LensSource = "assume" if assumed else "nominal"
    if len(assumed) == len(OF_INTRINSICS) and not any(assumed.values()):
        return LensErrors(nominal.parameters, root, source, is_exact=True)
    combinations = _combinations_of_assumptions(camera, nominal.parameters)
    known = [combinations[name] @ root for name, value in assumed.items() if not value]
    if known:  # what is left of independent errors if these combinations of them are 0
        Q, _ = np.linalg.qr(np.concatenate(known).T)
        root = root - root @ Q @ Q.T
    scales = [_ratio_of_sigmas(value, combinations[name] @ root) for name, value in assumed.items() if value]
    return LensErrors(nominal.parameters, max(scales, default=1.0) * root, source)


def _of_covariance(parameters: tuple[str, ...], covariance: Array) -> LensErrors:
    s = np.sqrt(np.diagonal(covariance))
    root = s[:, None] * np.linalg.cholesky(covariance / s[:, None] / s)
    return LensErrors(parameters, root, "covariance")


def _ratio_of_sigmas(stated: float, effects: Array) -> float:
    """Return a stated standard deviation over the first of those that errors (m, k) have."""
    return float(stated / np.linalg.norm(effects[0]))


def _combinations_of_assumptions(camera: Camera, parameters: tuple[str, ...]) -> dict[str, Array]:
    """Return what each assumption is about, as combinations (m, n) of the parameters."""
    unit = dict(zip(parameters, np.eye(len(parameters)), strict=True))
    fx, fy = unit["fx"] / camera.fx, unit["fy"] / camera.fy
    return {
        "focal_length": ((fx + fy) / 2)[None],
        "aspect": (fx - fy)[None],
        "principal_point": np.stack([unit["cx"], unit["cy"]]),
        "distortion": np.stack([unit[name] for name in parameters if name not in PARAMETERS_IN_PIXELS]),
    }
