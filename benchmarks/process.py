"""Whole processes, from start to exit, as a user's machine runs them: medians of five interleaved rounds."""

import os
import resource
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks import AS_FOUND, reference
from benchmarks.rows import Bar, Row
from benchmarks.shared_data import FOLDER, ROOT, missing
from benchmarks.timing import seconds

SOLVE = """
import sys
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.start.guesses import StartingNoise
assert calibrate(read_dataset(sys.argv[1]), noise=StartingNoise(0.5, 0.5, 1)).converged
"""
ENVIRONMENT = {key: value for key, value in AS_FOUND.items() if key != "PYTHONDONTWRITEBYTECODE"}
ENVIRONMENT["OPENBLAS_NUM_THREADS"] = "1"
"""A process that begins finds its modules compiled, and has one thread, as the commands have."""
TABLE = "Collection #,RMS (pix)\n000,0.5\nAverages,0.5\n"


@dataclass
class Process:
    """A Python process to time."""

    name: str
    arguments: list[str]
    bar: Bar | None
    note: str = ""
    folder: Path = ROOT
    """Its working folder, from which it takes the package."""
    times: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)
    """User and system time, which a busy machine changes less."""
    failure: str = ""
    """What it said when its exit code was not 0."""

    def run(self) -> None:
        """Run it to its end."""
        command = [sys.executable, *self.arguments]
        done = subprocess.run(command, cwd=self.folder, env=ENVIRONMENT, capture_output=True, text=True)
        if done.returncode:
            self.failure = f"exit {done.returncode}: {' '.join(done.stderr.split())[-200:]}"

    def row(self) -> Row:
        """Row with the median, or without a number if it failed."""
        if self.failure:
            return Row(f"process/{self.name}", unit="s", bar=self.bar, note=self.failure)
        note = f"{self.note}; {statistics.median(self.cpu):.2f} s of CPU time"
        return Row(f"process/{self.name}", statistics.median(self.times), "s", self.bar, note)


def measure(quick: bool) -> Iterator[Row]:
    """Import, load and solve; the commands."""
    with tempfile.TemporaryDirectory() as folder:
        bare, cells = _bare(), _cells(Path(folder))
        processes = [bare, *cells.values(), *_solves(), *_commands(Path(folder))]
        for round_ in range(4 if quick else 6):  # the first fills the caches
            for process in processes:
                before = cpu_seconds()
                elapsed = seconds(process.run)
                if round_:
                    process.times.append(elapsed)
                    process.cpu.append(cpu_seconds() - before)
    busy = os.getloadavg()[0]
    yield Row("process/load", busy, "", note=f"1 minute's load average; above {os.cpu_count()} times are long")
    for process in processes:
        yield process.row()
    yield _above_numpy(bare, cells)
    for name in ("t2rgb-paper", "synthetic/t2rgb", "synthetic/riwbot", "synthetic/rlbot"):
        if reason := missing(name):
            yield Row(f"process/{name}", skipped=reason)


def cpu_seconds() -> float:
    """User and system time of all processes that this one has waited for."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def _bare() -> Process:
    return Process("python, numpy", ["-c", "import numpy"], None, "what of the next rows is not ours")


def _cells(folder: Path) -> dict[str, Process]:
    """The command for one cell: now, and as it was."""
    data = str(FOLDER / "t2rgb-paper" if (FOLDER / "t2rgb-paper").exists() else ROOT / "datasets" / "t2rgb")
    places = {"now": ROOT, "before": reference.folder()}
    found = {}
    for name, place in places.items():
        if place is not None:
            command = ["-m", "calibration", "calibrate-matrix", "--dataset", data, "--output", str(folder / name)]
            found[name] = Process(f"one cell, {name}", command, None, Path(data).name, place)
    return found


def _above_numpy(bare: Process, cells: Mapping[str, Process]) -> Row:
    """CPU time of a cell's process above that of numpy's."""
    above = {name: statistics.median(cell.cpu) - statistics.median(bare.cpu) for name, cell in cells.items()}
    note = f"CPU time above that of a process that imports numpy; before: {above.get('before', float('nan')):.2f} s"
    return Row("process/one cell, above numpy", above["now"], "s", Bar(high=0.15), note)


def _solves() -> Iterator[Process]:
    """Import, load and solve with the defaults, from a start 0.5 m and 0.5 rad off."""
    bars = {
        ROOT / "datasets" / "t2rgb": 0.3,
        FOLDER / "t2rgb-paper": 0.3,
        FOLDER / "synthetic" / "t2rgb": 0.4,
        FOLDER / "synthetic" / "riwbot": 0.4,
        FOLDER / "synthetic" / "rlbot": 0.4,
    }
    for path, high in bars.items():
        if path.exists():
            name = path.relative_to(FOLDER if path.is_relative_to(FOLDER) else ROOT)
            yield Process(str(name), ["-c", SOLVE, str(path)], Bar(high=high), "import, load and solve")


def _commands(folder: Path) -> Iterator[Process]:
    table = folder / "table.csv"
    table.write_text(TABLE)
    rule = ["--column", "RMS (pix)", "--row", "Averages", "--max", "3"]
    judge = ["-m", "calibration", "introspect-csv", "--file", str(table), *rule]
    yield Process("introspect-csv", judge, Bar(high=0.2), "a table of one row, one rule")
    run = ["-m", "calibration", "run", "--only", "calibrate,introspect", "--output", str(folder / "output")]
    yield Process("calibration run", run, Bar(high=3), "3 systems x 4 noise pairs, tables and verdict: `make run`")
