"""What came of a collection in simulation: the verdict, ``results.json``, a table of poses, JUnit."""

import csv
import dataclasses
import io
import math
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from calibration import records
from calibration.errors import ExitCode
from calibration.records import at_least, between, field
from calibration.report import Outcome

if TYPE_CHECKING:
    from calibration.simulation.collection.proof import Proof
    from calibration.simulation.collection.record import CornerErrors, Record
    from calibration.simulation.scenarios.result import ScenarioResult

SCHEMA = Path(__file__).with_name("collection.schema.json")
FILE = "results.json"
POSES_FILE = "poses.csv"
SUMMARY_FILE = "summary.md"
CONTACT_SHEET = "contact_sheet.png"


Share = Annotated[float, between(0, 1)]


@records.record
class CollectionChecks:
    """What a collected dataset has to keep to; None where there is no limit."""

    minimum_collections: Annotated[int, at_least(1)] = field("Fewer make it fail.", default=3)
    minimum_detection_rate: Share | None = field("Share of the poses that every sensor detects.", default=None)
    minimum_coverage: Share | None = field("Share of every image that the corners cover.", default=None)
    max_translation_mm: float | None = 5.0
    """Of the worst sensor against the truth, and of the worst length of a joint."""
    max_rotation_deg: float | None = 0.3
    """Likewise, of the worst angle."""


@dataclass(frozen=True)
class Check:
    """One number against its limit."""

    name: str
    value: float | None
    limit: float
    at_least: bool
    """Whether the limit is the least value that passes, or the largest."""
    unit: str = ""

    @property
    def passed(self) -> bool:
        """A number that is missing or not finite does not pass."""
        if self.value is None or not math.isfinite(self.value):
            return False
        return self.value >= self.limit if self.at_least else self.value <= self.limit

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        found = "no value" if self.value is None else f"found {self.value:.4g}{unit}"
        return f"{self.name}: {found}, {'at least' if self.at_least else 'at most'} {self.limit:g}{unit} was expected"


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
        Check(f"{kind} error against the truth", value, limit, at_least=False, unit=unit)
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
        checks = [Check("collections", len(self.kept), limits.minimum_collections, at_least=True)]
        for name, numbers in self.sensors.items():
            if limits.minimum_detection_rate is not None:
                rate = numbers.detection_rate
                checks.append(Check(f"detection rate of {name}", rate, limits.minimum_detection_rate, at_least=True))
            if limits.minimum_coverage is not None and numbers.coverage is not None:
                checks.append(Check(f"coverage of {name}", numbers.coverage, limits.minimum_coverage, at_least=True))
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
    def verdict(self) -> Literal["pass", "fail"]:
        """Pass when the dataset calibrates and every check passes."""
        return "fail" if self.reasons else "pass"

    @property
    def exit_code(self) -> ExitCode:
        """The verdict's, or that of what went wrong."""
        if self.error is not None:
            return self.error
        return ExitCode.PASS if self.verdict == "pass" else ExitCode.FAIL


def _sensor_numbers(name: str, modality: str, results: CollectionResults) -> SensorNumbers:
    from calibration.simulation.collection.record import COLUMNS, ROWS

    records, kept = results.records, results.kept
    detected = [record for record in records if record.labels[name]]
    camera = modality == "rgb"
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


def collection_document(results: CollectionResults) -> dict[str, Any]:
    """The content of ``results.json``. No times: the same input gives the same bytes."""
    return {
        "schema": 1,
        "verdict": results.verdict,
        "system": results.system,
        "seed": results.seed,
        "motion": results.motion,
        "poses": len(results.records),
        "kept": len(results.kept),
        "lost": [{"pose": record.number + 1, "reasons": list(record.lost)} for record in results.lost],
        "sensors": {name: asdict(numbers) for name, numbers in results.sensors.items()},
        "corner_rms_px": results.corner_rms,
        "calibration": _calibration(results.proof) if results.proof else None,
        "checks": [{**asdict(check), "passed": check.passed} for check in results.checks],
        "reasons": results.reasons,
        "dataset": "dataset.json" if results.kept else None,
        "contact_sheet": CONTACT_SHEET if results.contact_sheet else None,
        "made_with": _made_with(),
    }


def _calibration(proof: "Proof") -> dict[str, Any]:
    document = asdict(proof)
    if not proof.joints:
        del document["joints"]
    return document


def _made_with() -> dict[str, str]:
    import cv2
    import numpy as np

    from calibration import __version__

    return {"calibration": __version__, "numpy": np.__version__, "opencv": cv2.__version__}


def poses_csv(results: CollectionResults) -> str:
    """One row for each pose: whether it was kept, and what each sensor labelled."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    cameras = [name for name, modality in results.modalities.items() if modality == "rgb"]
    labels = [f"{name} labels" for name in results.modalities]
    errors = [f"{name} RMS error (pix)" for name in cameras]
    writer.writerow(["Collection #", "Pose", "Kept", *labels, *errors, "Reasons"])
    for record in results.records:
        rms = [f"{record.errors[name].rms:.4f}" if name in record.errors else "" for name in cameras]
        counts = [record.labels[name] for name in results.modalities]
        kept = "yes" if record.kept else "no"
        writer.writerow([record.key, record.number + 1, kept, *counts, *rms, "; ".join(record.lost)])
    return text.getvalue()


def junit(results: CollectionResults) -> str:
    """The checks as JUnit XML."""
    from calibration.report.junit import junit_xml  # XML is slow to import

    calibrates = () if results.proof and results.proof.converged else tuple(results.reasons)
    outcomes = [Outcome(name="the dataset calibrates", group=results.system, reasons=calibrates)]
    outcomes += [
        Outcome(name=c.name, group=results.system, reasons=() if c.passed else (str(c),)) for c in results.checks
    ]
    return junit_xml({f"collect-data-sim {results.system}": outcomes})
