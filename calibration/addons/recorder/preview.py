"""Preview of a pose: a picture for each sensor, and whether a collection there would be kept."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.base import InputError
from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.dataset.model import CornerLabels
from calibration.engine.dataset.sensor_data import NO_RETURN
from calibration.robot.labelling.detection import Image, NotDetected
from calibration.robot.labelling.points import PatternPoints
from calibration.robot.simulation.capture import Capture, Requirements, capture, reasons_to_lose
from calibration.robot.simulation.kinematics import play
from calibration.robot.simulation.motion import Motion
from calibration.robot.simulation.sensors.sensor import Found
from calibration.robot.simulation.system import System

PREVIEW_SEED = 1
"""Seed of the noise in previews, the default of ``collect-data-sim``."""
MAX_PICTURE_WIDTH = 640
"""Maximum width of pictures, px."""
_COLOUR_OF_CORNERS, _COLOUR_OF_FIRST_CORNER = (0, 230, 60), (255, 40, 40)  # RGB: the corners, and the one with id 0


@dataclass(frozen=True, eq=False)
class SensorPreview:
    """Preview of one sensor."""

    finding: str
    """Short description of the detections, such as "88 of 88 corners", or why there are none."""
    detected: bool
    picture: Image | None = None
    """RGB picture (H, W, 3) with the detections drawn in it; None for a LiDAR."""
    points: Array | None = None
    """Points (N, 3) of a LiDAR, in its frame, m."""
    on_pattern: BoolArray | None = None
    """Mask (N,) of the labelled points."""


@dataclass(frozen=True, eq=False)
class Preview:
    """Previews of all sensors, and the verdict."""

    views: Mapping[str, SensorPreview]
    """Views by sensor, in the order of the configuration; empty if the pose is invalid."""
    reasons: tuple[str, ...]
    """Reasons why a collection would be rejected; empty if it would be kept."""

    @property
    def kept(self) -> bool:
        """Whether a collection at this pose would be kept."""
        return not self.reasons


def preview(system: System, pose: Motion) -> Preview:
    """Return the preview of a pose (a motion of length one), by the code that collects datasets."""
    try:
        captured = capture(play(system, pose, PREVIEW_SEED), 0)
    except InputError as error:
        return Preview({}, (str(error).removeprefix(f"{pose.source}: "),))
    views = {name: _view_of_sensor(system, captured, name) for name in system.sensors}
    return Preview(views, reasons_to_lose(system, captured, Requirements()))


def _view_of_sensor(system: System, captured: Capture, name: str) -> SensorPreview:
    found, data = captured.found_by(name), captured.data[name]
    finding = "; ".join(
        (f"{pattern}: " if len(found) > 1 else "") + _describe_found(answer, len(system.patterns[pattern].corners))
        for pattern, answer in found.items()
    )
    detected = not all(isinstance(answer, NotDetected) for answer in found.values())
    labelled = [answer.on_pattern for answer in found.values() if isinstance(answer, PatternPoints)]
    points = system.sensors[name].points(data)
    if points is not None:
        on_pattern = np.zeros(len(points), bool)
        for indices in labelled:
            on_pattern[indices] = True
        returned = np.isfinite(points).all(-1)
        return SensorPreview(finding, detected, points=points[returned], on_pattern=on_pattern[returned])
    if name in system.cameras:
        return SensorPreview(finding, detected, draw_corners(data, list(captured.corners(name).values())))
    return SensorPreview(finding, detected, draw_depth(data, labelled))


def _describe_found(found: Found, corners: int) -> str:
    match found:
        case NotDetected():
            return found.reason
        case CornerLabels():
            return f"{len(found.ids)} of {corners} corners"
        case PatternPoints():
            return f"{len(found.on_pattern)} points"


def draw_corners(image: Image, labels: list[CornerLabels]) -> Image:
    """Return an RGB picture (h, w, 3) of a BGR image (H, W, 3), with a ring around every corner.

    The ring of the corner with id 0 is red, to show the detected orientation of the pattern.
    """
    scale = min(1.0, MAX_PICTURE_WIDTH / image.shape[1])
    picture = _at_most_wide(np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8))
    for label in labels:
        pixels = (label.pixels + 0.5) * scale - 0.5
        width, height = np.ptp(pixels, axis=0)
        radius = min(max(0.2 * math.sqrt(width * height / len(pixels)), 1.5), 5.0)  # so that rings do not overlap
        for identifier, (x, y) in zip(label.ids.tolist(), pixels.tolist(), strict=True):
            centre = (round(16 * x), round(16 * y))  # fixed-point coordinates, in sixteenths of a pixel
            colour = _COLOUR_OF_CORNERS if identifier else _COLOUR_OF_FIRST_CORNER
            cv2.circle(picture, centre, round(16 * radius), colour, 2 if radius > 3 else 1, cv2.LINE_AA, shift=4)
    return picture


def draw_depth(depth: NDArray[np.uint16], labelled: list[IntArray]) -> Image:
    """Return an RGB picture (h, w, 3) of a depth image (H, W): near is yellow, far is blue, the pattern green.

    Args:
        depth: in tenths of a millimetre; `NO_RETURN`, without a return, is shown black.
        labelled: linear indices of the pixels on each pattern.
    """
    returns = depth < NO_RETURN
    near, far = np.percentile(depth[returns], (1, 99)) if returns.any() else (0.0, 1.0)
    grey = np.clip((far - depth) / max(far - near, 1.0), 0, 1)
    warm = cv2.applyColorMap((255 * grey).astype(np.uint8), cv2.COLORMAP_PLASMA)
    picture = np.array(cv2.cvtColor(warm, cv2.COLOR_BGR2RGB), np.uint8)
    picture[~returns] = 0
    for indices in labelled:
        picture.reshape(-1, 3)[indices] = _COLOUR_OF_CORNERS
    return _at_most_wide(picture)


def _at_most_wide(picture: Image) -> Image:
    height, width = picture.shape[:2]
    if width <= MAX_PICTURE_WIDTH:
        return picture
    size = (MAX_PICTURE_WIDTH, max(1, round(height * MAX_PICTURE_WIDTH / width)))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
