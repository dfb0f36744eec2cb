"""Strict parsing and formatting of finite decimal numbers."""

import math
import re

_DECIMAL_TEXT = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")


def parse_number(text: str) -> float | None:
    """Parse a finite decimal number (``-1.5e3``); None for anything else.

    NaN, infinity, overflow, an empty text, ``1,5``, ``0x1f`` and ``1_000`` are rejected.
    """
    if not _DECIMAL_TEXT.fullmatch(text):
        return None
    number = float(text)
    return number if math.isfinite(number) else None


def number_text(number: float) -> str:
    """Format a number with all its digits, whole numbers without a point."""
    text = repr(float(number))
    return text.removesuffix(".0")
