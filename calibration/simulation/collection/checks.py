"""Whether a collection is worth keeping: every sensor detects, nothing moves, what is seen is large enough."""

from dataclasses import dataclass

import numpy as np

from calibration.dataset.model import CornerLabels
from calibration.geometry.cameras import Camera
from calibration.labelling.detection import NotDetected
from calibration.simulation.collection.capture import Capture
from calibration.simulation.system import System


@dataclass(frozen=True)
class Requirements:
    """What a collection has to keep to."""

    stillness: float = 0.002
    """How far a pattern may move while the sensors look, m."""
    image_share: float = 0.005
    """The share of an image that the detected corners span, at least."""


def reasons_to_lose(system: System, capture: Capture, requirements: Requirements) -> tuple[str, ...]:
    """Why a collection is not kept; nothing where it is."""
    reasons = [reason for sensor in system.sensors if (reason := _undetected(capture, sensor))]
    if capture.movement > requirements.stillness:
        limit = 1000 * requirements.stillness
        reasons.append(f"moved {1000 * capture.movement:.1f} mm while the sensors looked, {limit:g} mm are allowed")
    for name, camera in system.cameras.items():
        spans = [image_share(camera.camera, found) for found in capture.corners(name).values()]
        if spans and max(spans) < requirements.image_share:
            least = 100 * requirements.image_share
            reasons.append(f"{name}: the corners span {100 * max(spans):.2g} % of the image, {least:g} % are needed")
    return tuple(reasons)


def _undetected(capture: Capture, sensor: str) -> str:
    """Why a sensor detects none of the patterns; empty where it detects one."""
    found = capture.found_by(sensor)
    if not all(isinstance(answer, NotDetected) for answer in found.values()):
        return ""
    several = len(found) > 1
    why = "; ".join(
        f"{pattern}: {answer.reason}" if several else answer.reason
        for pattern, answer in found.items()
        if isinstance(answer, NotDetected)
    )
    return f"{sensor}: {why}"


def image_share(camera: Camera, labels: CornerLabels) -> float:
    """The share of the image that the box around the corners covers."""
    width, height = np.ptp(labels.pixels, axis=0)
    return float(width * height / (camera.width * camera.height))
