"""Poses on the way between two others."""


def between(start: float, end: float, share: float) -> float:
    """Return the point at a share of the way."""
    if not 0 <= share <= 1:
        raise ValueError(f"share: found {share}, expected 0 to 1")
    return start + share * (end - start)
