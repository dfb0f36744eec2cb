"""Check for a sensor with mirrored data, by a calibration with the data mirrored back.

Flipped images, or a LiDAR's left-handed axes (y to the right, or two axes exchanged), fit no pose of the sensor. Any
reflection corrects them: it differs from the right one by a rotation, which the calibration finds.
"""

from dataclasses import replace

import numpy as np

from calibration.dataset.model import CornerLabels, Dataset, Labels, PointLabels, PoseLabels
from calibration.diagnosis.finding import Finding
from calibration.errors import CalibrationError
from calibration.estimation.calibrate import calibrate
from calibration.estimation.options import Options
from calibration.estimation.result import Calibration
from calibration.estimation.suspects import disagreement

BETTER = 0.05
"""Data are mirrored if mirroring reduces the disagreement of the collections below this fraction."""
NONE = 100.0
"""Assumed disagreement if the data cannot be calibrated as they are."""
SENSORS = 3
"""Number of sensors that are tried: each takes a calibration."""
WHY = {
    "images": "does a driver flip the images, or a detector number the corners from the other side?",
    "points": "does an axis of the points' frame point the wrong way, or are two exchanged (a left-handed frame)?",
}


def mirrored(calibration: Calibration | None, description: Dataset, options: Options) -> tuple[Finding, ...]:
    """Calibrate again with one sensor's data mirrored: for results that are unusable.

    Args:
        calibration: None if the data cannot be calibrated as they are.
        description: the dataset with the robot's description.
        options: options of the calibration; with a given initial guess nothing is reported, as it may be wrong too.
    """
    if options.start != "linear":
        return ()
    now = disagreement(calibration.solution.model).ratio if calibration and calibration.converged else NONE
    tried = [name for name, each in description.sensors.items() if not each.modality.has_poses][:SENSORS]
    found = [name for name in tried if _then(description, name, options) < BETTER * now]
    if not found:
        return ()
    what = {name: "images" if description.sensors[name].camera else "points" for name in found}
    either = " or ".join(f"the {what[name]} of '{name}'" for name in found)
    why = " ".join(WHY[each] for each in dict.fromkeys(what.values()))
    text = f"{either} look mirrored: mirrored back, they agree with all else; {why}"
    return (Finding("mirrored-sensor", "red", text, tuple(found)),)


def _then(description: Dataset, sensor: str, options: Options) -> float:
    """Return the disagreement of the collections with a sensor's data mirrored; infinite if there is no result."""
    try:
        calibration = calibrate(with_mirrored(description, sensor), options)
    except CalibrationError:
        return np.inf
    return disagreement(calibration.solution.model).ratio if calibration.converged else np.inf


def with_mirrored(dataset: Dataset, sensor: str) -> Dataset:
    """Return the dataset with a camera's images mirrored left to right, or a sensor's points in y."""
    camera = dataset.sensors[sensor].camera

    def reflected(label: Labels) -> Labels:
        if isinstance(label, PointLabels):
            return replace(label, points=label.points * (1, -1, 1))
        if isinstance(label, PoseLabels):
            return label
        width = camera.width if camera else 0
        return CornerLabels(label.ids, np.stack([width - 1 - label.pixels[:, 0], label.pixels[:, 1]], -1))

    return replace(
        dataset,
        collections=tuple(
            replace(c, labels={key: reflected(label) if key[1] == sensor else label for key, label in c.labels.items()})
            for c in dataset.collections
        ),
    )
