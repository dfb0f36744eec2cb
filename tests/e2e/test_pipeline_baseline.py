"""The accepted calibration in a user's repository: pushes, pull requests that move a sensor or accept it, a fork's.

GitHub's API, for the comment on the pull request, is a stand-in.
"""

import json
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.ci.github.stand_in import TOKEN, GitHub, github
from tests.displaced import displace
from tests.repositories import git

from .conftest import FORK, PROJECT, Repository, Run, calibration, commit
from .pipeline import Caller

CONFIGURATION = "systems: {robot: {dataset: robot, truth: none}}\nbaseline: required\n"
KNOCKED = (0.003, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.fixture
def caller(repository: Repository, tmp_path: Path) -> Caller:
    return Caller(repository, tmp_path / "artifacts", {"python": sys.executable})


def accept(folder: Path) -> None:
    """What a developer does on a laptop: run, accept, commit."""
    calibration(folder, "run", codes=(0, 1))
    calibration(folder, "accept")
    shutil.rmtree(folder / "output")
    commit(folder)


def pull_request(caller: Caller, base: str, tmp_path: Path, *arguments: str, fork: bool = False) -> Run:
    """Act's run of a pull request against a commit."""
    event = json.loads(json.dumps(FORK))
    event["pull_request"]["base"]["sha"] = base
    if not fork:
        event["pull_request"]["head"]["repo"] = {"fork": False, "full_name": "me/robot"}
    path = tmp_path / "event.json"
    path.write_text(json.dumps(event))
    return caller.run("pull_request", "-e", str(path), *arguments)


@pytest.fixture
def api(caller: Caller) -> Iterator[GitHub]:
    """GitHub's API."""
    with github() as found:
        found.repository = f"me/{caller.repository.folder.name.replace(' ', '-')}"
        yield found


@pytest.mark.thorough
def test_the_life_of_an_accepted_calibration(caller: Caller, api: GitHub, tmp_path: Path) -> None:
    folder = caller.repository.folder
    with_api = ("-s", f"GITHUB_TOKEN={TOKEN}", "--env", f"INPUT_API_URL={api.url}")
    caller.write({"comment": "keep"}, {"robot": PROJECT / "datasets" / "t2rgb", "calibration.yml": CONFIGURATION})
    (folder / "robot" / "ground_truth.json").unlink()

    unknown = caller.run()
    assert unknown.code == 1
    assert "no calibration of it has been accepted in calibration-baseline.json: calibration accept" in unknown.log

    accept(folder)
    good = caller.run()
    assert good.code == 0, good.log
    assert good.tables["Calibrated"][2][0] == "robot: camera\\_right\\_link to camera\\_right\\_rgb\\_frame"

    base = git(folder, "rev-parse", "HEAD")
    displace(folder / "robot", "right_camera", KNOCKED)
    commit(folder)
    knocked = pull_request(caller, base, tmp_path, *with_api)
    assert knocked.code == 1
    [said] = [line for line in knocked.annotations if line.startswith("::error title=Calibration::")]
    assert "right_camera has moved since calibration-baseline.json of 20" in said
    assert "mm along its x" in said
    assert knocked.tables["Since the baseline"][1][0] == "robot: right\\_camera"
    [comment] = api.bodies()
    assert "❌ Calibration: fail" in comment
    assert "- right\\_camera has moved since calibration-baseline.json of 20" in comment
    assert "| Since the baseline | Difference | In standard deviations |" in comment

    accept(folder)
    for fork in (False, True):
        accepted = pull_request(caller, base, tmp_path, *with_api, fork=fork)
        assert accepted.code == 0, accepted.log
        assert accepted.tables["Accepted by this change"][1][0] == "robot: right\\_camera"
        assert ("no comment: it is a pull request from a fork" in accepted.log) == fork
        [comment] = api.bodies()
        assert "✅ Calibration: pass" in comment
        assert "| Accepted by this change |" in comment
