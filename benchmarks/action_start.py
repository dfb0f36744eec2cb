"""Time until an action begins its work: on a new runner, and as the second action of a job."""

import os
import statistics
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks import AS_FOUND
from benchmarks.rows import Bar, Row
from benchmarks.shared_data import ROOT

# Each stops at its first look at its inputs, which are missing or name nothing.
INPUTS = {
    "build-image": {"INPUT_SPEC": "nowhere.yml"},
    "bundle": {"INPUT_CONFIG": "nowhere.yml"},
    "deliver": {"INPUT_CONFIG": "nowhere.yml", "INPUT_FOLDER": "nowhere"},
    "calibrate-matrix": {"INPUT_DATASET": "nowhere"},
    "check-messages": {"INPUT_CONFIG": "nowhere.yml"},
    "check": {"INPUT_BASELINE": "nowhere.json"},
    "test-image": {"INPUT_IMAGE": "nowhere"},
    "collect-data-sim": {"INPUT_SYSTEM": "nowhere", "INPUT_OUTPUT": "nowhere/output"},
    "comment": {"INPUT_RESULTS": "nowhere"},
    "convergence": {"INPUT_DATASET": "nowhere"},
    "coverage-upload": {"INPUT_REPORTS": "nowhere.xml"},
    "import-data": {"INPUT_CONFIG": "nowhere.yml", "INPUT_OUTPUT": "nowhere/output"},
    "introspect-csv": {"INPUT_FILE": "nowhere.csv", "INPUT_COLUMN": "RMS", "INPUT_MAX": "1"},
    "static-analysis": {"INPUT_PATHS": "nowhere"},
    "run": {"INPUT_CONFIG": "nowhere.yml"},  # the root action
}


def measure(quick: bool) -> Iterator[Row]:
    """Measure each action cold, with uv and with pip alone, and warm."""
    for name, inputs in INPUTS.items():
        cold, warm = [], []
        for _ in range(1 if quick else 3):
            with tempfile.TemporaryDirectory() as folder:
                cold.append(_start(name, inputs, Path(folder), _with_uv()))
                warm.append(_start(name, inputs, Path(folder), _with_uv()))
        with tempfile.TemporaryDirectory() as folder:
            by_pip = _start(name, inputs, Path(folder), _without_uv())
        note = "its packages installed from the package index, or from an installer's cache that is there"
        yield Row(f"action_start/{name}, cold", statistics.median(cold), "s", Bar(high=20), note)
        yield Row(f"action_start/{name}, cold, by pip", by_pip, "s", Bar(high=20), "no uv, as on GitHub")
        yield Row(f"action_start/{name}, warm", statistics.median(warm), "s", Bar(high=5), "the environment is there")


def _with_uv() -> str:
    """A PATH with our uv, as setup-uv would give."""
    return f"{ROOT / '.venv' / 'bin'}{os.pathsep}{AS_FOUND['PATH']}"


def _without_uv() -> str:
    """A PATH without any, as on a runner of GitHub."""
    return os.pathsep.join(place for place in AS_FOUND["PATH"].split(os.pathsep) if not Path(place, "uv").exists())


def _start(name: str, inputs: dict[str, str], folder: Path, path: str) -> float:
    """Seconds until an action has looked at its inputs, with the environments of a runner's job in a folder."""
    variables = {key: value for key, value in AS_FOUND.items() if not key.startswith(("GITHUB_", "INPUT_"))}
    variables |= {"RUNNER_TEMP": str(folder), "GITHUB_ACTIONS": "true", "PATH": path, **inputs}
    begin = time.perf_counter()
    done = subprocess.run(
        ["bash", str(ROOT / "actions" / "bootstrap.sh"), name],
        cwd=folder,
        env=variables,
        capture_output=True,
        text=True,
    )
    seconds = time.perf_counter() - begin
    assert done.returncode == 2, f"{name}: {done.stdout[-500:]}{done.stderr[-500:]}"
    return seconds
