"""The methods of the comparison, by name."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from calibration.comparison.hand_eye_methods import andreff, daniilidis, horaud, park, tsai
from calibration.comparison.icp import icp, icp_average, icp_best, why_not_icp
from calibration.comparison.opencv_stereo import opencv_stereo, opencv_stereo_fixed, why_not_stereo
from calibration.comparison.robot_world_methods import li, shah, why_not_robot_world
from calibration.dataset.model import Dataset
from calibration.errors import InputError


@dataclass(frozen=True)
class Method:
    """A way to calibrate a dataset that is not ours."""

    name: str
    """For command lines and file names."""
    title: str
    """For tables."""
    why_not: Callable[[Dataset], str | None]
    """One line that says why it does not apply to a dataset; None if it does."""
    run: Callable[[Dataset], Dataset]
    """The dataset with the method's transforms; `CalibrationError` where it does not apply or fails."""

    def calibrate(self, dataset: Dataset) -> Dataset:
        """The dataset with the method's transforms.

        Raises:
            CalibrationError: it does not apply, or fails.
        """
        if dataset.joints:
            raise InputError(f"{self.title} calibrates no joints, and the dataset asks for {', '.join(dataset.joints)}")
        return self.run(dataset)


METHODS: Mapping[str, Method] = {
    method.name: method
    for method in (
        Method("opencv-stereo", "OpenCV stereo", why_not_stereo, opencv_stereo),
        Method("opencv-stereo-fixed", "OpenCV stereo, intrinsics fixed", why_not_stereo, opencv_stereo_fixed),
        Method("shah", "Shah", why_not_robot_world, shah),
        Method("li", "Li", why_not_robot_world, li),
        Method("tsai", "Tsai", why_not_robot_world, tsai),
        Method("park", "Park", why_not_robot_world, park),
        Method("horaud", "Horaud", why_not_robot_world, horaud),
        Method("andreff", "Andreff", why_not_robot_world, andreff),
        Method("daniilidis", "Daniilidis", why_not_robot_world, daniilidis),
        Method("icp", "ICP, all collections at once", why_not_icp, icp),
        Method("icp-average", "ICP, average of the collections", why_not_icp, icp_average),
        Method("icp-best", "ICP, best collection", why_not_icp, icp_best),
    )
}
"""All methods."""


def method_of(name: str) -> Method:
    """The method of this name.

    Raises:
        InputError: there is none.
    """
    if name not in METHODS:
        raise InputError(f"no comparison method '{name}' (methods: {', '.join(METHODS)})")
    return METHODS[name]


def applicable(dataset: Dataset) -> list[Method]:
    """The methods that apply to a dataset."""
    return [] if dataset.joints else [method for method in METHODS.values() if method.why_not(dataset) is None]
