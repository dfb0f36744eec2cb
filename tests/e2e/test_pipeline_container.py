"""The reusable workflow with jobs in a plain image: Debian with Python, git and curl, and nothing of GitHub's."""

import json
import re
import secrets
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from calibration.ci.registries.reference import Credentials, parse_reference
from calibration.ci.registries.registry import RegistryClient
from tests.docker_engine import Registry

from .conftest import FORK, PROJECT, Repository, Run
from .pipeline import Caller

if TYPE_CHECKING:
    from docker import DockerClient

messages = pytest.importorskip("tests.addons.requirements.messages")
EVALUATE = "inter-collection-rgb-to-rgb:rgb_world:rgb_world"


@pytest.mark.thorough
def test_in_a_plain_image(plain_image: str, repository: Repository, tmp_path: Path) -> None:
    caller = Caller(repository, tmp_path / "artifacts")
    caller.write(
        {"runner": '["plain"]', "datasets": "my data/riwbot", "evaluate": EVALUATE},
        {"my data/riwbot": PROJECT / "datasets" / "riwbot"},
    )
    mounts = f"{tmp_path}:{tmp_path}", f"{repository.suite}:{repository.suite}:ro"
    image = repository.in_image("plain", plain_image, *mounts)
    run = caller.run("push", *image, "--container-daemon-socket", "-")
    assert run.code == 0, run.log
    assert {"0.113 px", "0.00227 mm, 0.00026 deg"} <= set(run.tables["Robot"][1])  # with what evaluate asks for
    assert run.installations == ["engine"]  # once for the three containers


TABLE = "Collection #,RMS (pix)\n000,0.5\nAverages,0.5\n"
SOFTWARE = """
image:
  name: "{name}"
  base: "{base}"
  files: [{{from: table.csv, to: /opt/table.csv}}, {{from: report.xml, to: /opt/report.xml}}]
  push: true
  promote: [{tag}]
noise: {{translation: {noise}}}
systems:
  arm:
    dataset: data/riwbot
    software: {{command: {command}, calibrated: none}}
    rules: [{{column: RMS (pix), row: Averages, max: 1}}]
tests:
  own: {{command: [cp, /opt/report.xml, "{{output}}/report.xml"]}}
requirements:
  bag: robot.bag
  hpl: ["globally: no /cmd_vel {{linear.x > {fastest}}}"]
"""
REPORT = '<testsuite><testcase classname="Robot" name="test_still"/>{more}</testsuite>'
FAILED = '<testcase classname="Robot" name="test_moves"><failure message="found 1 m, expected 2 m"/></testcase>'
COPY = '[cp, /opt/table.csv, "{output}/table.csv"]'


def in_registry(registry: Registry, name: str) -> str | None:
    credentials = Credentials(registry.address, registry.user, registry.password)
    with RegistryClient(credentials) as client:
        return client.find_manifest(parse_reference(name))


class Team:
    """A team whose image is in a private registry."""

    def __init__(self, caller: Caller, registry: Registry, base: str) -> None:
        self.caller = caller
        self.registry = registry
        self.base = base
        self.name = f"{registry.address}/team-{secrets.token_hex(4)}/robot"
        messages.bag_file(caller.repository.folder, "bag", messages.drive)

    def run(
        self,
        *arguments: str,
        tag: str,
        noise: str = "[0]",
        command: str = COPY,
        fastest: float = 1.0,
        more: str = "",
        only: str = "",
    ) -> Run:
        text = SOFTWARE.format(name=self.name, base=self.base, tag=tag, noise=noise, command=command, fastest=fastest)
        data = {"data/riwbot": PROJECT / "datasets" / "riwbot", "table.csv": TABLE, "calibration.yml": text}
        data["report.xml"] = REPORT.format(more=more)
        self.caller.write({"jobs": only}, data)
        run = self.caller.run(*arguments)
        shown = [line for line in run.log.splitlines() if "::add-mask::" not in line]
        assert self.registry.password not in "\n".join(shown)
        return run

    def digest(self, tag: str) -> str | None:
        return in_registry(self.registry, f"{self.name}:{tag}")

    def forget(self, engine: "DockerClient") -> None:
        for image in engine.images.list(self.name):
            engine.images.remove(image.id, force=True)


@pytest.fixture
def team(
    engine: "DockerClient", python_image: str, private_registry: Registry, repository: Repository, tmp_path: Path
) -> Iterator[Team]:
    inputs = {"python": sys.executable, "registry-username": private_registry.user}
    secret = {"registry-password": private_registry.password}
    caller = Caller(repository, tmp_path / "artifacts", inputs, secret)
    team = Team(caller, private_registry, python_image)
    yield team
    team.forget(engine)


STAGES = ("test-image", "check-messages")


def jobs(run: Run) -> set[str]:
    """Return the jobs that have begun; act writes a number behind the name of each job of a matrix."""
    return {re.sub(r"-\d+$", "", job) for job in re.findall(r"^\[robot/pipeline/(.*?) *\].*Set up job", run.log, re.M)}


@pytest.mark.thorough
def test_the_image_is_built_once_every_cell_runs_in_it_and_then_it_is_promoted(team: Team, tmp_path: Path) -> None:
    """Built, found by both cells and the tests, and promoted by its digest.

    Red or in a fork's pull request, nothing is promoted. The tests in the image and the requirements over messages are
    jobs of their own, in the one verdict.
    """
    run = team.run(tag="stable", noise="[0, 0.5]")
    assert run.code == 0, run.log
    built = re.findall(r"set-output:: built=(\w+)", run.log)
    assert built == ["true", *["false"] * 4]  # the last by the promotion
    cells = run.tables["Start"]
    assert cells[0] == ["Start", "arm: software", "arm: calibration-ci"]
    assert [row[1] for row in cells[1:]] == ["0.5000 px", "0.5000 px"]
    [digest] = set(re.findall(r"set-output:: digest=(sha256:\w+)", run.log))
    assert team.digest("stable") == digest
    assert "| promote | to come | 1 | ? | ? |" in run.log
    assert jobs(run) == {"plan", "image", "calibrate", *STAGES, "verdict", "promote"}
    sentence = "2 cells calibrated, 0 of 1 test in the image failed, 1 requirement over messages met"
    assert f"pass: {sentence}" in run.log

    run = team.run(tag="red", command="[sh, -c, exit 7]", fastest=0.6, more=FAILED)
    assert run.code == 1
    crashed = "container 'calibration' ended with exit code 7"
    own, gathered = [line for line in run.annotations if crashed in line]
    at_its_rule = "::error file=calibration.yml,line=10,title="
    assert own.startswith(f"{at_its_rule}Calibration::{crashed}")
    assert gathered.startswith(f"::error title=Calibration::{crashed}")
    said = [line for line in run.annotations if line.startswith("::error title=Calibration::")]
    assert [found for found in said if "tests: own: Robot.test_moves failed: found 1 m, expected 2 m" in found]
    assert [found for found in said if "/cmd_vel at 9.000 s (1700000009.000): linear.x = 0.9" in found]
    assert "promote" not in jobs(run)
    assert team.digest("red") is None

    event = tmp_path / "event.json"
    event.write_text(json.dumps(FORK))
    run = team.run("pull_request", "-e", str(event), tag="strange", only="calibrate")
    assert run.code == 0, run.log
    assert jobs(run) == {"plan", "calibrate", "verdict"}  # nothing is pushed either
    assert team.digest("strange") is None
