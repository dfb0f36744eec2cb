"""Results of a collection: numbers, checks and verdict, of one dataset and of many scenarios."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from dataclasses import field as dataclass_field
from functools import cached_property

from calibration.base import ExitCode, exit_code_of
from calibration.base.records import field, result
from calibration.ci.report import Check, Verdict, at_least, at_most, count_of, verdict_of
from calibration.engine.dataset.modalities import MODALITIES
from calibration.pipeline.collection.request import CollectionChecks, CollectionLimits, ScenarioRequest
from calibration.robot.simulation.proof import Proof
from calibration.robot.simulation.record import COVERAGE_COLUMNS, COVERAGE_ROWS, CornerErrors, Record
from calibration.robot.simulation.scenarios.scenario import ScenarioResult
from calibration.robot.simulation.scenarios.statistics import Statistics


def truth_checks(found: Proof | ScenarioResult | None, limits: CollectionLimits) -> list[Check]:
    """Check the errors of sensors, and of joints if some were calibrated, against their limits."""
    errors = (
        ("translation", "translation_mm", limits.translation_mm, "mm"),
        ("joint translation", "joint_mm", limits.translation_mm, "mm"),
        ("rotation", "rotation_deg", limits.rotation_deg, "deg"),
        ("joint rotation", "joint_deg", limits.rotation_deg, "deg"),
    )
    values = ((kind, getattr(found, key) if found else None, limit, unit) for kind, key, limit, unit in errors)
    return [
        at_most(f"{kind} error against the truth", value, limit, unit)
        for kind, value, limit, unit in values
        if limit is not None and (value is not None or not kind.startswith("joint"))
    ]


@result
class CornerError:
    """Errors of detected corners against the true ones."""

    corners: int = field("How many.")
    rms_px: float = field("Root mean square.", unit="px")
    bias_px: tuple[float, ...] = field("Mean of both coordinates.", unit="px")
    max_px: float = field("The largest.", unit="px")

    @classmethod
    def of(cls, errors: Sequence[CornerErrors]) -> "CornerError | None":
        """Combine the errors of several views; None if there are none."""
        count = sum(error.count for error in errors)
        if not count:
            return None
        mean = [sum(error.count * error.mean[axis] for error in errors) / count for axis in (0, 1)]
        rms = math.sqrt(sum(error.count * error.rms**2 for error in errors) / count)
        return cls(
            count, round(rms, 5), tuple(round(value, 5) for value in mean), max(error.largest for error in errors)
        )


@result
class SensorNumbers:
    """Statistics of one sensor over all poses."""

    modality: str = field("rgb, depth, lidar3d, lidar2d.")
    detected: int = field("In how many poses.")
    detection_rate: float = field("Share of the poses, 0 to 1.")
    partial: int = field("Of a camera: in how many poses it saw only a part of a pattern.")
    labels: int = field("Corners or points, over the collections that were kept.")
    corner_error: CornerError | None = field("Of a camera that detected something.")
    coverage: float | None = field(
        "The share of a grid over a camera's image where a corner was seen in a collection that was kept."
    )


@result
class LostPose:
    """Pose that is not in the dataset."""

    pose: int = field("Counted from 1.")
    reasons: tuple[str, ...] = field("Why.")


@result(kw_only=True)
class CollectionDocument:
    """Results of collect-data-sim: one dataset."""

    system: str = field("The system.")
    seed: int = field("Of everything that is drawn.")
    motion: str = field("A file, or how it was generated.")
    poses: int = field("Of the motion.")
    kept: int = field("The collections in the dataset.")
    lost: tuple[LostPose, ...] = field("The poses that are not in the dataset.")
    sensors: Mapping[str, SensorNumbers] = field("By name.")
    corner_rms_px: float | None = field("All corners in the dataset against the true ones.", unit="px")
    calibration: Proof | None = field("Of the dataset, from its linear start; null where no collection was kept.")
    checks: tuple[Check, ...] = field("Every limit with what was found.")
    reasons: tuple[str, ...] = field("Reasons of a fail verdict.")
    dataset: str | None = field("Beside this file; null where no collection was kept.")
    contact_sheet: str | None = field("A picture of all images, where they are known.")
    made_with: Mapping[str, str] = field("Versions that the bytes hang on.")


@dataclass(frozen=True)
class CollectionResults:
    """Records of all poses, and the result of the dataset's calibration."""

    system: str
    seed: int
    motion: str
    modalities: dict[str, str]
    """Modality of each sensor."""
    records: tuple[Record, ...]
    proof: Proof | None
    """Calibration of the dataset that proves it usable; None if no collection was kept."""
    limits: CollectionChecks = dataclass_field(default_factory=CollectionChecks().with_usual_limits)
    failures: tuple[str, ...] = ()
    """Failures of a team's applications."""
    error: ExitCode | None = None
    """Set if the applications are not the cause: a wrong image (2), the engine or the time (3)."""
    contact_sheet: bool = True
    """Whether there is a contact sheet; without a system's description the images are unknown."""

    @property
    def kept(self) -> list[Record]:
        """Records of the collections in the dataset."""
        return [record for record in self.records if record.kept]

    @property
    def lost(self) -> list[Record]:
        """Records of the poses that are not in the dataset."""
        return [record for record in self.records if not record.kept]

    @cached_property
    def sensors(self) -> dict[str, SensorNumbers]:
        """Statistics by sensor."""
        return {name: _sensor_numbers(name, modality, self) for name, modality in self.modalities.items()}

    @property
    def corner_rms(self) -> float | None:
        """RMS error of all corners in the dataset against the truth, px."""
        error = CornerError.of([error for record in self.kept for error in record.errors.values()])
        return error.rms_px if error else None

    @cached_property
    def checks(self) -> list[Check]:
        """Checks of the limits, each with its value."""
        limits, proof = self.limits, self.proof
        checks = [at_least("collections", len(self.kept), limits.minimum_collections)]
        for name, numbers in self.sensors.items():
            if limits.minimum_detection_rate is not None:
                rate = numbers.detection_rate
                checks.append(at_least(f"detection rate of {name}", rate, limits.minimum_detection_rate))
            if limits.minimum_coverage is not None and numbers.coverage is not None:
                checks.append(at_least(f"coverage of {name}", numbers.coverage, limits.minimum_coverage))
        return checks + truth_checks(proof, limits.limits)

    @property
    def reasons(self) -> list[str]:
        """Reasons of a fail verdict; empty if it is pass."""
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
        """Exit code of the verdict, or of the error."""
        return exit_code_of(self.verdict == "pass", [self.error])


def _sensor_numbers(name: str, modality: str, results: CollectionResults) -> SensorNumbers:
    records, kept = results.records, results.kept
    detected = [record for record in records if record.labels[name]]
    camera = MODALITIES[modality].has_corners
    return SensorNumbers(
        modality=modality,
        detected=len(detected),
        detection_rate=round(len(detected) / len(records), 4) if records else 0.0,
        partial=sum(not record.complete[name] for record in detected) if camera else 0,
        labels=sum(record.labels[name] for record in kept),
        corner_error=CornerError.of([each.errors[name] for each in kept if name in each.errors]) if camera else None,
        coverage=round(len({c for r in kept for c in r.cells[name]}) / (COVERAGE_COLUMNS * COVERAGE_ROWS), 4)
        if camera
        else None,
    )


@dataclass(frozen=True)
class ScenarioResults:
    """Results of the scenarios, and the verdict on them."""

    system: str
    request: ScenarioRequest
    statistics: Statistics
    errors: Mapping[str, ExitCode] = dataclass_field(default_factory=dict)
    """Scenarios that could not run, by id: bad input (2) or an infrastructure failure (3). They count as failed."""
    drivers: Mapping[str, str] = dataclass_field(default_factory=dict)
    """What drives the errors beyond their error bars, by scenario, where it was looked for."""

    @cached_property
    def failed(self) -> dict[str, list[str]]:
        """Failed scenarios by id, with the reasons."""
        checks = self.request.collection.effective_checks
        return {result.id: why for result in self.statistics.results if (why := scenario_reasons(result, checks))}

    @property
    def findings(self) -> list[str]:
        """Scenarios whose error is beyond what is stated, worst first, with what drives it."""
        return [
            f"scenario {each.id}: off by {each.error_sigmas:.1f} of its stated standard deviations "
            f"({each.translation_mm:.3g} mm); driver: {self.drivers.get(each.id, 'not looked for')}"
            for each in self.statistics.beyond_error_bars
        ]

    @property
    def success_rate(self) -> float:
        """Share of the scenarios that pass."""
        return round(1 - len(self.failed) / len(self.statistics.results), 6)

    @property
    def reasons(self) -> list[str]:
        """Reasons of a fail verdict; empty if it is pass."""
        check = at_least("success rate", self.success_rate, self.request.minimum_success_rate)
        return [] if check.passed else [str(check)]

    @property
    def verdict(self) -> Verdict:
        """Pass if enough scenarios pass."""
        return verdict_of(not self.reasons)

    @property
    def exit_code(self) -> ExitCode:
        """Exit code of the verdict; if it is fail and some scenarios could not run, theirs, being unknown."""
        if self.verdict == "pass":
            return ExitCode.PASS
        return max(self.errors.values(), default=ExitCode.FAIL)

    @property
    def title(self) -> str:
        """Title, such as "100 scenarios of t2rgb"."""
        return f"{count_of(len(self.statistics.results), 'scenario')} of {self.system}"


def scenario_reasons(result: ScenarioResult, checks: CollectionChecks) -> list[str]:
    """Return the reasons why a scenario fails; empty if it passes."""
    if not result.converged:
        return list(result.reasons) or ["it does not calibrate"]
    limits = [at_least("collections", result.kept, checks.minimum_collections)]
    if checks.minimum_detection_rate is not None:
        for name, rate in (result.detection or {}).items():
            limits.append(at_least(f"detection rate of {name}", rate, checks.minimum_detection_rate))
    limits += truth_checks(result, checks.limits)
    return [str(check) for check in limits if not check.passed]
