"""Results of ``import-data`` and ``label``."""

from collections.abc import Mapping
from typing import Literal

from calibration.records import field, result


@result
class RejectedView:
    """An image in which no pattern is detected."""

    file: str = field("The image.")
    reason: str = field("Why.")


@result
class SensorResult:
    """Results for the images of one camera, or the clouds or scans of one LiDAR."""

    images: int = field("How many there are.")
    labelled: int = field("How many show a pattern.")
    corners: int = field("How many corners, or points on a pattern, were found in all.")
    intrinsics: Literal["given", "estimated", "none"] = field(
        "Where they come from; estimated ones are a start only; a LiDAR has none."
    )
    camera: Mapping[str, float] = field("The intrinsics by their names.")
    rejected: tuple[RejectedView, ...] = field("Images in which no pattern is detected.", default=())


@result
class ImportResults:
    """Results of import-data."""

    robot: str = field("Its name.")
    found: int = field("Moments that were found, of which those that tell most are kept.")
    moments: int = field("Those that were looked at: images that belong together.")
    collections: int = field("Moments with a pattern in them: the collections of the dataset.")
    together: int = field("Collections in which two sensors or more see a pattern.")
    lag_ms: float = field("Between the images of a moment, at most.", unit="ms")
    sensors: Mapping[str, SensorResult] = field("By name.")
    evenly: str | None = field("Why the moments were chosen evenly, not as those that calibrate best.", default=None)


@result
class LabelledSensor:
    """Results for the labelled images of one camera."""

    images: int = field("How many were looked at.")
    labelled: int = field("How many show a pattern.")
    rejected: tuple[RejectedView, ...] = field("Images in which no pattern is detected.", default=())


@result
class LabelResults:
    """Results of label."""

    collections: int = field("Of the dataset.")
    sensors: Mapping[str, LabelledSensor] = field("By name.")
