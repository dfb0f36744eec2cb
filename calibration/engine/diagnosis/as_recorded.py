"""Notes on the recording itself: files that are missing, boards numbered from their other end, poses that repeat."""

import numpy as np

from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.pattern import CIRCLE_KINDS, PatternKind
from calibration.engine.diagnosis.finding import Finding, first_names
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.start.ambiguous_views import LOOKS_THE_SAME

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
