"""Finding of a check of a calibration."""

from collections.abc import Sequence
from typing import Literal

from calibration.base.records import field, result

FindingKind = Literal[
    "after-move",
    "against-optimum",
    "baseline",
    "baseline-quality",
    "baseline-unmoved",
    "camera-info",
    "contradicted-prior",
    "contradiction",
    "convention",
    "copies",
    "coverage",
    "engine",
    "exchanged-sensors",
    "far-from-description",
    "lens",
    "missing-files",
    "moved-frame",
    "no-baseline",
    "noisy-sensor",
    "not-determined",
    "not-verified",
    "nothing-suspicious",
    "other-dataset",
    "pattern-size",
    "precision",
    "rejected-labels",
    "rejected-view",
    "repeated",
    "residual-correlation",
    "residual-pattern",
    "suspect",
    "table",
    "task",
    "too-few",
    "turned-board",
    "untested",
    "weak-direction",
    "wrong-views",
]
"""What a check has found. Each kind is that of one check."""
Severity = Literal["red", "undecided", "warning", "note"]


@result
class Finding:
    """Observation about a calibration or its data, as text and numbers."""

    kind: FindingKind = field("What was found.")
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
    tasks: tuple[str, ...] = field("The robot's tasks whose limit is broken by it, or undecided.", default=())


def first_names(names: Sequence[str], most: int) -> str:
    """Return the first of some names for a message, and the number of the others."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if names[most:] else "")
