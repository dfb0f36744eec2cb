"""Times that compare on a machine that does other things too."""

import statistics
import time
from collections.abc import Callable, Mapping

Work = Callable[[], object]


def seconds(work: Work) -> float:
    """The wall time of one call."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def interleaved(works: Mapping[str, Work], rounds: int) -> dict[str, list[float]]:
    """Time all works one after the other, and again, so that all see the same busy moments.

    Returns:
        The seconds of each work in each round; an unmeasured round goes before.
    """
    times: dict[str, list[float]] = {name: [] for name in works}
    for round_ in range(rounds + 1):
        for name, work in works.items():
            elapsed = seconds(work)
            if round_:
                times[name].append(elapsed)
    return times


def in_units_of(unit: Work, works: Mapping[str, Work], rounds: int) -> tuple[float, dict[str, float]]:
    """Time of each work in units of ``unit``: the median over the rounds of the ratios within a round.

    The unit is timed before and after every work, and what stands beside a work measures it.

    Returns:
        The median seconds of the unit, and the ratios.
    """
    ratios: dict[str, list[float]] = {name: [] for name in works}
    units: list[float] = []
    for round_ in range(rounds + 1):
        before = seconds(unit)
        for name, work in works.items():
            elapsed = seconds(work)
            after = seconds(unit)
            if round_:
                ratios[name].append(elapsed / ((before + after) / 2))
                units.append(after)
            before = after
    return statistics.median(units), {name: statistics.median(ratio) for name, ratio in ratios.items()}
