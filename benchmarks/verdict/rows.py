"""The catalogue's figures against their bars."""

import os
from collections.abc import Iterator

import numpy as np

from benchmarks.rows import Bar, Row
from benchmarks.verdict import recordings, software, summary
from benchmarks.verdict.case import Outcome
from benchmarks.verdict.catalogue import cases, outcomes
from benchmarks.verdict.kind import ALL
from benchmarks.verdict.kinds import CLEAN, KINDS
from benchmarks.verdict.strata import STRATA

SEEDS = 3
CLEAN_SEEDS = 200


def rows(quick: bool) -> Iterator[Row]:
    """Rows of every kind: once if quick, else in all sizes and systems with three seeds."""
    names = [kind.name for kind in KINDS]
    planted = list(cases(names, ALL, STRATA, range(1 if quick else SEEDS), quick))
    clean = list(cases([CLEAN.name], ALL, STRATA, range(5 if quick else CLEAN_SEEDS), False))
    yield from of_outcomes(list(outcomes([*planted, *clean], os.cpu_count() or 1)))
    yield from recordings.rows(quick)
    yield from software.rows(quick)


def of_outcomes(found: list[Outcome]) -> Iterator[Row]:
    """The rows of a catalogue."""
    must = summary.demanded(found)
    red = [row for row in must if row.red]
    free = [row for row in summary.planted(found) if row.must_be_green]
    clean = [row for row in found if row.case.kind == CLEAN.name]
    rms = 100 * summary.share(must, lambda row: row.rms_red)
    note = f"{len(must)} cases; {rms:.0f} % by RMS limits alone"
    yield _percent("harmful, red", must, summary.is_red, Bar(low=97), note)
    yield _percent("red, named", red, summary.is_named, Bar(low=90), f"{len(red)} cases; first or second reason")
    yield _percent("harmless, red", free, summary.is_red, Bar(high=1), f"{len(free)} cases")
    yield _percent("clean, red", clean, summary.is_red, Bar(high=0.1), f"{len(clean)} cases")
    yield _percent("clean, warned", clean, lambda row: bool(row.warnings), Bar(high=1), f"{len(clean)} cases")
    for stratum in STRATA:
        for system in ALL:
            of = [r for r in clean if (r.case.stratum, r.case.system) == (stratum, system)]
            scores = [score for row in of for score in row.nees]
            if scores:
                bar = Bar(0.3, 1.5) if stratum == "good" else None
                note = f"{len(of)} scenes, squared error over its expectation, median"
                yield Row(f"verdict/NEES, {stratum}, {system}", float(np.median(scores)), "", bar, note)


def _percent(name: str, found: list[Outcome], of: summary.Test, bar: Bar, note: str) -> Row:
    if not found:
        return Row(f"verdict/{name}", skipped="no such case")
    return Row(f"verdict/{name}", 100 * summary.share(found, of), "%", bar, note)
