"""Check that there are enough collections to judge an arm with contradicting views."""

from calibration.engine.diagnosis.finding import Finding
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.doubts.suspects import MIN_CONTRADICTING_FACTOR, disagreement

MIN_INDEPENDENT_COLLECTIONS = 7
"""Minimum of independent collections for suspects and standard deviations to explain a disagreement."""
RECOMMENDED_COLLECTIONS = "8 or more, with other rotations"
"""Recommendation of a message,"""
BETTER_OF_CAMERAS = "20 to 40, near, tilted and all over the image"
"""and where only cameras are calibrated."""
MAX_SHARE_OF_ONE = 0.7
"""A direction depends on one collection if that contributes more than this fraction of its information."""


def too_few(calibration: Calibration) -> tuple[Finding, ...]:
    """Report an undecided result if few views disagree by more than their noise and single ones decide it.

    The result follows such a view, so that its residual is small despite its error: no standard deviation covers that.
    """
    model, bars = calibration.solution.model, calibration.error_bars
    count = len(model.G)
    if bars is None or count >= MIN_INDEPENDENT_COLLECTIONS or bars.decisive < MAX_SHARE_OF_ONE:
        return ()
    ratio = disagreement(model).ratio
    if ratio <= MIN_CONTRADICTING_FACTOR:
        return ()
    text = (
        f"{count} collections are too few for views that disagree by {ratio**0.5:.2g} times their noise: one of them "
        f"alone decides {bars.decisive:.0%} of what is known of some direction; take "
        f"{BETTER_OF_CAMERAS if calibration.of_cameras_alone else RECOMMENDED_COLLECTIONS}"
    )
    return (Finding("too-few", "undecided", text, value=ratio, unit="1"),)
