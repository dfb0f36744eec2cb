"""Two cameras with each other's labels, told by what the corners say once they are given back."""

from dataclasses import replace
from itertools import combinations

from calibration.dataset.model import Dataset
from calibration.diagnosis.finding import Finding
from calibration.errors import CalibrationError
from calibration.estimation.calibrate import calibrate
from calibration.estimation.options import Options
from calibration.estimation.result import Calibration

CHEAPER = 0.5
"""Corners that are off by less than this share of what they were, once exchanged, belong to the other camera."""
PAIRS = 3
"""Pairs of cameras that are tried: each is a calibration."""


def exchanged_labels(calibration: Calibration, description: Dataset, options: Options) -> tuple[Finding, ...]:
    """Calibrate again with the labels of two cameras exchanged: for results that are of no use as they are.

    On a rigid rig an exchange fits as well as the truth, and only the description tells
    (`calibration.diagnosis.description`); cameras on different bodies, or of different lenses, tell it themselves.
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
    """The dataset with what one sensor saw as what another did."""
    names = {a: b, b: a}
    return replace(
        dataset,
        collections=tuple(
            replace(c, labels={(p, names.get(s, s)): label for (p, s), label in c.labels.items()})
            for c in dataset.collections
        ),
    )
