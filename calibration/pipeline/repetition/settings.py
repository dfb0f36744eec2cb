"""How often a run is repeated, and how much its repetitions may differ."""

from collections.abc import Mapping
from typing import Annotated

from calibration.base.flake_rate import MAX_REPETITIONS
from calibration.base.records import between, field, one_of, record
from calibration.engine.diagnosis.limits import Limit

_SPREAD_KEYS = ("rms-px", "translation-mm", "rotation-deg")


@record(rules=(one_of(*_SPREAD_KEYS, why=f"expected a limit: {', '.join(_SPREAD_KEYS)}"),))
class MaxSpread:
    """Largest standard deviations of results over repeated runs; None for no limit."""

    rms_px: Limit | None = field("Of every result in pixels, such as the RMS of a cell.", default=None, unit="px")
    translation_mm: Limit | None = field(
        "Of every calibrated transform, and of the errors against the truth.", default=None, unit="mm"
    )
    rotation_deg: Limit | None = field("Likewise.", default=None, unit="degrees")

    @property
    def limit_of_unit(self) -> Mapping[str, float]:
        """The limits that are set, by the unit of results: px, mm and deg."""
        limits = {"px": self.rms_px, "mm": self.translation_mm, "deg": self.rotation_deg}
        return {unit: limit for unit, limit in limits.items() if limit is not None}


@record
class Repetitions:
    """How often a run is repeated, and how much its repetitions may differ."""

    repeat: Annotated[int, between(1, MAX_REPETITIONS)] = field(
        "Number of runs, one after the other, each kept in run-1, run-2, ...; what does not always pass is flaky.",
        default=1,
        option="Number of runs, each kept in run-1, run-2, ... of output; what does not always pass is flaky (1).",
    )
    max_flake_rate: Annotated[float, between(0, 1)] | None = field(
        "Largest share of the repeated runs in which something may fail that passes in others (none).", default=None
    )
    max_spread: MaxSpread | None = field(
        "Largest standard deviations of results over the repeated runs.", default=None, option=False
    )
