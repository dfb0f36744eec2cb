"""A camera and a pattern on either side of an arm: Shah's and Li's robot-world solutions.

The camera may be carried by the arm and look at a pattern in the world (eye in hand), or stand in
the world and look at a pattern on the arm (eye to hand): with named frames both are the same equation.
Each view counts with the pose that it gives by itself; nothing is refined in pixels afterwards.
"""

from collections.abc import Callable

from calibration.dataset.model import Dataset, Edge, Sensor
from calibration.dataset.pattern import Pattern
from calibration.errors import InputError, UndeterminedError
from calibration.estimation.linear_start import SINGLE_AXIS
from calibration.estimation.robot_world import RobotWorld, solve_li, solve_robot_world
from calibration.evaluation.views import corner_views
from calibration.geometry.transforms import distance, inverse
from calibration.geometry.types import Array

Solver = Callable[[Array, Array], RobotWorld]
"""From A and B (n, 4, 4); see `solve_robot_world`."""

MINIMUM_VIEWS = 3
"""Two relative motions are the least that has rotations about two axes."""


def shah(dataset: Dataset) -> Dataset:
    """The dataset with the transforms of cameras and pattern by `solve_robot_world`.

    Raises:
        InputError: the method does not apply (`why_not_robot_world`).
        UndeterminedError: too few views, or rotations about fewer than two axes.
    """
    return calibrate_arm(dataset, solve_robot_world)


def li(dataset: Dataset) -> Dataset:
    """The dataset with the transforms of cameras and pattern by `solve_li`; errors as `shah`."""
    return calibrate_arm(dataset, solve_li)


def why_not_robot_world(dataset: Dataset) -> str | None:
    """One line that says why the method does not apply to a dataset; None if it does."""
    others = [s for s in dataset.sensors.values() if s.modality != "rgb"]
    if others:
        return f"it needs cameras only, and '{others[0].name}' is {others[0].modality}"
    if dataset.additional_transforms:
        return f"it cannot calibrate additional transforms, such as '{'-'.join(dataset.additional_transforms[0])}'"
    if len(dataset.patterns) != 1:
        return f"it needs one pattern, and there are {len(dataset.patterns)}"
    pattern = next(iter(dataset.patterns.values()))
    if not pattern.fixed:
        return f"it needs a pattern fixed to the world or to an arm, and '{pattern.name}' moves freely"
    for sensor in dataset.sensors.values():
        path = dataset.tree.path(sensor.calibration_parent, pattern.parent_link)
        if sensor.edge in ((step.parent, step.child) for step in path):
            return f"it needs an arm between camera and pattern, and '{pattern.name}' is carried by '{sensor.name}'"
        if not _moves(dataset.transform(sensor.calibration_parent, pattern.parent_link)):
            return (
                f"it needs an arm, and nothing moves between '{sensor.calibration_parent}' and '{pattern.parent_link}'"
            )
    return None


def _moves(T: Array) -> bool:
    return len(T) < 2 or any(float(values.max()) > 1e-6 for values in distance(T[:1], T))


def calibrate_arm(dataset: Dataset, solve: Solver) -> Dataset:
    """The dataset with the transforms of cameras and pattern by a solver of ``A_i = X @ B_i @ Y``; errors as `shah`."""
    reason = why_not_robot_world(dataset)
    if reason:
        raise InputError(f"{dataset.path}: the method does not apply: {reason}")
    pattern = next(iter(dataset.patterns.values()))
    transforms: dict[Edge, Array] = {}
    for sensor in dataset.sensors.values():
        T_parent_child, T_parent_pattern = _camera_and_pattern(dataset, sensor, pattern, solve)
        transforms[sensor.edge] = T_parent_child
        transforms.setdefault((pattern.parent_link, pattern.link), T_parent_pattern)
    return dataset.with_transforms(transforms)


def _camera_and_pattern(dataset: Dataset, sensor: Sensor, pattern: Pattern, solve: Solver) -> tuple[Array, Array]:
    """The camera's calibrated transform and the pattern's, from the views of this camera.

    ``arm = X @ seen @ Y`` with the camera's transform X and the inverse of the pattern's Y; the arm's
    poses, the exact ones, stand on the left, as ATOM passes them to OpenCV.
    """
    views = corner_views(dataset, sensor.name, pattern)
    if len(views.collections) < MINIMUM_VIEWS:
        raise UndeterminedError(
            f"{dataset.path}: '{sensor.name}' has {len(views.collections)} views of '{pattern.name}'; "
            f"at least {MINIMUM_VIEWS} are needed"
        )
    seen_in = dataset.with_collections(views.collections.tolist())
    arm = seen_in.transform(sensor.calibration_parent, pattern.parent_link)
    seen = seen_in.transform(sensor.calibration_child, sensor.frame) @ views.T_camera_pattern
    solution = solve(arm, seen)
    axes = solution.spectrum.axes(SINGLE_AXIS)
    if axes < 2:
        motion = ("does not turn", "turns about one axis only")[axes]
        raise UndeterminedError(
            f"{dataset.path}: between '{sensor.calibration_parent}' and '{pattern.parent_link}' the arm {motion}; "
            f"rotations about two axes are needed"
        )
    return solution.X, inverse(solution.Y)
