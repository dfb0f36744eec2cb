"""The ROS 1 example as a user's workflow runs it: built, collected, calibrated, judged and promoted, under act."""

import json
import re
import shutil
import sys
import urllib.request
from collections.abc import Mapping
from pathlib import Path

import pytest
import yaml

from tests.docker_engine import Registry
from tests.examples.ros1.conftest import Collected, collected

from .conftest import PROJECT, Repository, Run, commit
from .pipeline import Caller

__all__ = ["collected"]

STEPS = """
- id: image
  uses: me/suite/actions/build-image@v1
  with:
    spec: examples/ros1/calibration.yml
    push: false
  env:
    REGISTRY: REGISTRY_ADDRESS
- id: collect
  uses: me/suite/actions/collect-data-sim@v1
  with:
    system: examples/ros1/system
    image: ${{ steps.image.outputs.reference }}
    ros: 1
    player: ros1
    simulation-command: roslaunch example_simulation simulation.launch
    robot-command: roslaunch example_robot robot.launch output:={output}/dataset
    max-translation-mm: 1
    output: collected
- id: calibrate
  uses: me/suite/actions/calibrate-matrix@v1
  with:
    dataset: collected
    translation-noise: 0.1
    rotation-noise: 0.1
    evaluate: rgb-to-rgb:right_camera:left_camera
    image: ${{ steps.image.outputs.reference }}
    command: python3 /opt/example_robot/calibrate.py --dataset {start} --output {output}
    calibrated: dataset.json
    output: calibrated
- uses: me/suite/actions/introspect-csv@v1
  with:
    file: calibrated/**/artifacts/rgb_to_rgb_results.csv
    column: RMS (pix)
    row: Averages
    max: 0.5
- run: echo "kept=$KEPT rate=$RATE"
  shell: bash
  env:
    KEPT: ${{ steps.collect.outputs.collections }}
    RATE: ${{ steps.calibrate.outputs.success-rate }}
"""
WHOLE = """
- id: pipeline
  uses: me/suite@v1
  with:
    config: CONFIG
    push: PUSH
    python: PYTHON
  env:
    REGISTRY: REGISTRY_ADDRESS
- run: echo "verdict=$VERDICT"
  shell: bash
  env:
    VERDICT: ${{ steps.pipeline.outputs.verdict }}
"""


# A small image, which is compressed and pushed in no time.
PROMOTED = """
image:
  name: ${REGISTRY}/small
  base: debian:bookworm
  files: [{from: table.csv, to: /opt/table.csv}]
  push: true
  promote: [TAG]
systems:
  arm:
    dataset: arm
    software: {command: [cp, /opt/table.csv, "{output}/table.csv"], calibrated: none}
    rules: [{column: RMS (pix), row: Averages, max: LIMIT}]
"""
TABLE = "Collection #,RMS (pix)\n000,0.5\nAverages,0.5\n"


def digest(registry: Registry, tag: str) -> str | None:
    url = f"http://{registry.address}/v2/small/manifests/{tag}"
    accepted = {"Accept": "application/vnd.docker.distribution.manifest.v2+json"}
    try:
        with urllib.request.urlopen(urllib.request.Request(url, headers=accepted), timeout=60) as answer:
            return str(answer.headers["Docker-Content-Digest"])
    except urllib.error.HTTPError:
        return None


def push(repository: Repository, steps: str, registry: Registry, files: Mapping[str, str | Path]) -> Run:
    return repository.push(steps.replace("REGISTRY_ADDRESS", registry.address), files)


def whole(config: str, pushes: str, python: str = "") -> str:
    return WHOLE.replace("CONFIG", config).replace("PUSH", pushes).replace("PYTHON", python)


KEEP = """
- run: cp output/collected/ros1-collected/messages/*.bag "$KEPT"
  env:
    KEPT: FILE
"""
WRONG_REQUIREMENTS = {
    "bag": "recorded.bag",
    "nodes": ["/simulation"],
    "hpl": ["globally: no /pattern/pose {pose.position.x > -100}"],
}
EXAMPLES = {"examples": PROJECT / "examples", "calibration": PROJECT / "calibration"}


@pytest.mark.thorough
def test_the_four_actions_one_after_the_other(repository: Repository, base_image: str, registry: Registry) -> None:
    run = push(repository, STEPS, registry, EXAMPLES)
    assert run.code == 0, run.log
    assert "kept=12 rate=1.0" in run.printed
    assert run.annotations == []


def test_the_root_action_passes_the_example_and_not_what_got_worse(
    repository: Repository, base_image: str, registry: Registry, collected: Collected, tmp_path: Path
) -> None:
    """Without a push: it takes longer to compress the example's image than to do all the rest.

    What gets worse: the software, which its own tests tell too, and a requirement over the messages that were recorded.
    """
    path = repository.folder / "examples" / "ros1" / "calibration.yml"
    steps = whole("examples/ros1/calibration.yml", "false").replace("REGISTRY_ADDRESS", registry.address)
    repository.write(steps + KEEP.replace("FILE", str(tmp_path / "recorded.bag")), EXAMPLES)
    path.write_text(path.read_text().replace("[0, 0.1]", "[0.1]"))  # one cell of its four
    commit(repository.folder)
    run = repository.act("push")
    assert run.code == 0, run.log
    assert "verdict=pass" in run.printed
    assert "0 of 2 tests in the image failed, 12 requirements over messages met" in run.log, run.log
    assert {"verdict", "image", "digest"} <= run.outputs

    configuration = yaml.safe_load(path.read_text())
    del configuration["noise"], configuration["simulation"]
    shutil.copy(tmp_path / "recorded.bag", path.parent)
    configuration["requirements"] = WRONG_REQUIREMENTS
    configuration["tests"]["robot"]["environment"] = {"ROBOT_BUG": "1"}
    shutil.copytree(collected.folder, path.with_name("collected"))  # the same system's, collected by our simulation
    configuration["systems"]["ros1"]["dataset"] = "collected"
    del configuration["systems"]["ros1"]["limits"]  # against the truth, which is not beside it
    configuration["systems"]["ros1"]["software"]["environment"] = {"ROBOT_BUG": "1"}
    path.write_text(json.dumps(configuration))
    repository.write(steps, {})
    run = repository.act("push")
    assert run.code == 1
    test = r"::error file=examples/ros1/robot/test/test_camera\.py,line=\d+,title=test failed::"
    assert [line for line in run.annotations if re.match(test, line)], run.log
    [counterexample] = {line for line in run.annotations if "title=Requirements over messages::" in line}
    stamps = r"/pattern/pose at \d+\.\d{3} s \(\d{10}\.\d{3}\): pose\.position\.x = [\d.]+"
    assert re.search(stamps, counterexample), run.log
    assert any("our engine passes on the same data from the same start" in line for line in run.annotations), run.log


@pytest.mark.thorough
def test_the_reusable_workflow_hands_the_recorded_messages_on(
    repository: Repository, base_image: str, tmp_path: Path
) -> None:
    """One job collects and records, one calibrates, one tests in the image, and one judges the messages."""
    caller = Caller(repository, tmp_path / "artifacts", {"python": sys.executable})
    caller.write({"config": "examples/ros1/calibration.yml"}, EXAMPLES)
    path = repository.folder / "examples" / "ros1" / "calibration.yml"
    path.write_text(path.read_text().replace("[0, 0.1]", "[0.1]").replace("push: true", "push: false"))
    commit(repository.folder)
    run = caller.run("push", "--env", "REGISTRY=127.0.0.1:1")
    assert run.code == 0, run.log
    results = json.loads((caller.artifacts / "calibration" / "results.json").read_text())
    assert (results["tests"]["passed"], results["requirements"]["requirements"]) == (2, 12)
    recorded = [path.relative_to(caller.artifacts).parts[0] for path in caller.artifacts.rglob("*.bag")]
    assert recorded == ["calibration~collected-data"]


@pytest.mark.thorough
def test_the_root_action_promotes_what_has_passed_alone(
    repository: Repository, base_image: str, registry: Registry
) -> None:
    files = {"arm": PROJECT / "datasets" / "riwbot", "table.csv": TABLE}
    for tag, limit, code in (("stable", "1", 0), ("worse", "0.1", 1)):
        configuration = PROMOTED.replace("TAG", tag).replace("LIMIT", limit)
        steps = whole("calibration.yml", "true", sys.executable)
        run = push(repository, steps, registry, {"calibration.yml": configuration, "table.csv": TABLE} | files)
        assert run.code == code, run.log
        assert (digest(registry, tag) is not None) == (code == 0)
        files = {}
