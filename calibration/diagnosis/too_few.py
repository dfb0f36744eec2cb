"""Whether there are enough collections to judge an arm whose views disagree."""

from calibration.diagnosis.finding import Finding
from calibration.estimation.result import Calibration
from calibration.estimation.suspects import CONTRADICTION, disagreement

ENOUGH = 7
"""From so many independent collections on, suspects and error bars tell what disagreement means."""
BETTER = 8
"""What a message asks for."""
ALONE = 0.7
"""One collection decides a direction of which it alone tells more than this part."""


def too_few(calibration: Calibration) -> tuple[Finding, ...]:
    """Red where few views disagree by more than their noise and single ones decide the result.

    The result follows such a view, whose residual then hides its error: no stated standard deviation covers that.
    """
    model, bars = calibration.solution.model, calibration.error_bars
    count = len(model.G)
    if bars is None or count >= ENOUGH or bars.decisive < ALONE:
        return ()
    ratio = disagreement(model).ratio
    if ratio <= CONTRADICTION:
        return ()
    text = (
        f"{count} collections are too few for views that disagree by {ratio**0.5:.2g} times their noise: one of them "
        f"alone decides {bars.decisive:.0%} of what is known of some direction; take {BETTER} or more, with other "
        f"rotations"
    )
    return (Finding("too-few", "red", text, value=ratio, unit="1"),)
