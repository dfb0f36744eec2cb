"""The methods of the comparison, by name."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

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


METHODS: Mapping[str, Method] = {
    method.name: method
    for method in (
        Method("opencv-stereo", "OpenCV stereo", why_not_stereo, opencv_stereo),
        Method("opencv-stereo-fixed", "OpenCV stereo, intrinsics fixed", why_not_stereo, opencv_stereo_fixed),
        Method("shah", "Shah", why_not_robot_world, shah),
        Method("li", "Li", why_not_robot_world, li),
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
    return [method for method in METHODS.values() if method.why_not(dataset) is None]
