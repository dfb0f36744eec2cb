"""The section ``baseline`` of calibration.yml: allowed changes against the baseline."""

from pathlib import Path
from typing import Annotated

from calibration.base.errors import InputError
from calibration.base.records import Converted, Place, at_least, field, length, record
from calibration.base.tables.rules import Allowance, parse_allowance

BASELINE_FILE = "calibration-baseline.json"
Least = Annotated[float, at_least(0)]


def _parse_allowance_at(text: str, place: Place) -> Allowance:
    try:
        return parse_allowance(text)
    except InputError as error:
        raise place.fault(str(error)) from None


Increase = Annotated[Allowance, Converted(Annotated[str, length(1, 30)], _parse_allowance_at)]


@record
class SameData:
    """Tolerances of a result on the same data, where it is deterministic."""

    sigmas: Least = field("Standard deviations by the labels' noise, and never less than the rest.", default=0.1)
    translation_mm: Least = field("Of a translation.", default=0.001, unit="mm")
    rotation_deg: Least = field("Of a rotation.", default=0.00006, unit="degrees")
    error_bars: Least = field("Noise of the labels and standard deviations, in percent.", default=1.0)


@record
class MaxIncrease:
    """Limits of the increase of quality measures over the baseline: 10%, or 0.1 in its unit."""

    rms: Increase = field("Root mean square of the table (5%).", default=Allowance(5, True))
    noise: Increase = field("Noise of each kind of label (5%).", default=Allowance(5, True))
    sigma: Increase = field("The largest standard deviation of a translation (25%).", default=Allowance(25, True))
    rejected: Increase = field("Share of the labels that do not fit, in percent (1).", default=Allowance(1, False))


@record
class BaselineSettings:
    """The accepted calibration that every cell is compared with."""

    file: Annotated[Path, Converted(Annotated[str, length(1)], lambda text, place: place.folder / text)] = field(
        f"The reviewed file, relative to this one ({BASELINE_FILE}).", default=Path(BASELINE_FILE)
    )
    required: bool = field("Whether a system without an accepted calibration fails (false).", default=False)
    translation_mm: Least = field("Allowed displacement of a sensor on other data (0).", default=0.0, unit="mm")
    rotation_deg: Least = field("Allowed rotation of a sensor on other data (0).", default=0.0, unit="degrees")
    same_data: SameData = field("Allowed differences of a result on the same data.", default_factory=SameData)
    max_increase: MaxIncrease = field(
        "Allowed increase of the errors over the baseline; on other data, the effect of chance is added.",
        default_factory=MaxIncrease,
    )
