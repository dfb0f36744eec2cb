"""Whether a team can trust the verdict: inputs that this project has not made, and errors that it has not chosen."""

from collections.abc import Iterator

from benchmarks.rows import Row


def measure(quick: bool) -> Iterator[Row]:
    """Measure all of it."""
    from benchmarks.trust import camera_info  # the lighter commands need none of it

    yield from camera_info.measure(quick)
