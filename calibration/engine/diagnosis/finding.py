"""Finding of a check of a calibration."""

from typing import Literal

from calibration.base.records import field, result

SUSPECT, CONTRADICTION, CONVENTION = "suspect", "contradiction", "convention"
"""Kinds of findings that say that something is wrong, by themselves or with others."""
AFTER_MOVE = "after-move"
"""Kind of the finding that says of which part of the recording the result is, where something has moved."""
Severity = Literal["red", "undecided", "warning", "note"]


@result
class Finding:
    """Observation about a calibration or its data, as text and numbers."""

    kind: str = field("The check that made it, such as suspect, duplicate or description.")
    severity: Severity = field(
        "red: a reason to fail. undecided: a limit may hold or not. warning: worth a look. note: a line of the report."
    )
    text: str = field("The fault, its size, and advice; one line.")
    sensors: tuple[str, ...] = field("The sensors concerned.", default=())
    collections: tuple[str, ...] = field("The keys of the collections concerned.", default=())
    value: float | None = field("The size of what was found.", default=None)
    sigma: float | None = field("Standard deviation of the value.", default=None)
    unit: str | None = field("Unit of value and sigma: m, rad, px, s, or 1 for a ratio.", default=None)
    moves_mm: float | None = field("Largest displacement of a sensor.", default=None, unit="mm")
    moves_deg: float | None = field("Largest rotation of a sensor.", default=None, unit="degrees")
