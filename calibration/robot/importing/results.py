"""Results of ``import-data`` and ``label``."""

from collections.abc import Mapping
from typing import Literal

from calibration.base.records import field, result


@result
class RejectedView:
    """An image in which no pattern is detected."""

    file: str = field("The image.")
    reason: str = field("Why.")


@result
class SensorResult:
    """Results for the images of one camera, or the clouds or scans of one LiDAR."""

    images: int = field("Number of images.")
    labelled: int = field("Number of those with a pattern.")
    corners: int = field("Total number of corners, or points on a pattern.")
    intrinsics: Literal["given", "estimated", "none"] = field(
        "Where they come from; estimated ones are a start only; a LiDAR has none."
    )
    camera: Mapping[str, float] = field("The intrinsics by their names.")
    lens: str | None = field("Why an estimated camera has its lens model.", default=None)
    rejected: tuple[RejectedView, ...] = field("Images in which no pattern is detected.", default=())


@result
class LeftOut:
    """What an import left out by one rule in one place."""

    rule: str = field("Why.")
    place: str = field("The sensor, topic, frame or joint.")
    count: int = field("How many.")
    first_s: float | None = field("Stamp of the first.", default=None, unit="s")


@result
class ImportResults:
    """Results of import-data."""

    robot: str = field("Its name.")
    found: int = field("Number of moments found, of which the best are kept.")
    moments: int = field("Number of moments that were searched: images that belong together.")
    collections: int = field("Number of moments with a pattern: the collections of the dataset.")
    together: int = field("Collections in which two sensors or more see a pattern.")
    lag_ms: float = field("Largest time between the images of a moment.", unit="ms")
    sensors: Mapping[str, SensorResult] = field("By name.")
    evenly: str | None = field(
        "Reason why the moments are evenly spaced, and not those that calibrate best.", default=None
    )
    left_out: tuple[LeftOut, ...] = field("What was recorded and is not in the dataset.", default=())
    notes: tuple[str, ...] = field("What was read otherwise than recorded.", default=())


@result
class LabelledSensor:
    """Results for the labelled images of one camera."""

    images: int = field("Number of images that were searched.")
    labelled: int = field("Number of those with a pattern.")
    rejected: tuple[RejectedView, ...] = field("Images in which no pattern is detected.", default=())


@result
class LabelResults:
    """Results of label."""

    collections: int = field("Of the dataset.")
    sensors: Mapping[str, LabelledSensor] = field("By name.")
