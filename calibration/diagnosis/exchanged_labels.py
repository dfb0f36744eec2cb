"""Check for two cameras with exchanged labels, by a calibration with the labels exchanged back."""

from dataclasses import replace
from itertools import combinations

from calibration.dataset.model import Dataset
from calibration.diagnosis.finding import Finding
from calibration.errors import CalibrationError
from calibration.estimation.calibrate import calibrate
from calibration.estimation.options import Options
from calibration.estimation.result import Calibration

CHEAPER = 0.5
"""Labels are exchanged if the residuals, once exchanged back, are below this fraction of the original ones."""
PAIRS = 3
"""Number of pairs of cameras that are tried: each takes a calibration."""


def exchanged_labels(calibration: Calibration, description: Dataset, options: Options) -> tuple[Finding, ...]:
    """Calibrate again with the labels of two cameras exchanged: for results that are unusable.

    On a rigid rig an exchange fits as well as the truth, and only the description reveals it
    (`calibration.diagnosis.description`); with cameras on different bodies, or of different lenses, the residuals do.
    """
    if options.start != "linear":
        return ()
    cameras = [sensor.name for sensor in description.sensors.values() if sensor.modality.has_corners]
    pairs = list(combinations(cameras, 2))
    for a, b in pairs[:PAIRS]:
        try:
            other = calibrate(with_exchanged(description, a, b), options)
        except CalibrationError:
            continue
        if other.converged and not (calibration.converged and other.rms_px > CHEAPER * calibration.rms_px):
            text = (
                f"the labels of '{a}' and '{b}' look exchanged: given back to each other, they fit "
                f"({other.rms_px:.2f} px); look at the topics of the two sensors"
            )
            return (Finding("exchanged-sensors", "red", text, (a, b)),)
    return ()


def with_exchanged(dataset: Dataset, a: str, b: str) -> Dataset:
    """Return the dataset with the labels of two sensors exchanged."""
    names = {a: b, b: a}
    return replace(
        dataset,
        collections=tuple(
            replace(c, labels={(p, names.get(s, s)): label for (p, s), label in c.labels.items()})
            for c in dataset.collections
        ),
    )
