"""`calibration run` with an image section: build, collect, calibrate in containers, judge, promote; for real."""

import json
import os
import shutil
import subprocess
import sys
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from calibration.pipeline.collection.collecting import collect_dataset
from calibration.pipeline.collection.request import CollectionRequest
from tests.docker_engine import Registry

PROJECT = Path(__file__).parents[3]
# A robot application that has collected before, and a calibration that says how far off its start is.
ROBOT = """
import shutil, sys
shutil.copytree("/opt/robot/collected", sys.argv[1])
"""
CALIBRATE = """
import sys
start, output, noise = sys.argv[1:]
with open(start + "/dataset.json") as file:
    file.read()
with open(output + "/table.csv", "w") as file:
    file.write("Collection #,RMS (pix)\\n000,%s\\nAverages,%s\\n" % (noise, noise))
"""
CONFIGURATION = """
image:
  name: {registry}/team/robot
  base: calibration-test:python
  files: [{{from: robot, to: /opt/robot}}]
  environment: {{TEAM: red}}
  user: robot
  push: true
  promote: [stable, v1]
noise: {{translation: [0, 0.1]}}
simulation:
  fresh:
    system: system
    containers:
      simulation: {{command: [sh, -c, "echo ready; sleep 600"], ready: {{log: ready}}, essential: false}}
      robot: {{command: [python3, /opt/robot/robot.py, "{{output}}/dataset"], after: [simulation]}}
systems:
  robot:
    dataset: simulation:fresh
    software:
      command: [python3, /opt/robot/calibrate.py, "{{start}}", "{{output}}", "{{translation_noise}}"]
      calibrated: none
    rules: [{{column: RMS (pix), row: Averages, max: {limit}}}]
"""


@pytest.fixture(scope="module")
def repository(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A team's repository: a system, and what it puts into its image."""
    folder = tmp_path_factory.mktemp("team")
    collected = folder / "robot" / "collected"
    collect_dataset(CollectionRequest(PROJECT / "datasets" / "t2rgb", motion="generate:4", seed=3), collected)
    (folder / "system").mkdir()
    for name in ("robot.urdf", "config.yml", "simulation.yml", "motion.json"):
        shutil.move(collected / name, folder / "system" / name)
    (collected / "ground_truth.json").unlink()
    (folder / "robot" / "robot.py").write_text(ROBOT)
    (folder / "robot" / "calibrate.py").write_text(CALIBRATE)
    return folder


Run = Callable[..., tuple[int, dict[str, Any], str]]


@pytest.fixture
def run(repository: Path, python_image: str, registry: Registry, tmp_path: Path) -> Run:
    def started(limit: float = 1, *options: str, change: tuple[str, str] = ("", "")) -> tuple[int, dict[str, Any], str]:
        path = repository / "calibration.yml"
        path.write_text(CONFIGURATION.replace(*change).format(registry=registry.address, limit=limit))
        words = [sys.executable, "-m", "calibration", "run", "--config", str(path), "--output", str(tmp_path), *options]
        done = subprocess.run(
            words,
            cwd=PROJECT,
            env={**os.environ, "GITHUB_EVENT_NAME": "push"},
            capture_output=True,
            text=True,
            timeout=240,
            check=False,
        )
        document = json.loads((tmp_path / "results.json").read_text()) if (tmp_path / "results.json").exists() else {}
        return done.returncode, document, done.stdout + done.stderr

    return started


def digest(registry: Registry, tag: str) -> str | None:
    accepted = "application/vnd.docker.distribution.manifest.v2+json"
    url = f"http://{registry.address}/v2/team/robot/manifests/{tag}"
    try:
        with urllib.request.urlopen(urllib.request.Request(url, headers={"Accept": accepted}), timeout=60) as answer:
            found: str = answer.headers["Docker-Content-Digest"]
            return found
    except urllib.error.HTTPError:
        return None


def test_from_a_specification_to_a_promoted_image(run: Run, registry: Registry) -> None:
    code, document, log = run(limit=0.09)
    assert code == 1, log
    assert document["image"]["built"]
    assert document["image"]["promoted"] == []
    assert digest(registry, "stable") is None
    assert "our engine passes on the same data" in log

    code, document, log = run()
    assert code == 0, log
    image = document["image"]
    assert not image["built"]
    assert [cell["rms_px"] for cell in document["cells"]] == [0.0, 0.1]
    [collected] = document["collections"]
    assert (collected["kept"], collected["verdict"]) == (4, "pass")
    assert collected["translation_mm"] < 1
    assert digest(registry, "stable") == digest(registry, "v1") == image["digest"] is not None
    assert "promoted to" in log


@pytest.mark.thorough
def test_results_inside_of_what_is_copied_change_nothing(run: Run, repository: Path) -> None:
    whole = "files: [{{from: robot, to: /opt/robot}}]", "files: [{{from: ., to: /opt/all}}]"
    options = ("--only", "build", "--output", str(repository / "results"))
    built = [run(1, *options, change=whole)[2] for _ in range(2)]
    assert "pass: the image is built" in built[0]
    assert "pass: the image is there" in built[1]


def test_a_fork_pushes_and_promotes_nothing(run: Run, registry: Registry) -> None:
    name = "/team/robot\n", "/fork/robot\n"
    code, document, log = run(1, "--push", "false", change=name)
    assert code == 0, log
    assert (document["image"]["digest"], document["image"]["promoted"]) == (None, [])
    with urllib.request.urlopen(f"http://{registry.address}/v2/_catalog", timeout=60) as answer:
        assert "fork/robot" not in json.load(answer)["repositories"]


def test_a_verdict_of_this_run_is_needed_to_promote(run: Run) -> None:
    code, _, log = run(1, "--only", "build,promote")
    assert code == 2
    assert "promote needs the verdict of this run" in log
