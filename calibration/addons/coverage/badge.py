"""Coverage badge as SVG."""

from calibration.addons.coverage.lines import Rate
from calibration.ci.report.badge import BAD, FAIR, GOOD, NONE, drawn_badge


def badge(lines: Rate, goal: float) -> str:
    """Draw a badge as SVG: green from the goal on, brown from three quarters of it, else red."""
    text = "unknown" if lines.percent is None else f"{int(lines.percent)}%"
    if lines.total == 0:
        colour = NONE
    elif lines.reaches(goal):
        colour = GOOD
    else:
        colour = FAIR if lines.reaches(0.75 * goal) else BAD
    return drawn_badge("coverage", text, colour)
