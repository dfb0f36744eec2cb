"""Catalogue of the cases, and their run."""

from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from benchmarks.verdict.case import Case, Outcome, run
from benchmarks.verdict.kinds import CLEAN, KINDS
from benchmarks.verdict.strata import Stratum, generator


def cases(
    kinds: Iterable[str], systems: Iterable[str], strata: Iterable[Stratum], seeds: Iterable[int], quick: bool
) -> Iterator[Case]:
    """The cases, those of one scene together; quick: one size on one system in one stratum of each kind."""
    wanted, of = set(kinds), [kind for kind in KINDS if kind.name in set(kinds)]
    systems, strata = list(systems), list(strata)
    for seed in seeds:
        chosen = {kind.name: _one(kind.name, seed, [s for s in systems if s in kind.systems], strata) for kind in of}
        for stratum in strata:
            for system in systems:
                if CLEAN.name in wanted:
                    yield Case(CLEAN.name, stratum, system, 0, seed)
                for kind in of:
                    sizes = range(len(kind.sizes))
                    if system in kind.systems and (not quick or chosen[kind.name] == (stratum, system)):
                        for size in [int(generator(kind.name, seed).integers(1, len(sizes)))] if quick else sizes:
                            yield Case(kind.name, stratum, system, size, seed)


def _one(name: str, seed: int, systems: list[str], strata: list[Stratum]) -> tuple[Stratum, str] | None:
    rng = generator(name, seed, "where")
    return (strata[rng.integers(len(strata))], systems[rng.integers(len(systems))]) if systems else None


def outcomes(of: list[Case], jobs: int) -> Iterator[Outcome]:
    """Outcomes of the cases, in their order."""
    if jobs == 1:
        yield from map(run, of)
        return
    with ProcessPoolExecutor(jobs, get_context("fork")) as pool:
        yield from pool.map(run, of, chunksize=20)
