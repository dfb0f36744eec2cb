"""Checks of a calibration that need no ground truth, in the order of the report."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.pattern import CIRCLE_KINDS, PatternKind
from calibration.engine.diagnosis.conventions.trying import conventions, doubts
from calibration.engine.diagnosis.description import exchanged_or_scaled, far_from_description
from calibration.engine.diagnosis.finding import Finding, FindingKind, first_names
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.diagnosis.precision import camera_info, precision, too_few
from calibration.engine.diagnosis.projection import of_cameras_alone, projection
from calibration.engine.diagnosis.rejected_labels import rejected_labels, wrong_views
from calibration.engine.diagnosis.residuals import residuals
from calibration.engine.diagnosis.robot_tasks import unsure_tasks
from calibration.engine.diagnosis.what_does_not_fit import what_does_not_fit
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.options import Options
from calibration.engine.estimation.start.ambiguous_views import LOOKS_THE_SAME
from calibration.engine.tasks.task_errors import TaskError


@dataclass(frozen=True, eq=False)
class Judged:
    """What a check is told: a calibration, and what the checks before it have found."""

    calibration: Calibration
    description: Dataset
    options: Options
    limits: Limits
    tasks: Sequence[TaskError] = ()
    found: tuple[Finding, ...] = ()


@dataclass(frozen=True, eq=False)
class Check:
    """A check, and on what it is made."""

    find: Callable[[Judged], tuple[Finding, ...]]
    unless: tuple[FindingKind, ...] = ()
    """Findings of the checks before it that explain what it would find."""
    without_result: bool = False
    """Whether it is made where no minimum was reached too."""
    with_truth: bool = True
    """Whether it is made where the result is compared with ground truth, which measures its error."""


def diagnose(
    calibration: Calibration,
    description: Dataset,
    options: Options,
    limits: Limits,
    truth_known: bool = False,
    tasks: Sequence[TaskError] = (),
) -> tuple[Finding, ...]:
    """Run all checks of a calibration and return their findings.

    Args:
        calibration: the result.
        description: the dataset with the robot's description, without the noise of an initial guess.
        options: options of the calibration.
        limits: limits of its errors.
        truth_known: whether it is also compared with ground truth, which measures its error.
        tasks: errors of the robot's tasks.
    """
    judged = Judged(calibration, description, options, limits, tasks)
    for check in CHECKS:
        made = (calibration.converged or check.without_result) and (check.with_truth or not truth_known)
        if made and not any(each.kind in check.unless for each in judged.found):
            judged = replace(judged, found=(*judged.found, *check.find(judged)))
    if doubts(calibration, judged.found) and (named := conventions(calibration, description, options)):
        return (*missing_files(calibration.dataset), *named)  # all else is its consequence
    return judged.found


def _not_determined(judged: Judged) -> tuple[Finding, ...]:
    """Report what is left out of the result because the data do not determine it."""
    calibration = judged.calibration
    if not calibration.not_determined:
        return ()
    text = (
        f"only the poses of the sensors relative to each other are calibrated, from what they see together; where they "
        f"are on the robot is not: '{calibration.gauge}' is held where the robot's description puts it, for "
        f"{calibration.not_determined}"
    )
    return (Finding("not-determined", "warning", text),)


def _residuals_of_robot(judged: Judged) -> tuple[Finding, ...]:
    return () if judged.calibration.of_cameras_alone else residuals(judged.calibration)


def _residuals_of_cameras_alone(judged: Judged) -> tuple[Finding, ...]:
    calibration = judged.calibration
    return of_cameras_alone(calibration, judged.limits, residuals(calibration)) if calibration.of_cameras_alone else ()


def _said_by_the_engine(judged: Judged) -> tuple[Finding, ...]:
    """Report warnings of the least-squares solver."""
    calibration = judged.calibration
    return (
        *(Finding("contradicted-prior", "warning", text) for text in calibration.warnings),
        *(Finding("weak-direction", "note", f"weakly determined: {text}") for text in calibration.weak_directions),
        *(Finding("engine", "note", text) for text in calibration.notes),
    )


CHECKS = (
    Check(lambda judged: missing_files(judged.calibration.dataset), without_result=True),
    Check(_not_determined),
    Check(lambda judged: turned_boards(judged.calibration)),
    Check(lambda judged: exchanged_or_scaled(judged.calibration, judged.description, judged.options)),
    Check(lambda judged: what_does_not_fit(judged.calibration, judged.limits, judged.tasks)),
    Check(lambda judged: wrong_views(judged.calibration, judged.limits), without_result=True),
    Check(_residuals_of_robot, unless=("suspect", "contradiction")),
    Check(_residuals_of_cameras_alone),
    Check(lambda judged: too_few(judged.calibration), with_truth=False),
    Check(lambda judged: precision(judged.calibration, judged.limits, judged.found), with_truth=False),
    Check(lambda judged: unsure_tasks(judged.tasks, judged.found)),
    Check(lambda judged: projection(judged.calibration, judged.limits)),
    Check(
        lambda judged: far_from_description(judged.calibration, judged.description, judged.options),
        unless=("exchanged-sensors", "pattern-size"),
    ),
    Check(lambda judged: rejected_labels(judged.calibration, judged.limits)),
    Check(lambda judged: repeated(judged.calibration)),
    Check(lambda judged: camera_info(judged.calibration)),
    Check(_said_by_the_engine, without_result=True),
)
"""In the order of the report; a check sees what those before it have found."""


MAX_NAMED_COLLECTIONS = 8
"""Number of collections that a message names."""


def missing_files(dataset: Dataset) -> tuple[Finding, ...]:
    """Report the labels that are left out because their files are missing, by sensor."""
    return tuple(
        Finding(
            "missing-files",
            "warning",
            f"{dataset.missing_files_of(sensor)}; "
            + (
                "its labels in these are left out"
                if sensor in dataset.sensors
                else "it is not calibrated, and stays where the robot's description puts it"
            ),
            sensors=(sensor,),
            value=float(len(files)),
        )
        for sensor, files in dataset.missing_files.items()
    )


def turned_boards(calibration: Calibration) -> tuple[Finding, ...]:
    """Report by pattern and sensor the views that were turned back."""
    findings = []
    for pattern, sensor in dict.fromkeys((p, s) for p, s, _ in calibration.turned_views):
        keys = tuple(key for p, s, key in calibration.turned_views if (p, s) == (pattern, sensor))
        listed = first_names(keys, MAX_NAMED_COLLECTIONS)
        views = len(calibration.dataset.detections(pattern, sensor))
        text = (
            f"{sensor}: {len(keys)} of {views} views of '{pattern}' are numbered from its other end ({listed}), and "
            f"were turned back: {LOOKS_THE_SAME}; take "
            f"{_describe_unique_board(calibration.dataset.patterns[pattern].kind)}"
        )
        findings.append(Finding("turned-board", "warning", text, (sensor,), keys, value=float(len(keys))))
    return tuple(findings)


def _describe_unique_board(kind: PatternKind) -> str:
    if kind in CIRCLE_KINDS:
        return "an asymmetric grid with an odd number of rows, or a charuco board"
    return "one with an odd and an even number of squares, or a charuco board"


def repeated(calibration: Calibration) -> tuple[Finding, ...]:
    """Report the number of collections that repeat the poses of others."""
    keys, clusters = calibration.solution.dataset.keys, calibration.solution.clusters
    again = np.flatnonzero(clusters != np.arange(len(clusters))).tolist()
    if not again:
        return ()
    listed = first_names([f"{keys[i]} = {keys[clusters[i]]}" for i in again], MAX_NAMED_COLLECTIONS)
    text = (
        f"{len(again)} of {len(keys)} collections repeat the poses of others ({listed}); they tell noise, but "
        f"nothing new about the robot: {len(keys) - len(again)} count"
    )
    return (Finding("repeated", "note", text, collections=tuple(keys[i] for i in again), value=float(len(again))),)
