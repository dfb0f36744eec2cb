"""OpenCV 4's hand-eye and robot-world solvers; OpenCV 5 lacks them, and OpenCV is optional."""

from typing import Any

import numpy as np

from calibration.base.arrays import Array
from calibration.base.errors import InfrastructureError, UndeterminedError
from calibration.base.optional import optional
from calibration.engine.geometry.transforms import inverse, transform

HAND_EYE, ROBOT_WORLD = "calibrateHandEye", "calibrateRobotWorldHandEye"


def opencv_with(function: str) -> Any:
    """Import cv2 on demand; None if it is not installed or lacks the function."""
    try:
        cv2 = optional("cv2", function)
    except InfrastructureError:
        return None
    return cv2 if hasattr(cv2, function) else None


def solve_hand_eye(cv2: Any, method: str, arm: Array, seen: Array) -> Array:
    """Solve ``arm = X @ seen @ Y`` for X (4, 4) by `calibrateHandEye`.

    Args:
        cv2: the module.
        method: "tsai", "park", ...
        arm: (n, 4, 4), which OpenCV takes as the base seen from the gripper.
        seen: (n, 4, 4), the target seen from the camera.

    Raises:
        UndeterminedError: OpenCV finds no solution.
    """
    X = transform(*_ask_opencv(cv2, HAND_EYE, f"CALIB_HAND_EYE_{method.upper()}", inverse(arm), seen))
    if np.array_equal(X, np.eye(4)):  # OpenCV's result if it rejects all motions as too small
        raise UndeterminedError(f"OpenCV's {HAND_EYE}: {method.capitalize()} needs larger rotations")
    return X


def solve_robot_world(cv2: Any, method: str, arm: Array, seen: Array) -> tuple[Array, Array]:
    """Solve ``arm = X @ seen @ Y`` for X and Y (4, 4) by `calibrateRobotWorldHandEye`; see `solve_hand_eye`.

    OpenCV solves ``A X' = Z' B``: A is ``arm``, B is ``seen``, Z' our X, X' the inverse of our Y.
    """
    R, t, R_X, t_X = _ask_opencv(cv2, ROBOT_WORLD, f"CALIB_ROBOT_WORLD_HAND_EYE_{method.upper()}", arm, seen)
    return transform(R_X, t_X), inverse(transform(R, t))


def _ask_opencv(cv2: Any, function: str, method: str, first: Array, second: Array) -> list[Array]:
    """Call OpenCV, and return each translation as (3,)."""
    poses = [list(part) for T in (first, second) for part in (T[:, :3, :3], T[:, :3, 3])]
    log = cv2.utils.logging  # silences OpenCV's log: the failure is reported by our own error
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
