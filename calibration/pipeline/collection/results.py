"""Results of a collection in simulation: numbers, limits, and the verdict."""

import dataclasses
import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any

from calibration import records
from calibration.dataset.modalities import MODALITIES
from calibration.errors import ExitCode, exit_code_of
from calibration.records import between, field
from calibration.report import Check, Verdict, at_least, at_most, verdict_of

if TYPE_CHECKING:
    from calibration.simulation.collection.proof import Proof
    from calibration.simulation.collection.record import CornerErrors, Record
    from calibration.simulation.scenarios.scenario import ScenarioResult


Share = Annotated[float, between(0, 1)]


@records.record
class CollectionChecks:
    """What a collected dataset has to keep to; None where there is no limit."""

    minimum_collections: Annotated[int, records.at_least(1)] = field(
        "Fewer make it fail.", default=3, option="Fewer collections that are kept make it fail (3)."
    )
    minimum_detection_rate: Share | None = field("Share of the poses that every sensor detects, 0 to 1.", default=None)
    minimum_coverage: Share | None = field("Share of every image that the corners cover, 0 to 1.", default=None)
    max_translation_mm: float | None = 5.0
    """Of the worst sensor against the truth, and of the worst length of a joint."""
    max_rotation_deg: float | None = 0.3
    """Likewise, of the worst angle."""


def truth_checks(found: "Proof | ScenarioResult | None", limits: CollectionChecks) -> list[Check]:
    """The errors of sensors, and of joints where some were calibrated, each with its limit."""
    errors = (
        ("translation", "translation_mm", limits.max_translation_mm, "mm"),
        ("joint translation", "joint_mm", limits.max_translation_mm, "mm"),
        ("rotation", "rotation_deg", limits.max_rotation_deg, "deg"),
        ("joint rotation", "joint_deg", limits.max_rotation_deg, "deg"),
    )
    values = ((kind, getattr(found, key) if found else None, limit, unit) for kind, key, limit, unit in errors)
    return [
        at_most(f"{kind} error against the truth", value, limit, unit)
        for kind, value, limit, unit in values
        if limit is not None and (value is not None or not kind.startswith("joint"))
    ]


@dataclass(frozen=True)
class SensorNumbers:
    """What one sensor did over all poses."""

    modality: str
    detected: int
    """In how many poses."""
    detection_rate: float
    partial: int
    """Of a camera: in how many poses it saw only a part of a pattern."""
    labels: int
    """Corners or points, over the collections that were kept."""
    corner_error: dict[str, Any] | None
    """Detected corners against the true ones, px; of a camera that detected something."""
    coverage: float | None
    """The share of a grid over a camera's image where a corner was seen in a collection that was kept."""


@dataclass(frozen=True)
class CollectionResults:
    """The records of all poses, and what a calibration of the dataset found."""

    system: str
    seed: int
    motion: str
    modalities: dict[str, str]
    """By sensor."""
    records: "tuple[Record, ...]"
    proof: "Proof | None"
    """None where no collection was kept."""
    limits: CollectionChecks = dataclasses.field(default_factory=CollectionChecks)
    failures: tuple[str, ...] = ()
    """Why the applications of a team collected nothing, or not everything."""
    error: ExitCode | None = None
    """Set where that was not their fault: a wrong image (2), the engine or the time (3)."""
    contact_sheet: bool = True
    """Whether there is one: without a system's description nobody knows the images."""

    @property
    def kept(self) -> "list[Record]":
        """The collections that make the dataset."""
        return [record for record in self.records if record.kept]

    @property
    def lost(self) -> "list[Record]":
        """The poses that do not."""
        return [record for record in self.records if not record.kept]

    @cached_property
    def sensors(self) -> dict[str, SensorNumbers]:
        """By name."""
        return {name: _sensor_numbers(name, modality, self) for name, modality in self.modalities.items()}

    @property
    def corner_rms(self) -> float | None:
        """Of all corners in the dataset against the truth, px."""
        error = _together([error for record in self.kept for error in record.errors.values()])
        return error["rms_px"] if error else None

    @cached_property
    def checks(self) -> list[Check]:
        """Every limit with what was found."""
        limits, proof = self.limits, self.proof
        checks = [at_least("collections", len(self.kept), limits.minimum_collections)]
        for name, numbers in self.sensors.items():
            if limits.minimum_detection_rate is not None:
                rate = numbers.detection_rate
                checks.append(at_least(f"detection rate of {name}", rate, limits.minimum_detection_rate))
            if limits.minimum_coverage is not None and numbers.coverage is not None:
                checks.append(at_least(f"coverage of {name}", numbers.coverage, limits.minimum_coverage))
        return checks + truth_checks(proof, limits)

    @property
    def reasons(self) -> list[str]:
        """Why the verdict is fail; nothing where it is pass."""
        if self.failures:
            return list(self.failures)
        failed = [str(check) for check in self.checks if not check.passed]
        if self.proof is not None and not self.proof.converged:
            return [f"the dataset does not calibrate: {self.proof.reason}", *failed]
        return failed

    @property
    def verdict(self) -> Verdict:
        """Pass when the dataset calibrates and every check passes."""
        return verdict_of(not self.reasons)

    @property
    def exit_code(self) -> ExitCode:
        """The verdict's, or that of what went wrong."""
        return exit_code_of(self.verdict == "pass", [self.error])


def _sensor_numbers(name: str, modality: str, results: CollectionResults) -> SensorNumbers:
    from calibration.simulation.collection.record import COLUMNS, ROWS  # OpenCV: who plans or reads needs none

    records, kept = results.records, results.kept
    detected = [record for record in records if record.labels[name]]
    camera = MODALITIES[modality].has_corners
    return SensorNumbers(
        modality=modality,
        detected=len(detected),
        detection_rate=round(len(detected) / len(records), 4) if records else 0.0,
        partial=sum(not record.complete[name] for record in detected) if camera else 0,
        labels=sum(record.labels[name] for record in kept),
        corner_error=_together([record.errors[name] for record in kept if name in record.errors]) if camera else None,
        coverage=round(len({c for r in kept for c in r.cells[name]}) / (COLUMNS * ROWS), 4) if camera else None,
    )


def _together(errors: "list[CornerErrors]") -> dict[str, Any] | None:
    """The errors of several views as one; None where there is none."""
    count = sum(error.count for error in errors)
    if not count:
        return None
    mean = [sum(error.count * error.mean[axis] for error in errors) / count for axis in (0, 1)]
    return {
        "corners": count,
        "rms_px": round(math.sqrt(sum(error.count * error.rms**2 for error in errors) / count), 5),
        "bias_px": [round(value, 5) for value in mean],
        "max_px": max(error.largest for error in errors),
    }
