"""Many cells of one dataset, each with its table and its dataset: time, memory, and what two cores are worth.

The unit is `json.loads` of the dataset. CPU time of all processes counts, their start included, as the machine may be
busy; the efficiency is what it would be on two idle cores.
"""

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks import reference
from benchmarks.process import ENVIRONMENT
from benchmarks.rows import Bar, Row
from benchmarks.shared_data import FOLDER, ROOT

DATASET, TABLE = "t2rgb-paper", "rgb-to-rgb:right_camera:left_camera"
IN_MEMORY = "/dev/shm"  # noqa: S108 (the folder that is made in it has a random name)
"""Folder of a file system in memory: ext4 takes milliseconds to create a file after many have been deleted."""
NEAR = ("--translation-noise", "0.02", "--rotation-noise", "0.02")
PROGRAM = """
import json, resource, time
from pathlib import Path
def unit():
    begin = time.process_time()
    for _ in range(30):
        json.loads(text)
    return (time.process_time() - begin) / 30
def used(whom):
    usage = resource.getrusage(whom)
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024
from calibration.__main__ import main
code = main({arguments!r})
(own, own_mb), (workers, worker_mb) = used(resource.RUSAGE_SELF), used(resource.RUSAGE_CHILDREN)
text = Path({dataset!r}).read_bytes()
print(json.dumps([code, own, workers, own_mb, worker_mb, unit()]))
"""


@dataclass(frozen=True)
class Used:
    """Resources of a matrix: CPU time in seconds, memory in MB."""

    code: int
    own: float
    workers: float
    own_mb: float
    worker_mb: float
    unit: float

    @property
    def seconds(self) -> float:
        """CPU time of all processes."""
        return self.own + self.workers


def measure(quick: bool) -> Iterator[Row]:
    """200 cells now and at the kept commit, 1000 for their memory."""
    path = FOLDER / DATASET
    if not path.exists():
        yield Row("matrix", skipped=f"no {DATASET} here")
        return
    cells = 60 if quick else 200
    now, alone = _matrix(ROOT, path, cells, 2), _matrix(ROOT, path, cells, 1)
    place = reference.folder()
    before = _matrix(place, path, cells, 2) if place else None
    note = f"{cells} cells; json.loads takes {1e3 * now.unit:.2f} ms"
    if before:
        note += f"; before: {before.seconds / cells / before.unit:.1f}"
    yield Row("matrix/a cell", now.seconds / cells / now.unit, "x json.loads", Bar(high=8), note)
    given = _matrix(ROOT, path, cells, 2, ("--start", "given", *NEAR))
    note = "each cell from its noisy guess, until it arrives at the optimum"
    yield Row("matrix/a cell, start: given", given.seconds / cells / given.unit, "x json.loads", None, note)
    small = _matrix(ROOT, path, cells, 2, ("--datasets", "changes"))
    yield Row("matrix/a cell, datasets: changes", small.seconds / cells / small.unit, "x json.loads", Bar(high=8))
    yield Row("matrix/efficiency", _efficiency(alone, now), "on 2 cores", Bar(low=0.9), _between(alone, now, before))
    many = 200 if quick else 1000
    large, large_alone = _matrix(ROOT, path, many, 2), _matrix(ROOT, path, many, 1)
    note = f"{many} cells; each of the two workers {large.worker_mb:.0f} MB"
    yield Row("matrix/memory", large.own_mb, "MB", Bar(high=100), note)
    note = f"{many} cells: {_between(large_alone, large)}"
    yield Row("matrix/efficiency, many cells", _efficiency(large_alone, large), "on 2 cores", None, note)


def _efficiency(alone: Used, together: Used) -> float:
    """CPU time of one process, over twice the time that two workers would take on idle cores."""
    return alone.seconds / (2 * (together.own + together.workers / 2))


def _between(alone: Used, together: Used, before: Used | None = None) -> str:
    note = f"one process {alone.seconds:.1f} s; two {together.workers:.1f} s between them, "
    return f"{note}{together.own:.1f} s beside them" + (f", before {before.own:.1f} s" if before else "")


def _matrix(place: Path, dataset: Path, cells: int, jobs: int, more: Sequence[str] = ()) -> Used:
    with tempfile.TemporaryDirectory(dir=IN_MEMORY if Path(IN_MEMORY).is_dir() else None) as folder:
        noise = ["--translation-noise", "0.5", "--rotation-noise", "0.5", "--seeds", str(cells)]
        arguments = ["calibrate-matrix", "--dataset", str(dataset), "--evaluate", TABLE, *noise]
        arguments += ["--jobs", str(jobs), "--output", folder, *more]
        program = PROGRAM.format(arguments=arguments, dataset=str(dataset / "dataset.json"))
        command = [sys.executable, *reference.python(program, place)]
        done = subprocess.run(command, cwd=folder, env=ENVIRONMENT, capture_output=True, text=True, check=True)
    return Used(*json.loads(done.stdout.splitlines()[-1]))
