"""Growth of a whole `calibrate` with the number of collections, now and at the kept commit.

``main`` prints CPU times of one thread as JSON: seconds by loss, for each number of collections.
"""

import json
import statistics
import subprocess
import sys
import time
from pathlib import Path

from benchmarks import reference
from benchmarks.process import ENVIRONMENT
from benchmarks.scenes import rig
from benchmarks.shared_data import ROOT
from calibration.engine.estimation.calibrate import Options, calibrate

SIZES = (2000, 10_000)
LOSSES = {"plain": "linear", "robust": "huber"}


def measured(rounds: int, place: Path = ROOT) -> dict[str, list[float]]:
    """The times of `main` in a process with the package in a folder."""
    program = f"sys.path.append({str(ROOT)!r}); from benchmarks.exponents import main; main({rounds})"
    command = [sys.executable, *reference.python(program, place)]
    done = subprocess.run(command, cwd="/", env=ENVIRONMENT, capture_output=True, text=True, check=True)
    found: dict[str, list[float]] = json.loads(done.stdout)
    return found


def main(rounds: int) -> None:
    """Print the median times of interleaved rounds."""
    datasets = [rig(size)[0] for size in SIZES]
    times: dict[str, list[list[float]]] = {name: [[] for _ in SIZES] for name in LOSSES}
    for _ in range(rounds):
        for name, loss in LOSSES.items():
            for dataset, found in zip(datasets, times[name], strict=True):
                begin = time.process_time()
                calibrate(dataset, Options(loss=loss))  # type: ignore[arg-type]
                found.append(time.process_time() - begin)
    print(json.dumps({name: [statistics.median(each) for each in found] for name, found in times.items()}))
