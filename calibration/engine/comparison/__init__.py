"""Other calibration methods on the same dataset, to compare with the built-in engine.

`COMPARISON_METHODS` lists them; each takes a dataset and returns a new one with its own transforms:

- ``sensor_pairs``: two cameras by OpenCV, two LiDARs or depth cameras by ICP;
- ``arm``: cameras, an arm, fixed patterns; by OpenCV, or by our own solvers and the robot-world solutions of the
  estimation.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

from calibration.base import InputError, did_you_mean, solvable
from calibration.engine.comparison.arm import HAND_EYE, ROBOT_WORLD, by_arm, described, why_not_arm
from calibration.engine.comparison.sensor_pairs import (
    CAMERA_MODALITIES,
    RANGE_SENSORS,
    icp,
    only_pair,
    opencv_stereo,
    opencv_version,
    why_not_icp,
    why_not_stereo,
)
from calibration.engine.dataset.model import Dataset


@dataclass(frozen=True)
class Method:
    """A calibration method other than the built-in engine."""

    name: str
    """Name in command lines and file names."""
    title: str
    """Name in tables."""
    why_not: Callable[[Dataset], str | None]
    """Reason why it does not apply to a dataset, in one line; None if it does."""
    run: Callable[[Dataset], Dataset]
    """Return the dataset with the method's transforms; `CalibrationError` if it does not apply or fails."""
    describe: Callable[[Dataset], str]
    """Implementation used on a dataset, with the chosen patterns if there is a choice."""
    part: Callable[[Dataset], Dataset] = lambda dataset: dataset
    """The dataset reduced to the sensors that the method calibrates, on which it is scored."""
    from_start: bool = False
    """Whether it starts from the dataset's transforms, so that its result depends on the initial guess."""

    def calibrate(self, dataset: Dataset) -> Dataset:
        """Calibrate a dataset and return the new one.

        Raises:
            CalibrationError: the method does not apply, or fails.
        """
        if dataset.joints:
            raise InputError(f"{self.title} calibrates no joints, and the dataset asks for {', '.join(dataset.joints)}")
        with solvable(dataset.path):
            return self.run(dataset)


def _stereo_method(name: str, title: str, run: Callable[[Dataset], Dataset]) -> Method:
    return Method(name, title, why_not_stereo, run, opencv_version, partial(only_pair, modalities=CAMERA_MODALITIES))


def _arm_method(name: str) -> Method:
    return Method(name, name.capitalize(), why_not_arm, partial(by_arm, name), partial(described, name))


def _icp_method(name: str, title: str, run: Callable[[Dataset], Dataset]) -> Method:
    part = partial(only_pair, modalities=RANGE_SENSORS)
    return Method(name, title, why_not_icp, run, lambda _: "built in", part, from_start=True)


COMPARISON_METHODS: Mapping[str, Method] = {
    method.name: method
    for method in (
        _stereo_method("opencv-stereo", "OpenCV stereo", opencv_stereo),
        _stereo_method("opencv-stereo-fixed", "OpenCV stereo, intrinsics fixed", partial(opencv_stereo, fixed=True)),
        *map(_arm_method, (*ROBOT_WORLD, *HAND_EYE)),
        _icp_method("icp", "ICP, all collections at once", icp),
        _icp_method("icp-average", "ICP, average of the collections", partial(icp, result="average")),
        _icp_method("icp-best", "ICP, best collection", partial(icp, result="best")),
    )
}
"""All comparison methods, by name."""


def method_of(name: str) -> Method:
    """Return the method with this name.

    Raises:
        InputError: there is no such method.
    """
    if name not in COMPARISON_METHODS:
        raise InputError(
            f"there is no method '{name}'{did_you_mean(name, COMPARISON_METHODS)} (known: "
            f"{', '.join(COMPARISON_METHODS)})"
        )
    return COMPARISON_METHODS[name]
