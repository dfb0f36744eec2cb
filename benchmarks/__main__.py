"""``python -m benchmarks``: measure, print one table, say what misses its bar.

Exit code 0 when no bar is missed, 1 when one is, 2 for wrong arguments.
"""

import argparse
import importlib
import json
import os
import platform
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.rows import HEADER, Bar, Row

MODULES = {
    "speed": "the least squares and the whole solve, in passes over the data",
    "peers": "against ceres, gtsam, mrcal, pyceres and scipy from the same start",
    "whole": "a whole calibrate beside a kept commit",
    "growth": "time and memory from 2000 to 20 000 collections",
    "consistency": "errors against their stated covariance",
    "robots": "joints, several patterns and a moving base: truth, error bars, cost, what is refused",
    "tasks": "the error of a robot where it works: coverage, parts, time, verdicts by it",
    "family": "ATOM's systems and those that ship: truth and error bars of every block",
    "mixtures": "every modality together, with gaps, and cameras that only others link: truth and error bars",
    "intrinsics": "intrinsics beside the poses: truth, error bars, time against mrcal",
    "outliers": "errors with wrong corners among the labels",
    "paper": "the t2rgb dataset of the paper from 400 noisy starts",
    "synthetic": "three synthetic systems from 100 noisy starts each",
    "dataset_loading": "reading a dataset against json.load",
    "imports": "what each command imports before it begins",
    "process": "whole processes, from start to exit",
    "matrix": "many cells of one dataset with their tables: time and memory of each, share of two cores",
    "rendering": "simulated images, depth images and scans: how many, and where a detector finds their corners",
    "recording": "what makes a recording good: poses, tilt, nearness, focus, light, motion",
    "labelling": "detectors on real and simulated images and clouds",
    "importing": "imports of bags: images and bytes a second, memory; what init makes of datasets",
    "image_tests": "tests in the image: workspaces of examples/, green and with planted failures",
    "delivery": "changed bundles that are accepted, and how long a robot takes to verify one",
    "guard": "fixed cameras that have moved: false red, planted shifts, what cannot be told, time",
    "messages": "requirements over messages: a bag of 1 GB, HPL against tables and a naive evaluator",
    "aprilgrid": "aprilgrids in simulated images: near the truth, and no tag for another",
    "next_pose": "next poses: what is promised and reached, how many a limit takes, time",
    "motion": "what a generated motion costs, and how well its poses determine a calibration",
    "collection": "whole collections in simulation, and how near the truth they calibrate",
    "scenarios": "many worlds",
    "verdict": "planted defects that a run without a truth finds and names, false alarms, error bars",
    "trust": "what a user who has set nothing is told of unforeseen defects, good robots, moves",
    "static_analysis": "a large repository, a change of it, refactorings without new findings",
    "pseudo_tested": "planted functions that tests run and do not test: found, false ones, time of a change",
    "ros_defects": "planted defects of ROS packages that the static analysis finds at their line, false findings",
    "baseline": "the accepted baseline: false alarms and moves between two recordings, changes in histories",
    "mutants": "the engine with one line broken: what the accepted baseline finds that RMS limits do not",
    "action_start": "how soon an action begins its work",
    "containers": "jobs in containers: many at once, and what one costs over docker run",
    "cloud": "ten thousand jobs on AWS Batch: calls, memory and time for each",
    "image_build": "an image whose specification has not changed",
}


def main() -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(
        "python -m benchmarks",
        description="Measure what the suite claims.",
        epilog="Measurements: " + "; ".join(f"{name}: {what}" for name, what in MODULES.items()),
    )
    parser.add_argument("--only", metavar="NAME,...", help="only these measurements")
    parser.add_argument("--quick", action="store_true", help="fewer rounds and seeds; the same bars, less certain")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the rows to a file too")
    arguments = parser.parse_args()
    names = arguments.only.split(",") if arguments.only else list(MODULES)
    if unknown := [name for name in names if name not in MODULES]:
        parser.error(f"no measurement {', '.join(unknown)}; there are {', '.join(MODULES)}")
    print(HEADER)
    rows: list[Row] = []
    for name in names:
        for row in measured(name, arguments.quick):
            rows.append(row)
            print(row.line(), flush=True)
    if arguments.json:
        arguments.json.write_text(json.dumps(report(rows, arguments.quick), indent=1) + "\n")
    missed = [row.name for row in rows if row.verdict == "missed"]
    counts = {verdict: sum(row.verdict == verdict for row in rows) for verdict in ("met", "missed", "skipped")}
    print(", ".join(f"{count} {verdict}" for verdict, count in counts.items()), *missed, sep="\n  missed: ")
    return 1 if missed else 0


def measured(name: str, quick: bool) -> Iterator[Row]:
    """The rows of one module; what breaks it misses its bar and does not stop the others."""
    try:
        yield from importlib.import_module(f"benchmarks.{name}").measure(quick)
    except Exception as error:
        yield Row(f"{name}/failed", bar=Bar(high=0), note=f"{type(error).__name__}: {error}")


def report(rows: list[Row], quick: bool) -> dict[str, object]:
    """The rows, and what they were measured on."""
    return {
        "schema": 1,
        "quick": quick,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "machine": platform.machine(),
        "cores": os.cpu_count(),
        "rows": [row.record() for row in rows],
    }


if __name__ == "__main__":
    sys.exit(main())
