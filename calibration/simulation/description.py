"""What a user wrote about a system: numbers with defaults and limits, and no other keys than the known ones."""

import math

from calibration.dataset.document import Node

MAX_BYTES = 10_000_000
"""No description of a robot, of a system or of a motion comes near it."""


def number(
    node: Node,
    key: str,
    default: float | None = None,
    *,
    least: float = -math.inf,
    most: float = math.inf,
) -> float:
    """A finite number under a key, within limits that are both included.

    Raises:
        InputError: it is missing and has no default, is no number, or is outside the limits.
    """
    value = node.get(key) if default is not None else node[key]
    if value is None:
        assert default is not None  # noqa: S101 (a missing key is an error above)
        return default
    if not least <= value.number() <= most:
        raise value.unexpected(f"a number {_between(least, most)}")
    return value.number()


def whole(node: Node, key: str, least: int, most: int) -> int:
    """A whole number under a key, within limits that are both included."""
    return node[key].whole(least, most)


def numbers(node: Node, key: str, count: int, default: tuple[float, ...] | None = None) -> tuple[float, ...]:
    """A list of ``count`` finite numbers under a key."""
    value = node.get(key) if default is not None else node[key]
    if value is None:
        assert default is not None  # noqa: S101 (a missing key is an error above)
        return default
    return tuple(value.numbers(count))


def interval(
    node: Node,
    key: str,
    default: tuple[float, float] | None = None,
    *,
    least: float = -math.inf,
    most: float = math.inf,
) -> tuple[float, float]:
    """Two numbers under a key, the first not above the second, both within limits."""
    low, high = numbers(node, key, 2, default)
    if not least <= low <= high <= most:
        raise node[key].fault(f"found [{low:g}, {high:g}], expected two rising numbers {_between(least, most)}")
    return low, high


def only(node: Node, *keys: str) -> None:
    """Refuse a key that is none of these: it is misspelt.

    Raises:
        InputError: naming the key.
    """
    for key in dict(node.items()):
        if key not in keys:
            raise node.fault(f"found the key '{key}', expected one of {', '.join(keys)}")


def _between(least: float, most: float) -> str:
    return f"from {least:g} to {most:g}" if math.isfinite(most) else f"of at least {least:g}"
