"""Numbers in cells and rules: finite decimals, and nothing that only looks like one."""

import math
import re

_DECIMAL = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")


def parse_number(text: str) -> float | None:
    """Return the finite decimal number that a text is (``-1.5e3``), or None for anything else.

    NaN, infinity, what overflows, an empty text, ``1,5``, ``0x1f`` and ``1_000`` are no numbers.
    """
    if not _DECIMAL.fullmatch(text):
        return None
    number = float(text)
    return number if math.isfinite(number) else None


def number_text(number: float) -> str:
    """Write a number with all its digits, whole numbers without a point."""
    text = repr(float(number))
    return text.removesuffix(".0")
