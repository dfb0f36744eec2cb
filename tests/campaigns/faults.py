"""``make faults``: commands on machines that fail, by seeds: a signal at any moment, a disk or memory that ends.

A command answers with its own exit code, with 3, or with the signal's; in one line, within `SECONDS`, and leaves no
process and no temporary file. What else happens is a failure, named by its command and its seed.
``python -m tests.campaigns.faults --command matrix --case 17`` runs one case alone.
"""

import argparse
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from functools import cache, partial
from pathlib import Path

from tests.processes import group_runs

PROJECT = Path(__file__).resolve().parents[2]
SECONDS = 20
"""After a signal; and after the time that the command takes undisturbed."""
BEGUN = 0.4
"""s, until Python and our first lines have begun: before, nobody is there who could answer a signal."""
DATASET = str(PROJECT / "datasets" / "riwbot")
_NOISE = ("--translation-noise", "0,0.2,0.5", "--rotation-noise", "0,0.3", "--output", "out")
COMMANDS: Mapping[str, tuple[str, ...]] = {
    "matrix": ("calibrate-matrix", "--dataset", DATASET, *_NOISE, "--jobs", "2"),
    "convergence": ("convergence", "--dataset", DATASET, *_NOISE, "--seeds", "2", "--jobs", "2"),
    "collection": (
        *("collect-data-sim", "--system", str(PROJECT / "datasets" / "t2rgb"), "--motion", "generate:4"),
        *("--output", "out", "--jobs", "2"),
    ),
    "tables": ("introspect-csv", "--file", "table.csv", "--column", "x", "--max", "3", "--output", "out"),
}
PROGRAM = (sys.executable, "-m", "calibration")
KINDS = ("signal", "signal", "signal", "two signals", "disk", "memory", "stdout")


@cache
def undisturbed(name: str) -> tuple[float, int]:
    """How long a command takes with nothing in its way, in s, and its exit code."""
    with tempfile.TemporaryDirectory(prefix="calibration-faults-") as folder:
        begin = time.monotonic()
        process = _started(name, Path(folder), {})
        process.communicate()
        return time.monotonic() - begin, process.returncode


def problem_of(name: str, seed: int) -> str | None:
    """What is wrong with what a command did when a fault struck; None where nothing is."""
    draw = random.Random(seed)
    kind = draw.choice(KINDS)
    duration, code = undisturbed(name)
    expected = {code, 3}
    limits: dict[int, int] = {}
    if kind == "disk":
        limits = {resource.RLIMIT_FSIZE: int(10 ** draw.uniform(1, 5))}
    elif kind == "memory":
        limits = {resource.RLIMIT_AS: int(10 ** draw.uniform(8.1, 9.3))}
    with tempfile.TemporaryDirectory(prefix="calibration-faults-") as folder:
        process = _started(name, Path(folder), limits, "/dev/full" if kind == "stdout" else None)
        if "signal" in kind:
            number = draw.choice((signal.SIGINT, signal.SIGTERM))
            # Before the command could take it, or after its last line, a signal ends Python itself, as for a shell.
            expected = {code, 128 + number, -number}
            time.sleep(BEGUN + draw.random() * max(0.0, duration - BEGUN))
            for _ in range(2 if kind == "two signals" else 1):
                process.send_signal(number)
                time.sleep(draw.random() / 10)
        try:
            _, said = process.communicate(timeout=duration + SECONDS)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            return f"{kind}: not done after {duration + SECONDS:.0f} s"
        left = [path.name for path in (Path(folder) / "tmp").iterdir()]
    if group_runs(process.pid):
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        return f"{kind}: a process is left"
    if "Traceback" in said:
        return f"{kind}: {said.strip().splitlines()[-1]}, with a traceback"
    if process.returncode not in expected:
        return f"{kind}: exit code {process.returncode}, expected one of {sorted(expected)}: {said.strip()[-200:]}"
    return f"{kind}: left {', '.join(left)}" if left else None


def _started(name: str, folder: Path, limits: Mapping[int, int], stdout: str | None = None) -> "subprocess.Popen[str]":
    """A command in a group and a folder of its own."""
    (folder / "tmp").mkdir()
    (folder / "table.csv").write_text("name,x\n" + "a,1\n" * 20_000)
    with Path(stdout or os.devnull).open("w") as out:
        return subprocess.Popen(
            [*PROGRAM, *COMMANDS[name]],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": str(PROJECT), "TMPDIR": str(folder / "tmp")},
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            preexec_fn=partial(_limit, limits),
        )


def _limit(limits: Mapping[int, int]) -> None:
    for what, value in limits.items():
        resource.setrlimit(what, (value, value))


def main() -> int:
    """Run the campaign of the command line, and print its counts; 1 where a case failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=1e9, help="end sooner, after so long")
    parser.add_argument("--command", choices=COMMANDS, help="this one alone")
    parser.add_argument("--case", type=int, help="of the command, this case alone")
    asked = parser.parse_args()
    names = [asked.command] if asked.command else list(COMMANDS)
    if asked.case is not None:
        print(problem_of(names[0], asked.case) or "as it should be")
        return 0
    draw, counts, failures, end = random.Random(asked.seed), Counter[str](), 0, time.monotonic() + asked.seconds
    for _ in range(asked.cases):
        if time.monotonic() > end:
            break
        name, seed = draw.choice(names), draw.randrange(1 << 31)
        counts[name] += 1
        if problem := problem_of(name, seed):
            failures += 1
            print(f"--command {name} --case {seed}: {problem}", flush=True)
    print(f"{counts.total()} cases ({dict(counts)}), seed {asked.seed}: {failures} failures")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
