"""Check for collections that repeat the poses of others."""

import numpy as np

from calibration.engine.diagnosis.finding import Finding
from calibration.engine.estimation.covariance.result import Calibration

MAX_NAMED_COLLECTIONS = 8


def repeated(calibration: Calibration) -> tuple[Finding, ...]:
    """Report the number of collections that repeat the poses of others."""
    keys, clusters = calibration.solution.dataset.keys, calibration.solution.clusters
    again = np.flatnonzero(clusters != np.arange(len(clusters))).tolist()
    if not again:
        return ()
    pairs = [f"{keys[i]} = {keys[clusters[i]]}" for i in again]
    listed = ", ".join(pairs[:MAX_NAMED_COLLECTIONS]) + (
        f" and {len(pairs) - MAX_NAMED_COLLECTIONS} more" if pairs[MAX_NAMED_COLLECTIONS:] else ""
    )
    text = (
        f"{len(again)} of {len(keys)} collections repeat the poses of others ({listed}); they tell noise, but "
        f"nothing new about the robot: {len(keys) - len(again)} count"
    )
    return (Finding("repeated", "note", text, collections=tuple(keys[i] for i in again), value=float(len(again))),)
