"""A whole `calibrate`, from a dataset to the result with its error bars: now, at the kept commit, in numpy passes."""

import json
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks import reference
from benchmarks.process import ENVIRONMENT
from benchmarks.rows import Bar, Row
from benchmarks.shared_data import FOLDER, ROOT

RIGS = (20, 2000)
LOSSES = {"plain": "linear", "robust": "huber"}
DATASETS = {
    "real t2rgb": FOLDER / "t2rgb-paper",
    "rlbot": ROOT / "datasets" / "rlbot",
    "softbot": ROOT / "datasets" / "softbot",
}
BARS = {
    "plain, 2 x 20": Bar(high=20),
    "plain, 2 x 2000": Bar(high=8),
    "robust, 2 x 2000": Bar(high=12),
    "real t2rgb": Bar(high=40),
    "rlbot": Bar(high=60),
    "softbot": Bar(high=60),
}
"""Passes for rigs, ms for datasets."""


def measure(quick: bool) -> Iterator[Row]:
    """CPU time of one thread; processes of now and of before take turns."""
    rounds = 3 if quick else 9
    before = reference.folder(reference.RECENT)
    now = _measured(rounds, ROOT)
    old = _measured(rounds, before) if before else {}
    for name, found in now.items():
        unit = "passes" if "x" in name else "ms"
        note = f"before ({reference.RECENT}): {old[name]:.3g} {unit}" if name in old else ""
        yield Row(f"whole/calibrate, {name}", found, unit, BARS.get(name), note)


def _measured(rounds: int, place: Path) -> dict[str, float]:
    program = f"sys.path.append({str(ROOT)!r}); from benchmarks.whole import main; main({rounds})"
    command = [sys.executable, *reference.python(program, place)]
    done = subprocess.run(command, cwd="/", env=ENVIRONMENT, capture_output=True, text=True, check=True)
    found: dict[str, float] = json.loads(done.stdout)
    return found


def main(rounds: int) -> None:
    """Print what each takes, as JSON: passes over as many labels for rigs, ms for datasets."""
    from benchmarks.floor import one_pass
    from benchmarks.rig_arrays import rig_problem
    from benchmarks.scenes import rig
    from calibration.engine.dataset.reading import read_dataset
    from calibration.engine.estimation.calibrate import Options, calibrate

    found = {}
    for size in RIGS:
        dataset, arrays = rig(size)[0], rig_problem(size).arrays
        times = max(1, 200 // size)
        unit = _seconds(lambda arrays=arrays: one_pass(arrays), 2 * rounds, 5 * times)
        for name, loss in LOSSES.items():
            options = Options(loss=loss)  # type: ignore[arg-type]
            took = _seconds(lambda d=dataset, o=options: calibrate(d, o), rounds, times)
            found[f"{name}, 2 x {size}"] = took / unit
    for name, folder in DATASETS.items():
        if folder.is_dir():
            dataset = read_dataset(folder)
            found[name] = 1e3 * _seconds(lambda d=dataset: calibrate(d), rounds, 3)
    print(json.dumps(found))


def _seconds(work, rounds: int, times: int) -> float:  # type: ignore[no-untyped-def]
    """The median of rounds of so many calls each, after one that is not measured."""
    work()
    found = []
    for _ in range(rounds):
        begin = time.process_time()
        for _ in range(times):
            work()
        found.append((time.process_time() - begin) / times)
    return statistics.median(found)
