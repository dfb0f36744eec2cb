"""Badge: an SVG image for a README, made without an online service."""

from html import escape

from calibration.base.verdict import Verdict

BADGE_FILE = "badge.svg"
GOOD, FAIR, BAD, NONE = "#3a7d1e", "#946200", "#b3261e", "#6b6b6b"
"""Dark enough for white text (contrast ratio at least 4.5)."""


def drawn_badge(label: str, text: str, colour: str) -> str:
    """Return a badge as SVG: a label, and a text on a coloured background."""
    left, right = _text_width(label), _text_width(text)
    whole, label, text = left + right, escape(label), escape(text)
    return f"""<svg xmlns="http://www.w3.org/2000/svg" width="{whole}" height="20" role="img">
<title>{label}: {text}</title>
<clipPath id="r"><rect width="{whole}" height="20" rx="3"/></clipPath>
<g clip-path="url(#r)"><rect width="{left}" height="20" fill="#444"/>
<rect x="{left}" width="{right}" height="20" fill="{colour}"/></g>
<g fill="#fff" text-anchor="middle" font-family="Verdana,DejaVu Sans,sans-serif" font-size="11">
<text x="{left / 2:g}" y="14">{label}</text><text x="{left + right / 2:g}" y="14">{text}</text></g>
</svg>
"""


def verdict_badge(verdict: Verdict) -> str:
    """Return the badge of a calibration's verdict as SVG: green for pass, amber for undecided, red for fail."""
    return drawn_badge("calibration", verdict, {"pass": GOOD, "undecided": FAIR, "fail": BAD}[verdict])


def _text_width(text: str) -> int:
    return 10 + 7 * len(text)
