"""Methods of Shah, Li, Tsai, Park, Horaud, Andreff and Daniilidis: OpenCV's if available, else our own.

Shah and Li solve for camera and pattern jointly. The other five solve for the camera's transform only, from the
motions between views; the pattern's transform follows as the mean over the views.
"""

from collections.abc import Callable, Mapping

from calibration.base.arrays import Array
from calibration.engine.comparison import hand_eye_solvers, opencv_arm
from calibration.engine.comparison.arm import Solver, calibrate_arm, inverse_pattern, used_views
from calibration.engine.comparison.hand_eye_solvers import relative_motions
from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.start import robot_world

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
    cv2 = opencv_arm.opencv_with(_opencv_function(method))
    whose = f"OpenCV {cv2.__version__}" if cv2 else "built in"
    if len(dataset.patterns) == 1:
        return whose
    chosen = (f"'{v.sensor.name}' by '{v.pattern.name}' ({len(v.arm)} views)" for v in used_views(dataset))
    return f"{whose}; {', '.join(chosen)}"


def _opencv_function(method: str) -> str:
    return opencv_arm.ROBOT_WORLD if method in ROBOT_WORLD else opencv_arm.HAND_EYE


def _solver_of_method(method: str) -> Solver:
    cv2 = opencv_arm.opencv_with(_opencv_function(method))

    def together(arm: Array, seen: Array) -> tuple[Array, Array]:
        if cv2:
            return opencv_arm.solve_robot_world(cv2, method, arm, seen)
        solution = ROBOT_WORLD[method](arm, seen)
        return solution.X, solution.Y

    def camera_first(arm: Array, seen: Array) -> tuple[Array, Array]:
        X = opencv_arm.solve_hand_eye(cv2, method, arm, seen) if cv2 else HAND_EYE[method](*relative_motions(arm, seen))
        return X, inverse_pattern(X, arm, seen)

    return together if method in ROBOT_WORLD else camera_first
