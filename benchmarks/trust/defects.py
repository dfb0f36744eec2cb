"""Planted defects: of kinds that the verdict's checks were not written for, and of those that they were."""

import os
from collections.abc import Iterator

from benchmarks.rows import Bar, Row
from benchmarks.verdict import summary
from benchmarks.verdict.case import Case, Outcome
from benchmarks.verdict.catalogue import cases, outcomes
from benchmarks.verdict.foreseen import FORESEEN
from benchmarks.verdict.kind import ALL, Kind
from benchmarks.verdict.unforeseen import UNFORESEEN

SEEDS_OF_EACH_CASE = 3
SHOWN = 6
"""Kinds that a row names, the worst first."""


def rows(quick: bool) -> Iterator[Row]:
    """Kinds not foreseen with nothing set; the others with calibration.yml's limits. On good robots."""
    seeds = range(1 if quick else SEEDS_OF_EACH_CASE)
    yield from of_unforeseen(_run(UNFORESEEN, seeds, quick, limits=False))
    yield from _of_foreseen(_run(FORESEEN, range(1), quick, limits=True))


def _run(kinds: tuple[Kind, ...], seeds: range, quick: bool, limits: bool) -> list[Outcome]:
    found = cases([kind.name for kind in kinds], ALL, ("good",), seeds, quick)
    of = [Case(c.kind, c.stratum, c.system, c.size, c.seed, limits) for c in found]
    return list(outcomes(of, os.cpu_count() or 1))


def of_unforeseen(found: list[Outcome]) -> Iterator[Row]:
    """Harmful ones: off the truth by more than a good robot's calibration may be."""
    name = "trust/unforeseen, harmful"
    harmful = [row for row in summary.planted(found) if row.harmful]
    if not harmful:
        yield Row(name, skipped="no such case")
        return
    red = [row for row in harmful if row.red]
    undecided = [row for row in harmful if row.undecided]
    green = [row for row in harmful if not row.red and not row.undecided]
    warned = sum(bool(row.warnings) for row in green)
    note = f"{len(harmful)} cases; {len(undecided)} undecided, {len(green)} green, {warned} of these with a warning"
    yield Row(f"{name}, red", _percent(red, harmful), "%", Bar(low=95), note)
    note = f"most: {most_green(harmful)}" if green else ""
    yield Row(f"{name}, green", _percent(green, harmful), "%", Bar(high=5), note)
    named = [row for row in red if summary.is_named(row)]
    yield Row(f"{name}, named", _percent(named, red), "% of red", Bar(low=90), "first or second reason")


def most_green(harmful: list[Outcome]) -> str:
    """The kinds of which most harmful cases are green, with how many."""
    green = {}
    for name in dict.fromkeys(row.case.kind for row in harmful):
        of = [row for row in harmful if row.case.kind == name]
        green[name] = (sum(not row.red and not row.undecided for row in of), len(of))
    worst = sorted(green, key=lambda name: -green[name][0])[:SHOWN]
    return ", ".join(f"{name} {green[name][0]} of {green[name][1]}" for name in worst if green[name][0])


def _of_foreseen(found: list[Outcome]) -> Iterator[Row]:
    name = "trust/foreseen"
    must = summary.demanded(found)
    red = [row for row in must if row.red]
    named = [row for row in red if summary.is_named(row)]
    free = [row for row in summary.planted(found) if row.must_be_green]
    wrong = [row for row in free if row.red]
    undecided = sum(row.undecided for row in must)
    yield Row(
        f"{name}, harmful, red", _percent(red, must), "%", Bar(low=99), f"{len(must)} cases; {undecided} undecided"
    )
    yield Row(f"{name}, harmful, named", _percent(named, red), "% of red", Bar(low=97), "first or second reason")
    note = f"{len(free)} cases; {sum(row.undecided for row in free)} undecided"
    yield Row(f"{name}, harmless, red", _percent(wrong, free), "%", Bar(high=5), note)


def _percent(some: list[Outcome], of: list[Outcome]) -> float:
    return 100 * len(some) / len(of) if of else float("nan")
