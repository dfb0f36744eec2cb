"""``make faults``: commands on machines that fail, by seeds: a signal at any moment, a disk or memory that ends.

A command answers with its own exit code, with 3, or with the signal's; in one line, within `SECONDS`, and leaves no
process and no temporary file. What else happens is a failure, named by its command and its seed.
``python -m tests.campaigns.faults --command matrix --case 17`` runs one case alone.
"""

import argparse
import os
import random
import re
import resource
import shlex
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

from tests.processes import in_folder

PROJECT = Path(__file__).resolve().parents[2]
SECONDS = 20
"""After a signal; and after the time that the command takes undisturbed."""
DATASET = str(PROJECT / "datasets" / "riwbot")
_NOISE = ("--translation-noise", "0,0.2,0.5", "--rotation-noise", "0,0.3", "--output", "out")
COMMANDS: Mapping[str, tuple[str, ...]] = {
    "matrix": ("calibrate-matrix", "--dataset", DATASET, *_NOISE, "--jobs", "2"),
    "repeated": ("calibrate-matrix", "--dataset", DATASET, *_NOISE, "--jobs", "2", "--repeat", "2"),
    "convergence": ("convergence", "--dataset", DATASET, *_NOISE, "--seeds", "2", "--jobs", "2"),
    "collection": (
        *("collect-data-sim", "--system", str(PROJECT / "datasets" / "t2rgb"), "--motion", "generate:4"),
        *("--output", "out", "--jobs", "2"),
    ),
    "recordings": ("import-data", "--config", "import.yml", "--output", "out", "--jobs", "2"),
    "scenarios": (
        *("collect-data-sim", "--system", str(PROJECT / "datasets" / "t2rgb"), "--scenarios", "2", "--output", "out"),
        *("--scenario-set", str(PROJECT / "datasets" / "scenarios.yml"), "--jobs", "2"),
    ),
    "labels": ("label", "--dataset", DATASET, "--output", "out", "--again", "--jobs", "2"),
    "pipeline": ("run", "--output", "out", "--jobs", "2"),
    "coverage": (
        *("coverage-upload", "--run", "unittest", "--interpreter", sys.executable, "--output", "out"),
        *("--minimum", "50"),
    ),
    "analysis": ("static-analysis", "--tools", "ruff,xml,yamllint", "--output", "out"),
    "mounts": ("check", "left_camera=night", "--rate", "2", "--output", "out"),
    "tables": ("introspect-csv", "--file", "table.csv", "--column", "x", "--max", "3", "--output", "out"),
}
PROGRAM = (sys.executable, "-m", "calibration")
PIPELINE = f"""\
noise: {{translation: [0, 0.2], rotation: [0, 0.3]}}
assume: exact
systems:
  robot:
    dataset: {DATASET}
    limits: {{translation-mm: 1, rotation-deg: 0.1}}
    exports: {{formats: [ros2]}}
simulation:
  fresh: {{system: {DATASET}, motion: "generate:4", minimum-collections: 4}}
"""
IMAGES = PROJECT / "datasets" / "t2rgb"
IMPORT = f"""\
sensors:
  left_camera: {{images: "{IMAGES}/left_camera_*", intrinsics: camera.yml}}
  right_camera: {{images: "{IMAGES}/right_camera_*", intrinsics: camera.yml}}
patterns:
  board: {{type: charuco, columns: 11, rows: 8, square: 0.06, marker: 0.045, dictionary: DICT_5X5_100}}
"""
TEST = """\
import subprocess, unittest
from program import double

class Doubled(unittest.TestCase):
    def test_a_number(self):
        subprocess.run(["sleep", "0.3"], check=True)
        self.assertEqual(double(2), 4)
"""
KINDS = ("signal", "signal", "signal", "two signals", "killed", "disk", "memory", "stdout", "streams")
FULL = "/dev/full"


@cache
def undisturbed(name: str) -> tuple[float, int]:
    """How long a command takes with nothing in its way, in s, and its exit code."""
    with tempfile.TemporaryDirectory(prefix="calibration-faults-") as folder:
        begin = time.monotonic()
        process = _started(name, Path(folder), {})
        process.communicate()
        return time.monotonic() - begin, process.returncode


def kind_of(seed: int) -> str:
    """Which fault strikes in a case."""
    return random.Random(seed).choice(KINDS)


def problem_of(name: str, seed: int) -> str | None:
    """What is wrong with what a command did when a fault struck; None where nothing is."""
    draw = random.Random(seed)
    kind = draw.choice(KINDS)  # the first draw, as `kind_of` says
    duration, code = undisturbed(name)
    expected = {code, 3}
    limits: dict[int, int] = {}
    if kind == "disk":
        limits = {resource.RLIMIT_FSIZE: int(10 ** draw.uniform(1, 5))}
        if name == "coverage":
            expected.add(2)  # the tests' own Python could not write what it had measured
    elif kind == "memory":
        limits = {resource.RLIMIT_AS: int(10 ** draw.uniform(8.1, 9.3))}
    with tempfile.TemporaryDirectory(prefix="calibration-faults-") as folder:
        streams = {"stdout": (FULL, None), "streams": (FULL, FULL)}.get(kind, (os.devnull, None))
        process = _started(name, Path(folder), limits, *streams)
        if "signal" in kind or kind == "killed":
            number = signal.SIGKILL if kind == "killed" else draw.choice((signal.SIGINT, signal.SIGTERM))
            # After its last line a signal ends Python itself, as for a shell.
            expected = {code, 128 + number, -number}
            begin = time.monotonic()
            _wait_for_handlers(process)
            time.sleep(draw.random() * max(0.0, begin + duration - time.monotonic()))
            for _ in range(2 if kind == "two signals" else 1):
                process.send_signal(number)
                time.sleep(draw.random() / 10)
        try:
            _, said = process.communicate(timeout=duration + SECONDS)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            return f"{kind}: not done after {duration + SECONDS:.0f} s"
        said = said or ""  # None where it is no pipe
        if kind == "killed":
            wait_until_none(Path(folder))
        left = [path.name for path in (Path(folder) / "tmp").iterdir()]
        if processes := in_folder(Path(folder)):
            for pid in processes:
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            return f"{kind}: a process is left"
    if "Traceback" in said:
        return f"{kind}: {_raised(said)}, with a traceback"
    if process.returncode not in expected:
        return f"{kind}: exit code {process.returncode}, expected one of {sorted(expected)}: {said.strip()[-200:]}"
    # Nobody can clean up who is killed.
    return f"{kind}: left {', '.join(left)}" if left and kind != "killed" else None


def _raised(said: str) -> str:
    """The exception of a traceback, and the lines of code that it came through, in one line."""
    lines = [line.strip() for line in said[said.index("Traceback") :].splitlines()]
    places = [line.removeprefix("File ") for line in lines if line.startswith("File ")]
    error = next((line for line in lines if re.match(r"[\w.]+(Error|Exception|Interrupt|Warning)\b", line)), lines[-1])
    return f"{error} ({'; '.join(places[-6:])})"


def _wait_for_handlers(process: "subprocess.Popen[str]") -> None:
    """Wait until a command answers SIGTERM itself, or has ended: before, nobody is there who could answer."""
    status, bit = Path(f"/proc/{process.pid}/status"), 1 << (signal.SIGTERM - 1)
    while process.poll() is None:
        caught = next((line for line in status.read_text().splitlines() if line.startswith("SigCgt:")), "SigCgt: 0")
        if int(caught.split()[1], 16) & bit:
            return
        time.sleep(0.005)


def wait_until_none(folder: Path) -> None:
    """Wait until no process works in a folder, for some seconds at most."""
    end = time.monotonic() + SECONDS
    while in_folder(folder) and time.monotonic() < end:
        time.sleep(0.05)


def _started(
    name: str, folder: Path, limits: Mapping[int, int], stdout: str = os.devnull, stderr: str | None = None
) -> "subprocess.Popen[str]":
    """A command in a group and a folder of its own; its errors are in a pipe, or in a file."""
    (folder / "tmp").mkdir()
    if name == "tables":
        (folder / "table.csv").write_text("name,x\n" + "a,1\n" * 200_000)
    elif name == "recordings":
        (folder / "import.yml").write_text(IMPORT)
        (folder / "camera.yml").write_text("intrinsics: {fx: 554.256, fy: 554.256, cx: 320.5, cy: 240.5}\n")
    elif name == "pipeline":
        (folder / "calibration.yml").write_text(PIPELINE)
    elif name == "mounts":
        from tests.addons.guard.recorded import accepted_in, clip, folder_of_images  # an add-on, which may be deleted

        folder_of_images(accepted_in(folder) / "night", clip())
    elif name in ("coverage", "analysis"):
        _commit(folder)
    with Path(stdout).open("w") as out, Path(stderr or os.devnull).open("w") as errors:
        return subprocess.Popen(
            [*PROGRAM, *COMMANDS[name]],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": str(PROJECT), "TMPDIR": str(folder / "tmp")},
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=errors if stderr else subprocess.PIPE,
            text=True,
            start_new_session=True,
            preexec_fn=partial(_limit, limits),
        )


def _commit(folder: Path) -> None:
    """A repository with a program, its test, and files to analyse."""
    (folder / ".gitignore").write_text("tmp/\nout/\n")
    (folder / "program.py").write_text("import os\n\n\ndef double(x):\n    return 2 * x\n")
    (folder / "test_program.py").write_text(TEST)
    (folder / "robot.yml").write_text("sensors: [ camera]\n")
    (folder / "robot.xml").write_text("<robot/>\n")
    for command in ("init -q", "add .", "-c user.name=tester -c user.email=tester@example.org commit -qm program"):
        subprocess.run(["git", *shlex.split(command)], cwd=folder, check=True)


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
    draw, counts, kinds = random.Random(asked.seed), Counter[str](), Counter[str]()
    failures, end = 0, time.monotonic() + asked.seconds
    for _ in range(asked.cases):
        if time.monotonic() > end:
            break
        name, seed = draw.choice(names), draw.randrange(1 << 31)
        counts[name] += 1
        kinds[kind_of(seed)] += 1
        if problem := problem_of(name, seed):
            failures += 1
            print(f"--command {name} --case {seed}: {problem}", flush=True)
    print(f"{counts.total()} cases, seed {asked.seed}: {dict(counts)}, {dict(kinds)}: {failures} failures")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
