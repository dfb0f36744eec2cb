"""A camera and a pattern on either side of an arm: Tsai, Park, Horaud, Andreff and Daniilidis.

These hand-eye solutions find the camera's transform only, from the motions between views; the pattern's
follows from it, the mean over the views. They apply where the robot-world methods do.
"""

from collections.abc import Callable

from calibration.comparison import hand_eye_solvers as solvers
from calibration.comparison.robot_world_methods import calibrate_arm
from calibration.dataset.model import Dataset
from calibration.estimation.linear_start import SINGLE_AXIS
from calibration.estimation.robot_world import RobotWorld, solve_robot_world
from calibration.geometry import rotations
from calibration.geometry.transforms import inverse, transform
from calibration.geometry.types import Array

Solver = Callable[[Array, Array], Array]


def tsai(dataset: Dataset) -> Dataset:
    """The dataset with the transforms of cameras and pattern by `solve_tsai`.

    Raises:
        InputError: the method does not apply (`why_not_robot_world`).
        UndeterminedError: too few views, or rotations about fewer than two axes.
    """
    return _calibrated(dataset, solvers.solve_tsai)


def park(dataset: Dataset) -> Dataset:
    """The dataset with the transforms of cameras and pattern by `solve_park`; errors as `tsai`."""
    return _calibrated(dataset, solvers.solve_park)


def horaud(dataset: Dataset) -> Dataset:
    """The dataset with the transforms of cameras and pattern by `solve_horaud`; errors as `tsai`."""
    return _calibrated(dataset, solvers.solve_horaud)


def andreff(dataset: Dataset) -> Dataset:
    """The dataset with the transforms of cameras and pattern by `solve_andreff`; errors as `tsai`."""
    return _calibrated(dataset, solvers.solve_andreff)


def daniilidis(dataset: Dataset) -> Dataset:
    """The dataset with the transforms of cameras and pattern by `solve_daniilidis`; errors as `tsai`."""
    return _calibrated(dataset, solvers.solve_daniilidis)


def _calibrated(dataset: Dataset, solve: Solver) -> Dataset:
    def both(arm: Array, seen: Array) -> RobotWorld:
        """X and Y in ``arm = X @ seen @ Y``."""
        known = solve_robot_world(arm, seen)
        if known.spectrum.axes(SINGLE_AXIS) < 2:  # `calibrate_arm` refuses it
            return known
        X = solve(*solvers.relative_motions(arm, seen))
        Y = inverse(X @ seen) @ arm
        mean = transform(rotations.nearest(Y[:, :3, :3].mean(0)), Y[:, :3, 3].mean(0))
        return RobotWorld(X, mean, known.spectrum)

    return calibrate_arm(dataset, both)
