"""Image with detected points and their expected positions."""

from base64 import b64encode

from calibration.base.arrays import Array
from calibration.ci.pages.html import Html, element
from calibration.ci.pages.svg import drawing

FIGURE_WIDTH = 430.0
"""Width of the figure, px."""
ARM = 3.0
"""Half the size of a cross, px of the figure."""


def overlay(title: str, jpeg: bytes | None, size: tuple[int, int], seen: Array, expected: Array) -> Html:
    """Return the figure.

    Args:
        title: title of the figure.
        jpeg: the image, of any size; None for an empty frame.
        size: width and height of the image to which the pixel coordinates refer.
        seen: (n, 2), px, drawn as crosses.
        expected: (n, 2), px, drawn as circles.
    """
    scale = FIGURE_WIDTH / size[0]
    height = size[1] * scale
    address = "" if jpeg is None else f"data:image/jpeg;base64,{b64encode(jpeg).decode('ascii')}"
    picture = element("image", href=address, width=FIGURE_WIDTH, height=height) if address else Html("")
    crosses = "".join(
        f"M{x - ARM:.1f} {y:.1f}h{2 * ARM:g}m-{ARM:g}-{ARM:g}v{2 * ARM:g}" for x, y in (seen * scale).tolist()
    )
    circles = "".join(
        f"M{x - ARM:.1f} {y:.1f}a{ARM:g} {ARM:g} 0 1 0 {2 * ARM:g} 0a{ARM:g} {ARM:g} 0 1 0 -{2 * ARM:g} 0"
        for x, y in (expected * scale).tolist()
    )
    return drawing(
        FIGURE_WIDTH,
        height,
        title,
        picture,
        element("rect", x=0.5, y=0.5, width=FIGURE_WIDTH - 1, height=height - 1, class_="frame"),
        element("path", d=circles, class_="expected"),
        element("path", d=crosses, class_="seen"),
    )
