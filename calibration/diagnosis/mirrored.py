"""A sensor whose data are mirrored, told by what they say once they are mirrored back.

Images that were flipped, or a LiDAR's axes of the wrong hand (y to the right, two axes exchanged), are of a world that
no pose of the sensor shows. Any reflection brings them back: what is left of the difference is a rotation, which the
calibration finds.
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
"""Collections that disagree by less than this share of what they did, once mirrored back, were mirrored."""
NONE = 100.0
"""What counts as their disagreement where the data cannot be calibrated as they are."""
SENSORS = 3
"""Sensors that are tried: each is a calibration."""
WHY = {
    "images": "does a driver flip the images, or a detector number the corners from the other side?",
    "points": "does an axis of the points' frame point the wrong way, or are two exchanged (a left-handed frame)?",
}


def mirrored(calibration: Calibration | None, description: Dataset, options: Options) -> tuple[Finding, ...]:
    """Calibrate again with one sensor's data mirrored back: for results that are of no use as they are.

    Args:
        calibration: None where the data cannot be calibrated as they are.
        description: the dataset as the robot's description has it.
        options: how it was calibrated; from a start that is given nothing is told, as that too may be wrong.
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
    """How far collections disagree once a sensor's data are mirrored back; without bound where there is no result."""
    try:
        calibration = calibrate(with_mirrored(description, sensor), options)
    except CalibrationError:
        return np.inf
    return disagreement(calibration.solution.model).ratio if calibration.converged else np.inf


def with_mirrored(dataset: Dataset, sensor: str) -> Dataset:
    """The dataset with left for right in a camera's images, and with y the other way in the points of a sensor."""
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
