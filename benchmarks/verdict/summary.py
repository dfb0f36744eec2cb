"""Summary of the outcomes of a catalogue by kind, by size and on clean data; as lines and as Markdown."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from benchmarks.verdict.case import BY_NAME, Outcome
from benchmarks.verdict.kind import Kind
from benchmarks.verdict.kinds import CLEAN, KINDS

Rows = Sequence[Outcome]
Test = Callable[[Outcome], bool]


def share(rows: Iterable[Outcome], of: Test) -> float:
    """Share of the rows; NaN without any."""
    found = [of(row) for row in rows]
    return sum(found) / len(found) if found else float("nan")


def text(value: float) -> str:
    """A share in percent, or a dash."""
    return "-" if np.isnan(value) else f"{100 * value:.0f} %"


def is_red(row: Outcome) -> bool:
    """Whether the verdict is fail."""
    return row.red


def is_named(row: Outcome) -> bool:
    """Whether the first or the second reason names the cause."""
    return row.named in (1, 2)


def planted(rows: Rows) -> list[Outcome]:
    """Outcomes with a defect that shows in the data."""
    return [row for row in rows if row.case.kind != CLEAN.name and not row.memory]


def demanded(rows: Rows) -> list[Outcome]:
    """Outcomes of `planted` that have to be red: harmful ones, and mistakes that a user has to correct."""
    return [row for row in planted(rows) if row.must_be_red]


def lines(rows: Rows) -> list[str]:
    """The report."""
    return [*_totals(rows), "", *_by_kind(rows), "", *_clean(rows)]


def _totals(rows: Rows) -> list[str]:
    must, harmless = demanded(rows), [r for r in planted(rows) if r.must_be_green]
    red = [row for row in must if row.red]
    small = [row for row in harmless if (row.limits or 0) <= 0.5]
    clean = [row for row in rows if row.case.kind == CLEAN.name]
    return [
        f"{len(rows)} cases, {len({r.case.kind for r in rows} - {CLEAN.name})} kinds of defects",
        f"harmful and red, no memory needed: {text(share(must, is_red))} of {len(must)} (bar 97 %)",
        f"  by RMS limits alone: {text(share(must, lambda r: r.rms_red))}; by ATOM's own gate: 0 % (it always exits 0)",
        f"red, and the first or second reason names the cause: {text(share(red, is_named))} of {len(red)} (bar 90 %)",
        (
            f"harmless and red: {text(share(harmless, is_red))} of {len(harmless)}; below half a limit: "
            f"{text(share(small, is_red))} of {len(small)} (bar 1 %)"
        ),
        (
            f"clean and red: {sum(r.red for r in clean)} of {len(clean)} (bar 0.1 %), with a warning: "
            f"{sum(bool(r.warnings) for r in clean)} (bar 1 %)"
        ),
        f"seconds a case: median {np.median([r.seconds for r in rows]):.3f}" if rows else "",
    ]


def _by_kind(rows: Rows) -> Iterable[str]:
    yield f"{'kind':26} {'n':>4} {'harm':>5} {'red':>6} {'named':>6} {'RMS':>6}  red by size        harmless red"
    for kind in KINDS:
        of = [row for row in planted(rows) if row.case.kind == kind.name]
        if not of:
            continue
        must = [row for row in of if row.must_be_red]
        free = [row for row in of if row.must_be_green]
        curve = " ".join(f"{text(value):>6}" for value in curve_of(kind, of))
        named = share([row for row in must if row.red], is_named)
        cells = (text(share(must, is_red)), text(named), text(share(must, lambda r: r.rms_red)))
        yield (
            f"{kind.name:26} {len(of):4} {len(must):5} {' '.join(f'{c:>6}' for c in cells)}  {curve}   "
            f"{sum(r.red for r in free)} of {len(free)}"
        )


def curve_of(kind: Kind, rows: Rows) -> list[float]:
    """The share of red at each size, of all that are harmful or have to be corrected."""
    return [share([r for r in rows if r.case.size == i and r.must_be_red], is_red) for i in range(len(kind.sizes))]


def smallest_found(kind: Kind, rows: Rows, wanted: float = 0.99) -> float | None:
    """The smallest size from which on so many of the harmful ones are red; None where no size is."""
    found = None
    for i in reversed(range(len(kind.sizes))):
        must = [row for row in rows if row.case.size == i and row.must_be_red]
        if must and share(must, is_red) < wanted:
            break
        found = kind.sizes[i] if must else found
    return found


def _clean(rows: Rows) -> Iterable[str]:
    yield f"{'clean':9} {'system':9} {'n':>4} {'red':>4} {'warned':>6} {'harmful':>7}"
    keys = dict.fromkeys((r.case.stratum, r.case.system) for r in rows if r.case.kind == CLEAN.name)
    for stratum, system in keys:
        of = [r for r in rows if (r.case.stratum, r.case.system, r.case.kind) == (stratum, system, CLEAN.name)]
        harmful = sum((r.limits or 0) > 1 for r in of)
        nees = sorted(score for r in of for score in r.nees)
        scores = f"  NEES/6 median {np.median(nees):.2f}" if nees else ""
        red, warned = sum(r.red for r in of), sum(bool(r.warnings) for r in of)
        yield f"{stratum:9} {system:9} {len(of):4} {red:4} {warned:6} {harmful:7}{scores}"


def failures(rows: Rows) -> list[tuple[str, str, list[Outcome]]]:
    """Failures, most frequent first: (what, kind, the cases)."""
    found: list[tuple[str, str, list[Outcome]]] = []
    for name in dict.fromkeys(row.case.kind for row in rows):
        of = [row for row in rows if row.case.kind == name]
        if name == CLEAN.name:
            found.append(("clean, but red", name, [r for r in of if r.red]))
            found.append(("clean, but warned", name, [r for r in of if r.warnings]))
            continue
        must = [r for r in planted(of) if r.must_be_red]
        found.append(("harmful, but green", name, [r for r in must if not r.red]))
        found.append(("red, but not named", name, [r for r in must if r.red and not is_named(r)]))
        found.append(("harmless, but red", name, [r for r in of if r.red and r.must_be_green]))
    return sorted((entry for entry in found if entry[2]), key=lambda entry: -len(entry[2]))


def failure_lines(rows: Rows) -> Iterable[str]:
    """`failures`, with the worst case of each and the command that shows it."""
    for what, name, of in failures(rows):
        total = sum(row.case.kind == name for row in rows)
        systems = ", ".join(
            f"{s} {sum(r.case.system == s for r in of)}" for s in dict.fromkeys(r.case.system for r in of)
        )
        worst = max(of, key=lambda row: row.limits or 0)
        case, size = worst.case, worst.case.planted.sizes[worst.case.size]
        said = "; ".join([*worst.reasons[:2], *(f"(warning) {each}" for each in worst.warnings[:1])])
        yield f"{what}: {name}: {len(of)} of {total} cases ({systems})"
        yield f"    {size:g} {case.planted.unit}, harm {worst.limits or 0:.3g} limits: {said or 'nothing said'}"
        where = f"--systems {case.system} --strata {case.stratum} --seeds {case.seed}-{case.seed} --sizes {case.size}"
        yield f"    python -m benchmarks.verdict --jobs 1 --each --kinds '{name}' {where}"


def readme_table(rows: Rows) -> str:
    """Markdown table of what the verdict finds, one row for each group of defects."""
    out = [
        "| what is wrong | cases | smallest size found | red | named | RMS limits |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for what in dict.fromkeys(kind.what for kind in KINDS):
        kinds = [kind for kind in KINDS if kind.what == what]
        names = {kind.name for kind in kinds}
        of = [row for row in planted(rows) if row.case.kind in names]
        must = [row for row in of if row.must_be_red]
        if not must:
            continue
        sizes = [smallest_found(kind, [r for r in of if r.case.kind == kind.name]) for kind in kinds]
        known = [size for size in sizes if size is not None]
        smallest = _size(max(known), kinds[0].unit) if len(known) == len(kinds) else "-"
        named = share([row for row in must if row.red], is_named)
        cells = (text(share(must, is_red)), text(named), text(share(must, lambda r: r.rms_red)))
        out.append(f"| {what} | {len(must)} | {smallest} | {' | '.join(cells)} |")
    return "\n".join(out)


def _size(size: float, unit: str) -> str:
    if unit == "share":
        return f"{100 * size:g} %"
    if unit == "m":
        return f"{1000 * size:g} mm"
    return "every" if unit == "variant" else f"{size:g} {unit}".strip()


def record(row: Outcome) -> dict[str, Any]:
    """JSON record: the case, what was planted, what was found."""
    kind = BY_NAME[row.case.kind]
    more = {"size": kind.sizes[row.case.size], "unit": kind.unit, "harmful": row.harmful, "memory": row.memory}
    return {**asdict(row), **more, "must_be_red": row.must_be_red}
