"""The same rig, from the same start, by other solvers, which have to end at the same optimum."""

import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from benchmarks.floor import cost
from benchmarks.rig_arrays import RigArrays, RigProblem, rig_problem
from benchmarks.rows import Bar, Row
from benchmarks.timing import seconds
from calibration.estimation.least_squares import minimise
from calibration.estimation.normal_equations import Weighting
from calibration.geometry.types import Array

COLLECTIONS = 2000
SAME_COST = 1e-6
"""Relative difference of the costs below which two solvers have found the same optimum."""
MRCAL_PYTHONS = ("/usr/bin/python3", sys.executable)


@dataclass(frozen=True, eq=False)
class Solution:
    """Where a solver ended, and how long it took."""

    T_camera_world: Array
    T_world_board: Array
    seconds: float
    intrinsics: Array | None = None
    """(C, 9), where they were free."""


class PeerError(Exception):
    """A peer gave no solution."""


Peer = Callable[[RigArrays], Solution]


def measure(quick: bool) -> Iterator[Row]:
    """2 cameras, 2000 collections."""
    rig = rig_problem(COLLECTIONS)
    yield from _against("mrcal", mrcal(), Bar(high=0.15), rig, rounds=3 if quick else 7)
    yield from _against("scipy", _scipy(), Bar(high=1 / 30), rig, rounds=1 if quick else 3)


def _against(name: str, peer: Peer | str, bar: Bar, rig: RigProblem, rounds: int) -> Iterator[Row]:
    """Our time over the peer's, and that the optimum is the same."""
    if isinstance(peer, str):
        yield Row(f"peers/{name}", bar=bar, skipped=peer)
        return
    try:
        solution = peer(rig.arrays)
    except PeerError as error:
        yield Row(f"peers/{name}", bar=bar, note=str(error))
        return
    ours: list[float] = []
    theirs: list[float] = []
    our_solve = partial(minimise, rig.setup.problem, rig.start, Weighting({"pixel": 1.0}, None))
    for _ in range(rounds):
        ours.append(statistics.median(seconds(our_solve) for _ in range(5)))
        solution = peer(rig.arrays)
        theirs.append(solution.seconds)
    reached = cost(rig.arrays, *rig.poses(our_solve().values))
    difference = cost(rig.arrays, solution.T_camera_world, solution.T_world_board) / reached - 1
    ratio = statistics.median(our / their for our, their in zip(ours, theirs, strict=True))
    size = f"{1e3 * statistics.median(ours):.0f} ms against {1e3 * statistics.median(theirs):.0f} ms"
    yield Row(f"peers/{name}", ratio, "of its time", bar, f"least squares alone, same start: {size}")
    yield Row(
        f"peers/{name}, cost",
        abs(difference),
        "relative",
        Bar(high=SAME_COST),
        f"theirs over ours - 1: {difference:.1e}",
    )


def mrcal() -> Peer | str:
    """In a process of the Python that has mrcal, or why there is none."""
    for python in MRCAL_PYTHONS:
        if Path(python).exists() and not subprocess.run([python, "-c", "import mrcal"], capture_output=True).returncode:
            return lambda rig: _solve_with_mrcal(python, rig)
    return f"{' and '.join(MRCAL_PYTHONS)} cannot import mrcal; on Debian: apt-get install python3-mrcal"


def _solve_with_mrcal(python: str, rig: RigArrays) -> Solution:
    script = Path(__file__).with_name("mrcal_peer.py")
    with tempfile.TemporaryDirectory() as folder:
        start, solution = Path(folder, "start.npz"), Path(folder, "solution.npz")
        rig.save(start)
        done = subprocess.run([python, script, start, solution], capture_output=True, text=True)
        if done.returncode:
            raise PeerError(f"mrcal failed: {' '.join(done.stderr.split())[-200:]}")
        with np.load(solution) as found:
            poses = found["T_camera_world"], found["T_world_board"]
            return Solution(*poses, float(found["seconds"]), found["intrinsics"] if rig.free_intrinsics else None)


def _scipy() -> Peer | str:
    if find_spec("scipy") is None:
        return "scipy is not installed: pip install scipy"
    from benchmarks.scipy_peer import solve

    return lambda rig: Solution(*solve(rig))
