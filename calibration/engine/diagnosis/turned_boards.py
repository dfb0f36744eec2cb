"""Report of views of a board that were numbered from its other end."""

from calibration.engine.dataset.pattern import CIRCLE_KINDS, PatternKind
from calibration.engine.diagnosis.finding import Finding
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.start.turned_boards import LOOKS_THE_SAME

MAX_NAMED_COLLECTIONS = 8
"""Number of collections that a message names."""


def turned_boards(calibration: Calibration) -> tuple[Finding, ...]:
    """Report by pattern and sensor the views that were turned back."""
    findings = []
    for pattern, sensor in dict.fromkeys((p, s) for p, s, _ in calibration.turned_views):
        keys = tuple(key for p, s, key in calibration.turned_views if (p, s) == (pattern, sensor))
        listed = ", ".join(keys[:MAX_NAMED_COLLECTIONS]) + (
            f" and {len(keys) - MAX_NAMED_COLLECTIONS} more" if keys[MAX_NAMED_COLLECTIONS:] else ""
        )
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
