"""The same rig, from the same start, by other solvers, which have to end at the same optimum."""

import statistics
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec

from benchmarks.floor import cost
from benchmarks.peers.peer import Peer as Peer
from benchmarks.peers.peer import PeerError as PeerError
from benchmarks.peers.peer import Solution as Solution
from benchmarks.peers.with_ceres import ceres
from benchmarks.peers.with_gtsam import gtsam
from benchmarks.peers.with_mrcal import mrcal as mrcal
from benchmarks.peers.with_pyceres import pyceres
from benchmarks.rig_arrays import RigProblem, rig_problem
from benchmarks.rows import Bar, Row
from benchmarks.timing import interleaved, seconds
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.least_squares.minimisation import minimise
from calibration.engine.estimation.least_squares.normal_equations import Weighting

COLLECTIONS = (20, 200, 2000)
SAME_COST = 1e-6
"""Relative difference of the costs below which two solvers have found the same optimum."""


@dataclass(frozen=True)
class _Against:
    """A solver to measure against."""

    find: Callable[[], Peer | str]
    bars: Mapping[int, Bar]
    """By the number of collections, our time over its own."""
    rounds: int = 7


PEERS = {
    "ceres": _Against(ceres, {20: Bar(high=1 / 1.5), 200: Bar(high=1.2), 2000: Bar(high=0.6)}),
    "mrcal": _Against(mrcal, {2000: Bar(high=0.15)}),
    "pyceres": _Against(pyceres, {}, rounds=3),
    "gtsam": _Against(gtsam, {}, rounds=3),
    "scipy": _Against(lambda: _scipy(), {2000: Bar(high=1 / 30)}, rounds=3),
}


def measure(quick: bool) -> Iterator[Row]:
    """2 cameras, 20 to 2000 collections."""
    for collections in COLLECTIONS:
        rig = rig_problem(collections)
        yield from _ours(rig, collections, rounds=5 if quick else 15)
        for name, against in PEERS.items():
            rounds = against.rounds // 2 if quick else against.rounds
            yield from _against(
                f"{name}, 2 x {collections}", against.find(), against.bars.get(collections), rig, rounds
            )


def _ours(rig: RigProblem, collections: int, rounds: int) -> Iterator[Row]:
    """Our least squares alone, and a whole calibration of the same labels."""
    works = {
        "least squares": partial(minimise, rig.setup.problem, rig.start, Weighting({"pixel": 1.0}, None)),
        "whole calibration": partial(calibrate, rig.setup.dataset),
    }
    notes = {
        "least squares": "from the linear start",
        "whole calibration": "the default: checks, linear start, robust loss, noise level, error bars, findings",
    }
    for name, times in interleaved(works, rounds).items():
        yield Row(f"peers/{name}, 2 x {collections}", 1e3 * statistics.median(times), "ms", note=notes[name])


def _against(name: str, peer: Peer | str, bar: Bar | None, rig: RigProblem, rounds: int) -> Iterator[Row]:
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
    size = f"{1e3 * statistics.median(ours):.3g} ms against {1e3 * statistics.median(theirs):.3g} ms"
    yield Row(f"peers/{name}", ratio, "of its time", bar, f"least squares alone, same start: {size}")
    yield Row(
        f"peers/{name}, cost",
        abs(difference),
        "relative",
        Bar(high=SAME_COST),
        f"theirs over ours - 1: {difference:.1e}",
    )


def _scipy() -> Peer | str:
    if find_spec("scipy") is None:
        return "scipy is not installed: pip install scipy"
    from benchmarks.peers.with_scipy import solve

    return lambda rig: Solution(*solve(rig))
