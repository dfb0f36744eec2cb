"""Cell of the matrix, one system from one noisy initial guess; comparison with a method on its data; their results."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from calibration.base import number_text
from calibration.base.records import computed, field, record, result
from calibration.ci.report import Verdict
from calibration.ci.report.junit import ErrorCode
from calibration.engine.baseline.calibration_document import CalibrationDocument
from calibration.engine.baseline.comparison import BaselineChange
from calibration.engine.diagnosis.finding import Finding, FindingKind
from calibration.engine.estimation.covariance.error_bars import SourceKind
from calibration.engine.estimation.covariance.lens_errors import LensSource
from calibration.engine.estimation.covariance.result import DroppedView, RejectedLabel
from calibration.engine.estimation.least_squares.noise_levels import NoiseLevels
from calibration.engine.estimation.options import Loss, Start
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.engine.tasks.robot_task import TaskUnit
from calibration.pipeline.containers import SOFTWARE_METHOD
from calibration.pipeline.matrix.next_poses_result import NextPoses

TaskState = Literal["holds", "broken", "undecided"] | None
"""Whether the limit of a task holds."""
REPROJECTION_FILE = "reprojection.csv"
"""Default table, of a system that names none."""


@dataclass(frozen=True)
class Cell:
    """System and initial guess of a cell."""

    system: str
    noise: StartingNoise
    start: Start = "linear"
    loss: Loss = "huber"

    @property
    def folder(self) -> str:
        """Folder of its files, relative to the output folder."""
        return f"{self.system}/{noise_folder(self.noise)}"

    def __str__(self) -> str:
        n = self.noise
        return f"{self.system}, {noise_text(n.translation, n.rotation)}, seed {n.seed}"


@dataclass(frozen=True)
class Comparison:
    """Comparison method on a system's data."""

    system: str
    method: str
    noise: StartingNoise | None
    """Noise of the initial guess, of a method that uses one; else None."""

    @property
    def folder(self) -> str:
        """Folder of its files, relative to the output folder."""
        folder = f"{self.system}/{self.method}"
        return folder if self.noise is None else f"{folder}/{noise_folder(self.noise)}"


def noise_folder(noise: StartingNoise) -> str:
    """Return the name of the folder for results of an initial guess."""
    return f"translation-{number_text(noise.translation)}_rotation-{number_text(noise.rotation)}_seed-{noise.seed}"


def noise_text(translation: float, rotation: float) -> str:
    """Format a pair of noises with all digits: "0.5 m, 0.1 rad"."""
    return f"{number_text(translation)} m, {number_text(rotation)} rad"


OUR_METHOD = "calibration-ci"
REASSURING_KINDS: tuple[FindingKind, ...] = ("nothing-suspicious", "baseline-unmoved")
"""Kinds of findings that say that all is well."""


@record(case="snake", unknown="ignore")
class Deviation:
    """Largest errors of sensors and joints: against the truth, gauge removed, or by the calibration's covariance."""

    translation_mm: float = field("The worst of the sensors, the norm of three axes.")
    rotation_deg: float = field("The worst of the sensors, the norm of three axes.")
    joint_mm: float | None = field("The worst of the joints' parameters that are lengths.", default=None)
    joint_deg: float | None = field("The worst of the joints' parameters that are angles.", default=None)


@result
class ParameterResult:
    """Calibrated parameter of a joint, a camera, or the lag of a sensor."""

    name: str = field("The joint or the sensor.")
    parameter: str = field("Name of the parameter.")
    value: float = field("The calibrated value.")
    unit: Literal["m", "rad", "px", "1", "s"] = field("Of value and sigma.")
    sigma: float | None = field("Standard deviation; null if it did not converge.")


@result
class TransformResult:
    """Calibrated transform."""

    parent: str = field("The parent frame.")
    child: str = field("The child frame.")
    trans: tuple[float, ...] = field("Translation.", unit="m")
    quat: tuple[float, ...] = field("Rotation, a quaternion xyzw.")
    sigma_mm: float | None = field("Standard deviation of the translation, the norm of three axes.", unit="mm")
    sigma_mrad: float | None = field("Standard deviation of the rotation, the norm of three axes.", unit="mrad")
    rpy: tuple[float, ...] = field("The rotation as roll, pitch and yaw, as a URDF has it.", unit="rad", default=())
    sigma_trans: tuple[float, ...] | None = field(
        "Standard deviation of each coordinate of the translation; null if it was fixed.", unit="m", default=None
    )
    sigma_rpy: tuple[float, ...] | None = field("Standard deviation of roll, pitch and yaw.", unit="rad", default=None)
    moved_mm: float | None = field(
        "Distance of the translation from the dataset's own; null if that carries no information.",
        unit="mm",
        default=None,
    )
    moved_deg: float | None = field("The angle to the dataset's own rotation.", unit="degrees", default=None)


@result
class ProjectionResult:
    """Standard deviation of the projection of a camera, in its worst direction, over its image."""

    camera: str = field("The camera.")
    model: str = field("Its lens model.")
    width: int = field("Of its images.", unit="px")
    height: int = field("Of its images.", unit="px")
    distance_m: float = field("Median distance of the pattern.", unit="m")
    median_px: float = field("Median over the image where corners were seen, for points at that distance.", unit="px")
    most_px: float = field("What nine tenths of these do not exceed, which is judged.", unit="px")
    worst_px: float = field("The largest of these.", unit="px")
    far_median_px: float = field("The median for points far away.", unit="px")
    far_worst_px: float = field("The largest of these.", unit="px")
    seen: float = field("Part of the image, of its cells, in which there are corners.")
    columns: int = field("Number of columns of cells.")
    near_px: tuple[float, ...] = field(
        "Of each cell, row by row, for points at the pattern's distance; 0 where the lens has no ray.", unit="px"
    )
    far_px: tuple[float, ...] = field("The same for points far away.", unit="px")
    given: LensSource | None = field(
        "By what intrinsics that are given are uncertain: nominal (a usual calibration), assume, their covariance or "
        "standard-deviations; null for calibrated ones.",
        default=None,
    )


@result
class TaskPart:
    """Part of a task's standard deviation at its worst point."""

    source: SourceKind = field("What it comes from.")
    sigma: float = field("In the task's unit; the squares of all parts add up.")


@result(kw_only=True)
class TaskResult:
    """Error of a task of the robot."""

    name: str = field("The task.")
    unit: TaskUnit = field("Of the errors and the limit.")
    limit: float | None = field("The largest that passes.", default=None)
    state: TaskState = field(
        "holds, broken, undecided, by its limit and by what does not fit; null without a limit.", default=None
    )
    median: float = field("At the worst point, what the error does not exceed with a probability of one half.")
    most: float = field("At the worst point, what it does not exceed in 95 % of cases, which is judged.")
    typical: float = field("The median of that over all points.")
    worst: str = field("The worst point.")
    parts: tuple[TaskPart, ...] = field("What it comes from, largest first.")
    frame: str = field("The frame in which it counts.")
    truth: float | None = field("The largest error at its points against the truth, if that is known.", default=None)
    within: float | None = field(
        "Share of its points whose error against the truth is within what it does not exceed in 95 %.", default=None
    )


@result(kw_only=True)
class TaskMap:
    """Error of a task at all of its points."""

    name: str = field("The task.")
    columns: int | None = field("Points in a row, of those that are spread over an image; null in a space.")
    points: tuple[tuple[float, ...], ...] = field("Pixels, or m in the frame in which the error counts.")
    most: tuple[float | None, ...] = field(
        "What the error does not exceed in 95 % of cases, in the worst pose; null where the sensors do not see it."
    )


@result
class Worth:
    """Contribution of a fixed parameter's usual uncertainty to the result."""

    cause: str = field("What is held.")
    mm: float = field("Largest displacement of a transform.", unit="mm")


@result(kw_only=True)
class RecordingResult:
    """Recording that was calibrated."""

    dataset: str = field("Its path.")
    collections: int = field("Number of its collections.")
    sensors: tuple[str, ...] = field("Its sensors.")
    patterns: tuple[str, ...] = field("Its patterns: kind, corners, and how far these are apart.")


@result(kw_only=True)
class Details:
    """Details of a calibration, in a cell's own results but not in those of the matrix."""

    transforms: tuple[TransformResult, ...] = field("In the cell's own results: the transforms.", default=())
    joints: tuple[ParameterResult, ...] = field("In the cell's own results: those of joints.", default=())
    intrinsics: tuple[ParameterResult, ...] = field("In the cell's own results: those of cameras.", default=())
    lags: tuple[ParameterResult, ...] = field(
        "In the cell's own results: how much later sensors saw than the transforms of their collections say.",
        default=(),
    )
    projection: tuple[ProjectionResult, ...] = field(
        "In the cell's own results: how sure intrinsics are, in the image.", default=()
    )
    iterations: int | None = field("Of the solver.", default=None)
    cost: float | None = field("Half the weighted sum of squares.", default=None)
    degrees_of_freedom: int | None = field("Residuals less parameters.", default=None)
    noise_levels: NoiseLevels | None = field("Standard deviations of the labels.", default=None)
    held: str | None = field("Sensor that is fixed because only relative poses are known.", default=None)
    weak_directions: tuple[str, ...] = field("Directions that the data hardly determine.", default=())
    rejected_labels: tuple[RejectedLabel, ...] = field("Labels that do not fit.", default=())
    dropped_views: tuple[DroppedView, ...] = field("Views that contradict the others and were left out.", default=())
    effective_collections: float | None = field(
        "Number of independent collections of equal weight with the same information.", default=None
    )
    hangs_on: tuple[Worth, ...] = field("Contributions to the uncertainty of the result, largest first.", default=())
    task_maps: tuple[TaskMap, ...] = field("In the cell's own results: tasks at all of their points.", default=())
    recording: RecordingResult | None = field("What was calibrated.", default=None)
    snapshot: CalibrationDocument | None = field("The result as `calibration accept` keeps it.", default=None)
    changes: tuple[BaselineChange, ...] = field("Differences from the accepted calibration.", default=())
    next_poses: NextPoses | None = field("What to record next, where a limit is undecided.", default=None)

    @property
    def of_cameras_alone(self) -> bool:
        """Whether only intrinsics are calibrated."""
        return bool(self.intrinsics) and not self.transforms


@result(kw_only=True)
class CellResult:
    """Result of a cell, or of a comparison method on a system's data."""

    system: str = field("The system that was calibrated.")
    method: str = field("calibration-ci, software (the team's own), or another method.")
    translation_noise: float | None = field("None for another method that takes no start.", unit="m")
    rotation_noise: float | None = field("Of the start.", unit="rad")
    seed: int | None = field("Of the noise.")
    start: str | None = field("linear or given.")
    loss: str | None = field("huber or linear.", default=None)
    converged: bool = field("Whether an optimum was found.")
    rms_px: float | None = field("Averages of the table, or of the reprojected corners.", unit="px")
    poses: Deviation | None = field(
        "Averages of the table of measured poses: how far they are from those of the result.", default=None
    )
    table: str | None = field("The CSV, relative to the output folder.")
    dataset: str | None = field("The calibrated dataset, relative to the output folder.")
    folder: str | None = field("Folder of its own files, relative to the output folder.", default=None)
    truth: Deviation | None = field("Distance of the calibration from the truth, if that is known.")
    seconds: float = field("Duration.")
    reasons: tuple[str, ...] = field("Reasons of a fail verdict.", default=())
    undecided: tuple[str, ...] = field(
        "Reasons of an undecided verdict: limits that the error bars reach over, with what would decide them.",
        default=(),
    )
    undecided_passes: bool = field("Whether an undecided verdict counts as passed (`undecided: pass`).", default=False)
    error: ErrorCode | None = field("Exit code of a cell that could not be calibrated.", default=None)
    warnings: tuple[str, ...] = field("Warnings.", default=())
    findings: tuple[Finding, ...] = field(
        "What speaks for and against the calibration. The red ones are among the reasons, the undecided ones among "
        "those of that name, the warnings among the warnings.",
        default=(),
    )
    tasks: tuple[TaskResult, ...] = field("Errors of the robot's tasks.", default=())
    details: Details | None = field(flat=True, default=None)
    sigma: Deviation | None = field("Standard deviations that our engine states, in all.", default=None)
    label_sigma: Deviation | None = field("Largest standard deviations by the noise of the labels alone.", default=None)
    false_accept: float | None = field(
        "Probability that a sensor is off by more than the limits, by the standard deviations in all.", default=None
    )
    detail: str | None = field("Implementation of another method, and the data that it uses.", default=None)

    @property
    @computed()
    def verdict(self) -> Verdict:
        """Fail if there is a reason to, else undecided if a limit is."""
        if not self.converged or self.reasons:
            return "fail"
        return "undecided" if self.undecided else "pass"

    @property
    def passes(self) -> bool:
        """Whether the cell counts as passed: by its verdict, or undecided where the configuration lets that pass."""
        return self.verdict == "pass" or (self.verdict == "undecided" and self.undecided_passes)

    @property
    def all_reasons(self) -> tuple[str, ...]:
        """Why the verdict is not pass, worst first."""
        return (*self.reasons, *self.undecided)

    @property
    def uncontradicted_findings(self) -> tuple[Finding, ...]:
        """The findings; of a failed cell without those that say that all is well."""
        if self.verdict != "fail":
            return self.findings
        return tuple(each for each in self.findings if each.kind not in REASSURING_KINDS)

    @property
    def by_other_method(self) -> bool:
        """Whether it is from a comparison method; it is not judged."""
        return self.method not in (OUR_METHOD, SOFTWARE_METHOD)

    @property
    def start_of_cell(self) -> tuple[str, float | None, float | None, int | None]:
        """Key of the initial guess, equal for all results from it."""
        return (self.system, self.translation_noise, self.rotation_noise, self.seed)

    @property
    def own_folder(self) -> str | None:
        """`folder`; of results of an older version, which have none, that of the dataset."""
        return self.folder or (str(Path(self.dataset).parent) if self.dataset else None)

    @property
    def name(self) -> str:
        """Name in messages."""
        if self.translation_noise is None or self.rotation_noise is None:
            return f"{self.system}, {self.method}"
        who = f"{self.system}, {self.method}" if self.by_other_method else self.system
        return f"{who}, {noise_text(self.translation_noise, self.rotation_noise)}, seed {self.seed}"

    def failing(self, *reasons: str) -> "CellResult":
        """Return the result with additional reasons to fail."""
        return replace(self, reasons=(*self.reasons, *reasons))

    def found(self, findings: tuple[Finding, ...]) -> "CellResult":
        """Return the result with additional findings, each once, and their reasons and warnings."""
        known = {each.text for each in self.findings}
        findings = tuple({each.text: each for each in findings if each.text not in known}.values())
        texts: dict[str, list[str]] = {"red": [], "undecided": [], "warning": [], "note": []}
        for each in findings:
            texts[each.severity].append(each.text)
        return replace(
            self,
            findings=(*self.findings, *findings),
            reasons=(*self.reasons, *texts["red"]),
            undecided=(*self.undecided, *texts["undecided"]),
            warnings=(*self.warnings, *texts["warning"]),
        )

    def explained(self, findings: tuple[Finding, ...], *instead: Finding) -> "CellResult":
        """Return the result with findings that explain its reasons, which only follow from them."""
        return replace(self, reasons=()).found((*findings, *instead))


def nothing_yet(cell: Cell, method: str = OUR_METHOD, start: str | None = None) -> CellResult:
    """Empty result, for a cell that has not run."""
    loss = cell.loss if method == OUR_METHOD else None
    return _empty_result(cell.system, method, cell.noise, start or cell.start, loss)


def nothing_by_other_method(comparison: Comparison) -> CellResult:
    """Empty result, for a comparison method that has not run."""
    start = "given" if comparison.noise else None
    return _empty_result(comparison.system, comparison.method, comparison.noise, start, None)


def _empty_result(
    system: str, method: str, noise: StartingNoise | None, start: str | None, loss: str | None
) -> CellResult:
    return CellResult(
        system=system,
        method=method,
        translation_noise=noise.translation if noise else None,
        rotation_noise=noise.rotation if noise else None,
        seed=noise.seed if noise else None,
        start=start,
        loss=loss,
        converged=False,
        rms_px=None,
        table=None,
        dataset=None,
        truth=None,
        seconds=0.0,
    )


def for_cell(result: CellResult, cell: Cell, iterations: int) -> CellResult:
    """Return a result as that of another cell, which has come to the same calibration.

    Args:
        result: the result of the first of these cells.
        cell: another one of the same system.
        iterations: number of the solver's iterations from its start.
    """
    noise, details = cell.noise, result.details
    if details is not None and details.iterations != iterations:
        snapshot = details.snapshot and replace(details.snapshot, iterations=iterations)
        details = replace(details, iterations=iterations, snapshot=snapshot)
    return replace(
        result,
        translation_noise=noise.translation,
        rotation_noise=noise.rotation,
        seed=noise.seed,
        details=details,
    )
