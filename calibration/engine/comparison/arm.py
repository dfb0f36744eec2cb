"""Hand-eye calibration of cameras on or beside an arm: its data from a dataset, and its results as a dataset.

A camera may be mounted on the arm and observe fixed patterns (eye in hand), or be fixed and observe
patterns on the arm (eye to hand): with named frames both are the same equation.
Each view contributes the pose estimated from it alone; there is no refinement of reprojection errors.

These methods support one pattern. With several, each camera uses the fixed one that it sees most often, among those
with enough rotation of the arm; the other fixed ones follow as the mean over their views.

The methods are OpenCV's if available (OpenCV 5 lacks them), else our own. Shah and Li solve for camera and pattern
jointly. The other five solve the hand-eye problem ``A X = X B`` for the camera's transform only, from the relative
motions of hand and eye between views; the pattern's transform follows as the mean over the views. OpenCV 4 has the same
five in `calibrateHandEye`, with equal results (newer ones skip some motions for Tsai). Each is implemented from its
paper and takes `relative_motions`; a motion that does not determine X yields some finite transform.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.base import InfrastructureError, InputError, UndeterminedError
from calibration.base.arrays import Array
from calibration.base.optional import optional
from calibration.engine.dataset.model import Dataset, Edge, Sensor
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.estimation.start.linear_solvers import RobotWorld, solve_li, solve_robot_world
from calibration.engine.estimation.start.linear_start import SINGLE_AXIS
from calibration.engine.evaluation.views import corner_views, measured_views
from calibration.engine.geometry import rotations
from calibration.engine.geometry.rotations import hat
from calibration.engine.geometry.transforms import distance, inverse, transform

MOST_MOTIONS = 20_000
"""Limit of relative motions: all pairs of up to 200 views; with more, pairs of views close in order."""


def relative_motions(hand: Array, eye: Array) -> tuple[Array, Array]:
    """Return the relative motions between pairs of views.

    Args:
        hand: (n, 4, 4), ``T_hand_base``.
        eye: (n, 4, 4), ``T_eye_target``.

    Returns:
        A and B, (m, 4, 4) each: of the hand, ``T_hand_hand'``, and of the eye, ``T_eye_eye'``.
    """
    n = len(hand)
    i, j = np.triu_indices(n, 1)
    if len(i) > MOST_MOTIONS:
        near = j - i <= max(1, MOST_MOTIONS // n)
        i, j = i[near], j[near]
    return hand[j] @ inverse(hand[i]), eye[j] @ inverse(eye[i])


def solve_tsai(A: Array, B: Array) -> Array:
    """Solve for X (4, 4), the rotation linearly as a modified Rodrigues vector (R. Tsai and R. Lenz, 1989)."""
    a, b = _sine_vectors(A), _sine_vectors(B)
    p = np.linalg.lstsq(hat(a + b).reshape(-1, 3), (b - a).ravel(), rcond=None)[0]
    R = rotations.from_quaternion(np.append(p, 1.0))  # p = tan(angle / 2) axis
    return transform(R, _solve_translation(A, B, R))


def solve_park(A: Array, B: Array) -> Array:
    """Solve for X (4, 4) by aligning the rotation vectors of the motions (F. Park and B. Martin, 1994)."""
    a, b = (rotations.log(T[:, :3, :3]) for T in (A, B))
    R = rotations.nearest(a.T @ b)
    return transform(R, _solve_translation(A, B, R))


def solve_horaud(A: Array, B: Array) -> Array:
    """Solve for X (4, 4), the rotation as the quaternion that fits ``a x = x b`` (R. Horaud, F. Dornaika, 1995)."""
    a, b = (rotations.to_quaternion(T[:, :3, :3]) for T in (A, B))
    difference = (_from_left(a) - _from_right(b)).reshape(-1, 4)
    R = rotations.from_quaternion(np.linalg.eigh(difference.T @ difference)[1][:, 0])
    return transform(R, _solve_translation(A, B, R))


def solve_andreff(A: Array, B: Array) -> Array:
    """Solve for X (4, 4) by one linear system, projected to a rotation afterwards (N. Andreff et al., 1999)."""
    m, eye = len(A), np.eye(3)
    RA, RB, tA, tB = A[:, :3, :3], B[:, :3, :3], A[:, :3, 3], B[:, :3, 3]
    system = np.zeros((m, 12, 12))
    system[:, :9, :9] = np.eye(9) - np.einsum("nij,nkl->nikjl", RA, RB).reshape(m, 9, 9)
    system[:, 9:, :9] = np.einsum("ij,nk->nijk", eye, tB).reshape(m, 3, 9)
    system[:, 9:, 9:] = eye - RA
    right = np.concatenate([np.zeros((m, 9)), tA], -1)
    solution = np.linalg.lstsq(system.reshape(-1, 12), right.ravel(), rcond=None)[0]
    return transform(rotations.nearest(solution[:9].reshape(3, 3)), solution[9:])


def solve_daniilidis(A: Array, B: Array) -> Array:
    """Solve for X (4, 4) as a unit dual quaternion (K. Daniilidis, 1999).

    The solution is a combination of two singular vectors, fixed by two quadratic conditions:
    the real part has unit norm and is orthogonal to the dual part.
    """
    (a, a_dual), (b, b_dual) = _dual_quaternion(A), _dual_quaternion(B)
    system = np.zeros((len(A), 6, 8))
    for (row, column), (x, y) in {(0, 0): (a, b), (3, 0): (a_dual, b_dual), (3, 4): (a, b)}.items():
        system[:, row : row + 3, column] = (x - y)[:, :3]
        system[:, row : row + 3, column + 1 : column + 4] = hat((x + y)[:, :3])
    u, v = np.linalg.svd(system.reshape(-1, 8), full_matrices=False)[2][-2:].reshape(2, 2, 4)
    if abs(v[0] @ v[1]) < abs(u[0] @ u[1]):  # x = u + s v or v + s u: the quadratic that is better conditioned
        u, v = v, u
    (u1, u2), (v1, v2) = u, v
    square, linear, constant = v1 @ v2, u1 @ v2 + v1 @ u2, u1 @ u2
    root = np.sqrt(max(0.0, linear * linear - 4 * square * constant))
    candidates = [(-linear + sign * root) / (2 * square) if square else 0.0 for sign in (1, -1)]
    s = max(candidates, key=lambda s: float(((u1 + s * v1) ** 2).sum() / (1 + s * s)))
    q, q_dual = _as_xyzw(u1 + s * v1), _as_xyzw(u2 + s * v2)
    conjugate: Array = np.append(-q[:3], q[3])
    t = (_from_right(conjugate) @ q_dual)[:3] * (2 / float(q @ q))
    return transform(rotations.from_quaternion(q), t)


def _solve_translation(A: Array, B: Array, R: Array) -> Array:
    """Solve ``(R_A - I) t = R t_B - t_A`` for t by least squares."""
    system = (A[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    right = (B[:, :3, 3] @ R.T - A[:, :3, 3]).ravel()
    return np.asarray(np.linalg.lstsq(system, right, rcond=None)[0], float)


def _sine_vectors(T: Array) -> Array:
    """Return ``2 sin(angle / 2) axis`` of the rotations (n, 3)."""
    return 2 * rotations.to_quaternion(T[:, :3, :3])[:, :3]


def _from_left(q: Array) -> Array:
    """Return the matrices (..., 4, 4) with ``_from_left(q) @ p == q p``, quaternions as [x, y, z, w]."""
    return _product_matrix(q, 1)


def _from_right(q: Array) -> Array:
    """Return the matrices (..., 4, 4) with ``_from_right(q) @ p == p q``."""
    return _product_matrix(q, -1)


def _product_matrix(q: Array, side: int) -> Array:
    M = np.zeros((*q.shape, 4))
    M[..., :3, :3] = side * hat(q[..., :3])
    M[..., :3, 3], M[..., 3, :3] = q[..., :3], -q[..., :3]
    M[..., range(4), range(4)] = q[..., 3, None]
    return M


def _dual_quaternion(T: Array) -> tuple[Array, Array]:
    """Return the quaternions [x, y, z, w] of the rotations and their dual parts ``t q / 2``."""
    q = rotations.to_quaternion(T[:, :3, :3])
    t = np.concatenate([T[:, :3, 3], np.zeros((len(T), 1))], -1)
    return q, 0.5 * np.einsum("nij,nj->ni", _from_left(t), q)


def _as_xyzw(q: Array) -> Array:
    """Convert from [w, x, y, z], the order in the equations of Daniilidis."""
    return np.roll(q, -1)


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
    T = dataset.transform(sensor.calibration_parent, pattern.parent_link)
    if len(T) > 1 and max(float(values.max()) for values in distance(T[:1], T)) <= 1e-6:
        return f"it needs an arm, and nothing moves between '{sensor.calibration_parent}' and '{pattern.parent_link}'"
    return None


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


ROBOT_WORLD: Mapping[str, Callable[[Array, Array], RobotWorld]] = {
    "shah": solve_robot_world,
    "li": solve_li,
}
"""Own implementation: from A and B (n, 4, 4) in ``A_i = X @ B_i @ Y``."""
HAND_EYE: Mapping[str, Callable[[Array, Array], Array]] = {
    "tsai": solve_tsai,
    "park": solve_park,
    "horaud": solve_horaud,
    "andreff": solve_andreff,
    "daniilidis": solve_daniilidis,
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
