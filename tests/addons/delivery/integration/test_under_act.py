"""Workflows under act: a run, a bundle that a secret signs, deliveries of it, and a robot that accepts it."""

import base64
import re
import sys
from pathlib import Path

import pytest
import yaml

from calibration.__main__ import main
from tests.addons.delivery.bundles import KEY, NAME, private_pem, public_pem
from tests.addons.delivery.services import IMAGE, services
from tests.displaced import displace
from tests.e2e.conftest import PROJECT, Repository, cache, calibration, commit, repository, suite
from tests.e2e.pipeline import Caller
from tests.e2e.steps import Step, outcome, outcomes, workflow

__all__ = ["cache", "repository", "suite"]
CONFIGURATION = "systems: {robot: {dataset: my robot, truth: none, exports: {formats: [tf-static, camera-info]}}}\n"
SECRET_OF_WORKFLOW = "${{ secrets.SIGNING }}"  # noqa: S105 (its name)


@pytest.mark.thorough
def test_a_bundle_is_signed_by_a_secret(repository: Repository, tmp_path: Path) -> None:
    steps = [
        Step("run", "", {"output": "the results"}),
        Step("bundle", "bundle", {"output": "the results", "serial": "SN-9", "signing-key": SECRET_OF_WORKFLOW}),
        Step("unsigned", "bundle", {"output": "the results", "systems": "stranger"}),
    ]
    files = {"calibration.yml": CONFIGURATION, "my robot": PROJECT / "datasets" / "t2rgb"}
    repository.write(workflow(steps), files)
    calibration(repository.folder, "run", "--output", "accepted")
    calibration(repository.folder, "accept", "--output", "accepted")
    printed = 'for file in "the results/bundle/"*; do echo "$(basename "$file") $(base64 -w0 "$file")"; done'
    run = repository.push(workflow(steps, printed), None, "--secret", f"SIGNING={private_pem()}")
    assert outcomes(run) == {"run": "success", "bundle": "success", "unsigned": "failure"}, run.log
    assert outcome(run, steps[2]).code == 2
    assert not [line for line in private_pem().splitlines()[1:-1] if line in run.log]
    outputs = outcome(run, steps[1]).outputs
    assert re.fullmatch("sha256:[0-9a-f]{64}", outputs["digest"])
    files = dict(re.findall(rf"({re.escape(NAME)}\S*) (\S+)", "\n".join(run.printed)))
    assert len(files) == 3
    for name, content in files.items():
        (tmp_path / name).write_bytes(base64.b64decode(content))
    bundle = tmp_path / NAME
    (tmp_path / "team.pub").write_bytes(public_pem(KEY))
    assert main(["verify", str(bundle), "--key", str(tmp_path / "team.pub"), "--serial", "SN-9"]) == 0


@pytest.mark.thorough
def test_a_sensor_that_moved_is_a_minor_version(repository: Repository, tmp_path: Path) -> None:
    folder = repository.folder
    with services() as there:
        there.repository = f"me/{folder.name.replace(' ', '-')}"
        registry = f"{there.server.address}/{IMAGE}"
        places = {
            "release": "true",
            "registry": registry,
            "api-url": f"http://{there.server.address}",
            "token": "of-the-job",
        }
        steps = [Step("run", ""), Step("deliver", "deliver", {**places, "signing-key": SECRET_OF_WORKFLOW})]
        signed = ("--secret", f"SIGNING={private_pem()}")
        repository.write(
            workflow(steps), {"calibration.yml": CONFIGURATION, "my robot": PROJECT / "datasets" / "t2rgb"}
        )
        (folder / "my robot" / "ground_truth.json").unlink()
        for expected in ("1.0.0", "1.1.0"):
            calibration(folder, "run", "--output", str(tmp_path / expected), codes=(0, 1))
            calibration(folder, "accept", "--output", str(tmp_path / expected))
            commit(folder)
            run = repository.act("push", *signed)
            assert outcomes(run) == {"run": "success", "deliver": "success"}, run.log
            assert outcome(run, steps[1]).outputs["version"] == expected
            displace(folder / "my robot", "right_camera", (0.003, 0.0, 0.0, 0.0, 0.0, 0.0))
        assert there.shown == (["1.0.0", "1.1.0", "latest"], ["robot-1.0.0", "robot-1.1.0"])
        assert re.search(r"right\\_camera \| 3 ± 0\.0\d+ mm along its x", there.changelog("robot-1.1.0"))
        (tmp_path / "team.pub").write_bytes(public_pem(KEY))
        arguments = ["verify", registry, "--key", str(tmp_path / "team.pub"), "--unpack", str(tmp_path / "unpacked")]
        assert main(arguments) == 0
        used = tmp_path / "unpacked/robot/tf_static.yaml"
        assert main(["verify", registry, "--unsigned", "--in-use", str(used)]) == 0
        transforms = yaml.safe_load(used.read_text())
        transforms["transforms"][-1]["transform"]["translation"]["x"] -= 0.003
        used.write_text(yaml.safe_dump(transforms))
        assert main(["verify", registry, "--unsigned", "--in-use", str(used)]) == 1


@pytest.mark.thorough
def test_the_workflow_delivers_what_has_passed(repository: Repository, tmp_path: Path) -> None:
    """Of two cells in jobs of their own; the registry is a stand-in."""
    folder = repository.folder
    with services() as there:
        there.repository = f"me/{folder.name.replace(' ', '-')}"
        registry = f"{there.server.address}/{IMAGE}"
        caller = Caller(
            repository,
            tmp_path / "artifacts",
            {"python": sys.executable, "noise-inside-cells": False, "deliver-registry": registry},
            {"signing-key": private_pem()},
        )
        configuration = f"noise: {{translation: [0, 0.1]}}\ndelivery: {{serial: SN-9}}\n{CONFIGURATION}"
        files = {"calibration.yml": configuration, "my robot": PROJECT / "datasets" / "t2rgb"}
        caller.write({}, files)
        calibration(folder, "run", "--output", str(tmp_path / "accepted"))
        calibration(folder, "accept", "--output", str(tmp_path / "accepted"))
        commit(folder)
        event = tmp_path / "event.json"
        event.write_text('{"ref": "refs/heads/main", "repository": {"default_branch": "main"}}')
        run = caller.run("push", "-e", str(event))
        assert run.code == 0, run.log
        assert there.shown == (["1.0.0", "latest"], [])
        (tmp_path / "team.pub").write_bytes(public_pem(KEY))
        assert main(["verify", registry, "--key", str(tmp_path / "team.pub"), "--serial", "SN-9"]) == 0
