"""OpenCV 4's hand-eye and robot-world solutions; OpenCV 5 has none, and it need not be installed."""

from typing import Any

import numpy as np

from calibration.errors import UndeterminedError
from calibration.geometry.transforms import inverse, transform
from calibration.geometry.types import Array

HAND_EYE, ROBOT_WORLD = "calibrateHandEye", "calibrateRobotWorldHandEye"


def opencv_with(function: str) -> Any:
    """The module cv2, imported when it is needed; None where it is not installed or has no such function."""
    try:
        import cv2
    except ImportError:
        return None
    return cv2 if hasattr(cv2, function) else None


def solve_hand_eye(cv2: Any, method: str, arm: Array, seen: Array) -> Array:
    """X (4, 4) in ``arm = X @ seen @ Y`` by `calibrateHandEye`.

    Args:
        cv2: the module.
        method: "tsai", "park", ...
        arm: (n, 4, 4), which OpenCV takes as the base seen from the gripper.
        seen: (n, 4, 4), the target seen from the camera.

    Raises:
        UndeterminedError: OpenCV finds none.
    """
    X = transform(*_asked(cv2, HAND_EYE, f"CALIB_HAND_EYE_{method.upper()}", inverse(arm), seen))
    if np.array_equal(X, np.eye(4)):  # what it leaves when it has found the motions too small
        raise UndeterminedError(f"OpenCV's {HAND_EYE}: {method.capitalize()} needs larger rotations")
    return X


def solve_robot_world(cv2: Any, method: str, arm: Array, seen: Array) -> tuple[Array, Array]:
    """X and Y (4, 4) in ``arm = X @ seen @ Y`` by `calibrateRobotWorldHandEye`; arguments, errors as `solve_hand_eye`.

    OpenCV solves ``A X' = Z' B``: A is ``arm``, B is ``seen``, Z' our X, X' the inverse of our Y.
    """
    R, t, R_X, t_X = _asked(cv2, ROBOT_WORLD, f"CALIB_ROBOT_WORLD_HAND_EYE_{method.upper()}", arm, seen)
    return transform(R_X, t_X), inverse(transform(R, t))


def _asked(cv2: Any, function: str, method: str, first: Array, second: Array) -> list[Array]:
    """OpenCV's answer, each translation as (3,)."""
    poses = [list(part) for T in (first, second) for part in (T[:, :3, :3], T[:, :3, 3])]
    log = cv2.utils.logging  # what it has to say is said by an error of ours
    level = log.setLogLevel(log.LOG_LEVEL_SILENT)
    try:
        answer = getattr(cv2, function)(*poses, method=getattr(cv2, method))
    except cv2.error as error:
        raise UndeterminedError(f"OpenCV's {function}: {' '.join(str(error).split())}") from None
    finally:
        log.setLogLevel(level)
    parts = [np.asarray(part, float).squeeze() for part in answer]
    if not all(np.isfinite(part).all() for part in parts):
        raise UndeterminedError(f"OpenCV's {function}: its answer is not finite")
    return parts
