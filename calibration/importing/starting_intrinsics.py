"""Initial guess of unknown intrinsics by OpenCV, from the corners of all views of one camera."""

from collections.abc import Sequence

import cv2
import numpy as np

from calibration.dataset.configuration import PatternConfiguration
from calibration.dataset.model import CornerLabels
from calibration.errors import InputError, UndeterminedError
from calibration.geometry.cameras import Camera
from calibration.geometry.distortion import PlumbBob

LEAST_VIEWS = 5
"""Minimum of views: fewer views of a plane do not determine the intrinsics."""
MOST_VIEWS = 60
"""Limit of views: more do not improve the initial guess."""
DECIMALS = 6
WORST_RMS = 5.0
"""px: an initial guess with a larger RMS is refused."""


def starting_intrinsics(
    sensor: str, size: tuple[int, int], views: Sequence[tuple[PatternConfiguration, CornerLabels]]
) -> Camera:
    """Fit intrinsics to the corners: focal lengths, principal point, two radial coefficients.

    Args:
        sensor: the camera, for messages.
        size: of its images, width and height.
        views: corners of which pattern, by view.

    Raises:
        UndeterminedError: there are too few views.
        InputError: no intrinsics fit them.
    """
    if len(views) < LEAST_VIEWS:
        raise UndeterminedError(
            f"'{sensor}' has no intrinsics, and {len(views)} images with a pattern to calibrate them from; expected "
            f"{LEAST_VIEWS} or more, or a file: intrinsics"
        )
    some = views[:: -(-len(views) // MOST_VIEWS)]
    corners = [pattern.pattern().corners[labels.ids].astype(np.float32) for pattern, labels in some]
    pixels = [labels.pixels.astype(np.float32) for _, labels in some]
    flags = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3
    try:
        rms, K, D, _, _ = cv2.calibrateCamera(corners, pixels, size, None, None, flags=flags)
    except cv2.error as error:
        raise InputError(f"'{sensor}': the corners give no intrinsics: {error.err}") from None
    K, D = np.asarray(K, float), np.asarray(D, float).ravel()
    good = np.isfinite([rms, *K.ravel(), *D]).all() and rms < WORST_RMS and min(K[0, 0], K[1, 1]) > 0
    if not good:
        raise InputError(
            f"'{sensor}': no lens explains its corners (the best leaves {rms:.3g} px): are the patterns as described?"
        )
    fx, fy, cx, cy, k1, k2 = (round(float(v), DECIMALS) for v in (K[0, 0], K[1, 1], K[0, 2], K[1, 2], D[0], D[1]))
    return Camera(fx, fy, cx, cy, *size, PlumbBob(k1, k2))
