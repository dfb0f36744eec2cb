"""Cost of ten times as many collections."""

import math
import statistics
import subprocess
import sys
from collections.abc import Iterator

from benchmarks import exponents, reference
from benchmarks.rig_arrays import RigProblem, rig_problem, solve
from benchmarks.rows import Bar, Row
from benchmarks.shared_data import ROOT
from benchmarks.timing import interleaved

SMALL, LARGE = 2000, 20_000
PEAKS = {
    "solve": (Bar(high=3), "linear start and plain least squares"),
    "solve, robust": (None, "the same with the default loss"),
    "calibrate": (None, "from a Dataset object, which holds the pixels a first time, to the result"),
}


def measure(quick: bool) -> Iterator[Row]:
    """2 cameras, 50 corners; time interleaved, memory in processes of their own."""
    small, large = rig_problem(SMALL), rig_problem(LARGE)
    times = interleaved(
        {"small": lambda: _solve(small, times=3), "large": lambda: _solve(large, times=1)}, rounds=2 if quick else 5
    )
    small_each, large_each = ([t / n for t in times[k]] for k, n in (("small", 3 * SMALL), ("large", LARGE)))
    ratio = statistics.median(large / small for small, large in zip(small_each, large_each, strict=True))
    median = [1e6 * statistics.median(each) for each in (large_each, small_each)]
    note = f"{median[0]:.0f} us against {median[1]:.0f} us, linear start and plain least squares"
    yield Row("growth/time per collection", ratio, "times", Bar(high=1.5), note)
    yield from _exponents(1 if quick else 3)
    for name, (bar, what) in PEAKS.items():
        ratio = _peak(name)
        note = f"peak of tracemalloc in a process of its own, input included, over the pixel arrays: {what}"
        yield Row(f"growth/memory, {name}", ratio, "x pixels", bar, note)


def _exponents(rounds: int) -> Iterator[Row]:
    """The power of the number of collections with which a whole `calibrate` grows; 1 is as the data do."""
    now, place = exponents.measured(rounds), reference.folder(reference.RECENT)
    before = exponents.measured(rounds, place) if place else {}
    small, large = exponents.SIZES
    for name, (few, many) in now.items():
        power = math.log(many / few) / math.log(large / small)
        note = f"calibrate, {name}: {few:.2f} s of CPU time for {small}, {many:.2f} s for {large} collections"
        if name in before:
            first, last = before[name]
            note += f"; before {math.log(last / first) / math.log(large / small):.2f}, {first:.2f} s and {last:.2f} s"
        yield Row(f"growth/exponent, {name}", power, "", Bar(high=1.1), note)


def _solve(rig: RigProblem, times: int) -> None:
    for _ in range(times):
        solve(rig.setup, rig.guess, robust=False)


def _peak(what: str) -> float:
    """The peak of one solve over the size of the pixels, in a new process."""
    command = [sys.executable, "-m", "benchmarks.memory", what, str(LARGE)]
    return float(subprocess.run(command, check=True, capture_output=True, cwd=ROOT).stdout)
