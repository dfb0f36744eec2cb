"""Hand-eye calibration of cameras on or beside an arm: its data from a dataset, and its results as a dataset.

A camera may be mounted on the arm and observe fixed patterns (eye in hand), or be fixed and observe
patterns on the arm (eye to hand): with named frames both are the same equation.
Each view contributes the pose estimated from it alone; there is no refinement of reprojection errors.

These methods support one pattern. With several, each camera uses the fixed one that it sees most often, among those
with enough rotation of the arm; the other fixed ones follow as the mean over their views.

The methods are OpenCV's if available (OpenCV 5 lacks them), else our own. Shah and Li solve for camera and pattern
jointly. The other five solve for the camera's transform only, from the motions between views; the pattern's transform
follows as the mean over the views.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.base import InfrastructureError, InputError, UndeterminedError
from calibration.base.arrays import Array
from calibration.base.optional import optional
from calibration.engine.comparison import hand_eye_solvers
from calibration.engine.comparison.hand_eye_solvers import relative_motions
from calibration.engine.dataset.model import Dataset, Edge, Sensor
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.estimation.start import robot_world
from calibration.engine.estimation.start.linear_start import SINGLE_AXIS
from calibration.engine.estimation.start.robot_world import solve_robot_world
from calibration.engine.evaluation.views import corner_views, measured_views
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import distance, inverse, transform

Solver = Callable[[Array, Array], tuple[Array, Array]]
"""Function from the poses of arm and camera (n, 4, 4) to X and Y (4, 4) in ``arm = X @ seen @ Y``."""

MINIMUM_VIEWS = 3
"""Minimum of relative motions with rotations about two axes."""


@dataclass(frozen=True, eq=False)
class ArmViews:
    """A camera's n views of a pattern: ``arm = X @ seen @ Y``.

    X is the camera's calibrated transform, Y the inverse of the pattern's. The arm's poses, which are exact, are on
    the left, as ATOM passes them to OpenCV.
    """

    sensor: Sensor
    pattern: Pattern
    arm: Array
    """(n, 4, 4): from the pattern's parent to the camera's parent."""
    seen: Array
    """(n, 4, 4): from the pattern to the camera's calibrated child."""

    @property
    def axes(self) -> int:
        """Number of independent rotation axes of the arm; 2 are enough."""
        return solve_robot_world(self.arm, self.seen).spectrum.axes(SINGLE_AXIS)


def why_not_arm(dataset: Dataset) -> str | None:
    """Return the reason why hand-eye methods do not apply to a dataset, in one line; None if they do."""
    others = [s for s in dataset.sensors.values() if not (s.modality.has_corners or s.modality.has_poses)]
    if others:
        return f"it needs cameras only, and '{others[0].name}' is {others[0].modality}"
    if dataset.additional_transforms:
        return f"it cannot calibrate additional transforms, such as '{'-'.join(dataset.additional_transforms[0])}'"
    for sensor in dataset.sensors.values():
        reasons = [_why_not_pattern(dataset, sensor, pattern) for pattern in dataset.patterns.values()]
        if all(reasons):
            return reasons[0]
    return None


def _why_not_pattern(dataset: Dataset, sensor: Sensor, pattern: Pattern) -> str | None:
    """Return the reason why there is no arm between a camera and a pattern; None if there is one."""
    if not pattern.fixed:
        return f"it needs a pattern fixed to the world or to an arm, and '{pattern.name}' moves freely"
    path = dataset.tree.path(sensor.calibration_parent, pattern.parent_link)
    if sensor.edge in ((step.parent, step.child) for step in path):
        return f"it needs an arm between camera and pattern, and '{pattern.name}' is carried by '{sensor.name}'"
    if not _does_move(dataset.transform(sensor.calibration_parent, pattern.parent_link)):
        return f"it needs an arm, and nothing moves between '{sensor.calibration_parent}' and '{pattern.parent_link}'"
    return None


def _does_move(T: Array) -> bool:
    return len(T) < 2 or any(float(values.max()) > 1e-6 for values in distance(T[:1], T))


def calibrate_arm(dataset: Dataset, solve: Solver) -> Dataset:
    """Calibrate cameras and fixed patterns by a solver and return the new dataset; moving patterns are unchanged.

    Raises:
        InputError: the method does not apply (`why_not_arm`).
        UndeterminedError: too few views, rotations about fewer than two axes, or the solver fails.
    """
    transforms: dict[Edge, Array] = {}
    for used in used_views(dataset):
        X, Y = solve(used.arm, used.seen)
        transforms[used.sensor.edge] = X
        transforms.setdefault(used.pattern.edge, inverse(Y))
    for sensor in dataset.sensors.values():
        for views in _all_views(dataset, sensor):
            if len(views.arm) and views.pattern.edge not in transforms:
                Y = inverse_pattern(transforms[sensor.edge], views.arm, views.seen)
                transforms[views.pattern.edge] = inverse(Y)
    return dataset.with_transforms(transforms)


def inverse_pattern(X: Array, arm: Array, seen: Array) -> Array:
    """Solve ``arm = X @ seen @ Y`` for Y with a known X: the mean over the views."""
    Y = inverse(X @ seen) @ arm
    return transform(rotations.nearest(Y[:, :3, :3].mean(0)), Y[:, :3, 3].mean(0))


def used_views(dataset: Dataset) -> list[ArmViews]:
    """Return the pattern that each camera is calibrated with; errors as `calibrate_arm`."""
    reason = why_not_arm(dataset)
    if reason:
        raise InputError(f"{dataset.path}: the method does not apply: {reason}")
    return [_most_views(dataset, sensor) for sensor in dataset.sensors.values()]


def _most_views(dataset: Dataset, sensor: Sensor) -> ArmViews:
    """Return a camera's views of its most frequent pattern, among those that determine its transform."""
    found = sorted(_all_views(dataset, sensor), key=lambda views: -len(views.arm))
    for views in found:
        if len(views.arm) >= MINIMUM_VIEWS and views.axes >= 2:
            return views
    raise UndeterminedError(f"{dataset.path}: {_too_little(found[0])}")


def _too_little(views: ArmViews) -> str:
    sensor, pattern, count = views.sensor, views.pattern, len(views.arm)
    if count < MINIMUM_VIEWS:
        return f"'{sensor.name}' has {count} views of '{pattern.name}'; at least {MINIMUM_VIEWS} are needed"
    motion = ("does not turn", "turns about one axis only")[views.axes]
    return (
        f"between '{sensor.calibration_parent}' and '{pattern.parent_link}' the arm {motion}; "
        f"rotations about two axes are needed"
    )


def _all_views(dataset: Dataset, sensor: Sensor) -> list[ArmViews]:
    """Return the views of each pattern on the other side of the arm."""
    patterns = [p for p in dataset.patterns.values() if _why_not_pattern(dataset, sensor, p) is None]
    return [_arm_views(dataset, sensor, pattern) for pattern in patterns]


def _arm_views(dataset: Dataset, sensor: Sensor, pattern: Pattern) -> ArmViews:
    views = (measured_views if sensor.modality.has_poses else corner_views)(dataset, sensor.name, pattern)
    seen_in = dataset.with_collections(views.collections.tolist())
    arm = seen_in.transform(sensor.calibration_parent, pattern.parent_link)
    seen = seen_in.transform(sensor.calibration_child, sensor.frame) @ views.T_camera_pattern
    return ArmViews(sensor, pattern, arm, seen)


HAND_EYE_FUNCTION, ROBOT_WORLD_FUNCTION = "calibrateHandEye", "calibrateRobotWorldHandEye"


def opencv_with(function: str) -> Any:
    """Import cv2 on demand; None if it is not installed or lacks the function."""
    try:
        cv2 = optional("cv2", function)
    except InfrastructureError:
        return None
    return cv2 if hasattr(cv2, function) else None


def opencv_hand_eye(cv2: Any, method: str, arm: Array, seen: Array) -> Array:
    """Solve ``arm = X @ seen @ Y`` for X (4, 4) by `calibrateHandEye`.

    Args:
        cv2: the module.
        method: "tsai", "park", ...
        arm: (n, 4, 4), which OpenCV takes as the base seen from the gripper.
        seen: (n, 4, 4), the target seen from the camera.

    Raises:
        UndeterminedError: OpenCV finds no solution.
    """
    X = transform(*_ask_opencv(cv2, HAND_EYE_FUNCTION, f"CALIB_HAND_EYE_{method.upper()}", inverse(arm), seen))
    if np.array_equal(X, np.eye(4)):  # OpenCV's result if it rejects all motions as too small
        raise UndeterminedError(f"OpenCV's {HAND_EYE_FUNCTION}: {method.capitalize()} needs larger rotations")
    return X


def opencv_robot_world(cv2: Any, method: str, arm: Array, seen: Array) -> tuple[Array, Array]:
    """Solve ``arm = X @ seen @ Y`` for X and Y (4, 4) by `calibrateRobotWorldHandEye`; see `opencv_hand_eye`.

    OpenCV solves ``A X' = Z' B``: A is ``arm``, B is ``seen``, Z' our X, X' the inverse of our Y.
    """
    R, t, R_X, t_X = _ask_opencv(cv2, ROBOT_WORLD_FUNCTION, f"CALIB_ROBOT_WORLD_HAND_EYE_{method.upper()}", arm, seen)
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


ROBOT_WORLD: Mapping[str, Callable[[Array, Array], robot_world.RobotWorld]] = {
    "shah": robot_world.solve_robot_world,
    "li": robot_world.solve_li,
}
"""Own implementation: from A and B (n, 4, 4) in ``A_i = X @ B_i @ Y``."""
HAND_EYE: Mapping[str, Callable[[Array, Array], Array]] = {
    "tsai": hand_eye_solvers.solve_tsai,
    "park": hand_eye_solvers.solve_park,
    "horaud": hand_eye_solvers.solve_horaud,
    "andreff": hand_eye_solvers.solve_andreff,
    "daniilidis": hand_eye_solvers.solve_daniilidis,
}
"""Own implementation: from relative motions."""


def by_arm(method: str, dataset: Dataset) -> Dataset:
    """Calibrate cameras and patterns by one of the methods and return the new dataset; errors as `calibrate_arm`."""
    return calibrate_arm(dataset, _solver_of_method(method))


def described(method: str, dataset: Dataset) -> str:
    """Return the implementation used, and with several patterns the one that each camera is calibrated with."""
    cv2 = opencv_with(_opencv_function(method))
    whose = f"OpenCV {cv2.__version__}" if cv2 else "built in"
    if len(dataset.patterns) == 1:
        return whose
    chosen = (f"'{v.sensor.name}' by '{v.pattern.name}' ({len(v.arm)} views)" for v in used_views(dataset))
    return f"{whose}; {', '.join(chosen)}"


def _opencv_function(method: str) -> str:
    return ROBOT_WORLD_FUNCTION if method in ROBOT_WORLD else HAND_EYE_FUNCTION


def _solver_of_method(method: str) -> Solver:
    cv2 = opencv_with(_opencv_function(method))

    def together(arm: Array, seen: Array) -> tuple[Array, Array]:
        if cv2:
            return opencv_robot_world(cv2, method, arm, seen)
        solution = ROBOT_WORLD[method](arm, seen)
        return solution.X, solution.Y

    def camera_first(arm: Array, seen: Array) -> tuple[Array, Array]:
        X = opencv_hand_eye(cv2, method, arm, seen) if cv2 else HAND_EYE[method](*relative_motions(arm, seen))
        return X, inverse_pattern(X, arm, seen)

    return together if method in ROBOT_WORLD else camera_first
