"""Import time of each command before it begins (`python -X importtime`), in units of a process that imports numpy.

Compiled modules lie there already, as after a first start. What a command imports only when it needs it does not count
here; `benchmarks.process` measures whole processes.
"""

import os
import re
import statistics
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec

from benchmarks import AS_FOUND
from benchmarks.rows import Bar, Row
from benchmarks.shared_data import ROOT
from calibration.__main__ import COMMANDS

LINE = re.compile(r"import time:\s+(\d+) \|\s+\d+ \|\s+(\S+)")
BARS = {
    "run": 3.4,
    "calibrate-matrix": 3.1,
    "accept": 2.8,
    "history": 3.5,
    "convergence": 3.5,
    "introspect-csv": 1.1,
    "collect-data-sim": 4.6,
    "build-image": 3.6,
    "coverage-upload": 2.2,
    "static-analysis": 2.0,
    "record-motion": 0.9,
    "plan-matrix": 3.2,
    "gather-results": 3.8,
    "comment": 1.3,
    "import-data": 4.7,
    "label": 4.0,
    "init": 4.3,
    "export": 2.5,
    "import-rigelfile": 2.0,
    "aws-policy": 1.4,
    "cleanup": 1.4,
    "schema": 1.2,
    "version": 1.2,
}
"""Of each command: at most so many times what numpy takes, a tenth above what it was when this was written."""


def measure(quick: bool) -> Iterator[Row]:
    """Measure every command, each beside numpy."""
    for name in COMMANDS:
        if not find_spec(COMMANDS[name].target.partition(":")[0]):
            continue
        program = f"from calibration.__main__ import load_command; load_command({name!r})"
        ratios = []
        for round_ in range(4 if quick else 8):
            unit = sum(times_of("import numpy").values())
            found = times_of(program)
            if round_:  # the first compiles
                ratios.append(sum(found.values()) / unit)
        ours = sum(module.partition(".")[0] == "calibration" for module in found)
        slowest = ", ".join(sorted(found, key=lambda module: -found[module])[:3])
        note = f"{len(found)} modules, {ours} of them ours; the slowest: {slowest}"
        yield Row(f"imports/{name}", statistics.median(ratios), "x numpy", Bar(high=BARS[name]), note)


def times_of(program: str) -> dict[str, int]:
    """Microseconds of each module that a program imports, those below it left out; empty where the program fails."""
    environment = {key: value for key, value in AS_FOUND.items() if key != "PYTHONDONTWRITEBYTECODE"}
    environment |= {name: os.environ[name] for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")}
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-c", program], cwd=ROOT, env=environment, capture_output=True, text=True
    )
    return {} if done.returncode else {name: int(own) for own, name in LINE.findall(done.stderr)}
