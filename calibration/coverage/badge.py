"""A badge: an image for a README that says how much is covered, made without a service."""

from calibration.coverage.lines import Rate

_LABEL = "coverage"
_GOOD, _FAIR, _BAD, _NONE = "#3a7d1e", "#946200", "#b3261e", "#6b6b6b"
"""Dark enough for white text to be read on them (a contrast of 4.5 and more)."""


def badge(lines: Rate, goal: float) -> str:
    """Draw a badge as SVG: green from the goal on, brown from three quarters of it, else red."""
    text = "unknown" if lines.percent is None else f"{int(lines.percent)}%"
    if lines.total == 0:
        colour = _NONE
    elif lines.reaches(goal):
        colour = _GOOD
    else:
        colour = _FAIR if lines.reaches(0.75 * goal) else _BAD
    left, right = _width(_LABEL), _width(text)
    whole = left + right
    return f"""<svg xmlns="http://www.w3.org/2000/svg" width="{whole}" height="20" role="img">
<title>{_LABEL}: {text}</title>
<clipPath id="r"><rect width="{whole}" height="20" rx="3"/></clipPath>
<g clip-path="url(#r)"><rect width="{left}" height="20" fill="#444"/>
<rect x="{left}" width="{right}" height="20" fill="{colour}"/></g>
<g fill="#fff" text-anchor="middle" font-family="Verdana,DejaVu Sans,sans-serif" font-size="11">
<text x="{left / 2:g}" y="14">{_LABEL}</text><text x="{left + right / 2:g}" y="14">{text}</text></g>
</svg>
"""


def _width(text: str) -> int:
    return 10 + 7 * len(text)
