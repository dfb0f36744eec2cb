"""``python -m benchmarks.verdict``: run the catalogue, print what the verdict found, write every case to a file.

Without options every kind, size and system once in every stratum.
"""

import argparse
import json
import os
import sys
from dataclasses import replace
from pathlib import Path

from benchmarks.verdict import recordings, summary
from benchmarks.verdict.case import Outcome
from benchmarks.verdict.catalogue import cases, outcomes
from benchmarks.verdict.kind import ALL
from benchmarks.verdict.kinds import CLEAN, KINDS
from benchmarks.verdict.strata import STRATA


def main() -> int:
    """Run what the command line asks for."""
    names = [CLEAN.name, *(kind.name for kind in KINDS)]
    parser = argparse.ArgumentParser("python -m benchmarks.verdict", description=(__doc__ or "").partition("\n\n")[2])
    parser.add_argument("--quick", action="store_true", help="one size, system and stratum of each kind")
    parser.add_argument("--kinds", help="only these, separated by commas; clean is one")
    parser.add_argument("--systems", default=",".join(ALL))
    parser.add_argument("--strata", default=",".join(STRATA))
    parser.add_argument("--seeds", default="1", help="how many, or FIRST-LAST")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--sizes", default="0,1,2", help="of the kinds' sizes, from 0")
    parser.add_argument(
        "--failures", type=Path, metavar="FILE", help="what went wrong, ranked, with the command of one"
    )
    parser.add_argument("--no-limits", action="store_true", help="a user who has set no limits and no assumptions")
    parser.add_argument("--recordings", action="store_true", help="real recordings and wrong views instead")
    parser.add_argument("--each", action="store_true", help="print every case with its reasons and warnings")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="the table of what is found")
    arguments = parser.parse_args()
    if arguments.recordings:
        for found in recordings.rows(arguments.quick):
            print(found.line(), flush=True)
        return 0
    kinds = arguments.kinds.split(",") if arguments.kinds else names
    if unknown := [kind for kind in kinds if kind not in names]:
        parser.error(f"no kind {', '.join(unknown)}; there are {', '.join(names)}")
    first, _, last = arguments.seeds.partition("-")
    seeds = range(int(first), int(last) + 1) if last else range(int(first))
    strata = [stratum for stratum in STRATA if stratum in arguments.strata.split(",")]
    of = list(cases(kinds, arguments.systems.split(","), strata, seeds, arguments.quick))
    sizes = set(map(int, arguments.sizes.split(",")))
    chosen = [case for case in of if case.size in sizes]
    if arguments.no_limits:
        chosen = [replace(case, limits=False) for case in chosen]
    rows = []
    for row in outcomes(chosen, arguments.jobs):
        rows.append(row)
        if arguments.each:
            print(_line(row), flush=True)
    print(*summary.lines(rows), sep="\n")
    if arguments.failures:
        arguments.failures.write_text("\n".join(summary.failure_lines(rows)) + "\n")
    if arguments.json:
        arguments.json.write_text(json.dumps([summary.record(row) for row in rows], indent=1) + "\n")
    if arguments.markdown:
        arguments.markdown.write_text(summary.readme_table(rows) + "\n")
    return 0


def _line(row: Outcome) -> str:
    case = row.case
    size = case.planted.sizes[case.size]
    harm = "no result" if row.limits is None else f"{row.limits:.2f} limits"
    said = "; ".join([*row.reasons[:2], *(f"(warning) {each}" for each in row.warnings[:2])])
    verdict = f"{'red' if row.red else 'green'}{' NAMED' if row.named in (1, 2) else ''}"
    must = "must be red" if row.must_be_red else "harmless"
    return f"{case.stratum} {case.system} {case.kind} {size:g} seed {case.seed}: {harm}, {must}: {verdict}: {said}"


if __name__ == "__main__":
    sys.exit(main())
