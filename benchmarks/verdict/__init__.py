"""Whether the verdict is right: defects planted in known data, and what a run without a truth says of them.

A kind of defect (`kinds`) is planted in a `scene`: what the user has, and the world as it is. Scenes come in three
`strata`: exact labels with Gaussian noise, labels of rendered images, and good robots with the small errors that every
robot has. `case` judges one of them as `make run` would and holds it against the truth, which the verdict never sees;
`summary` counts. `software` is what a team's own software leaves in the place of our engine. ``python -m
benchmarks.verdict`` runs the catalogue.
"""

from collections.abc import Iterator

from benchmarks.rows import Row


def measure(quick: bool) -> Iterator[Row]:
    """Measure every kind of defect: once if quick, else in all sizes and systems."""
    from benchmarks.verdict.rows import rows  # the lighter commands need none of it

    yield from rows(quick)
