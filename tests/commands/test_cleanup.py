"""Command `calibration cleanup`; leftovers of killed runs are tested in tests/integration/execution."""

import re
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from calibration.__main__ import main
from calibration.ci.execution.docker.labels import JOB_LABEL, RUN_LABEL, Owner, new_run
from calibration.ci.execution.docker.run_objects import Leftover, find_leftovers, remove

if TYPE_CHECKING:
    from docker import DockerClient


def test_without_an_engine(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("DOCKER_HOST", "unix:///nosuch.sock")
    assert main(["cleanup"]) == 3
    assert capsys.readouterr().err.startswith("error: no Docker Engine answers at unix:///nosuch.sock: ")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(["--run", "x", "--all"], "run and all exclude each other"), (["--run", " "], "run is empty")],
)
def test_contradictions(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["cleanup", *arguments]) == 2
    assert message in capsys.readouterr().err


def test_objects_of_another_version(engine: "DockerClient", capsys: pytest.CaptureFixture[str]) -> None:
    run = new_run()
    engine.api.create_volume(f"calibration-{run}", labels={RUN_LABEL: run, JOB_LABEL: "a\x1b[2Jb"})
    try:
        assert main(["cleanup"]) == 0  # its owner is unknown
        assert len(find_leftovers(engine.api, run)) == 1
        shown = capsys.readouterr().out
        assert "kept: their run" in shown
        assert re.search(rf"volume +calibration-{run} .*by an unknown process", shown)
        assert main(["cleanup", "--all", "--dry-run"]) == 0
        shown = capsys.readouterr().out
        assert run in shown
        assert "\x1b" not in shown
        assert main(["cleanup", "--run", run, "--dry-run"]) == 0
        assert "1 volume would be removed" in capsys.readouterr().out
        assert main(["cleanup", "--run", run]) == 0
        assert "1 volume removed" in capsys.readouterr().out
        assert find_leftovers(engine.api, run) == []
        assert main(["cleanup", "--run", run]) == 0
        assert capsys.readouterr().out == "nothing removed\n"
    finally:
        remove(engine.api, find_leftovers(engine.api, run))


def test_why_what_may_be_in_use_is_kept(engine: "DockerClient", capsys: pytest.CaptureFixture[str]) -> None:
    run, here = new_run(), Owner.this_process()
    owners = {"here": here, "there": replace(here, host="robot-2"), "inside": replace(here, namespace="pid:[1]")}
    for name, owner in owners.items():
        engine.api.create_volume(f"calibration-{run}-{name}", labels={RUN_LABEL: run, **owner.labels})
    try:
        assert main(["cleanup"]) == 0
        shown = capsys.readouterr().out
        assert re.search(rf"{run}-here .*active, process {here.process}\n", shown)
        assert re.search(rf"{run}-there .*may be active on robot-2\n", shown)
        assert re.search(rf"{run}-inside .*may be active in another container of this machine\n", shown)
        assert len(find_leftovers(engine.api, run)) == 3
    finally:
        remove(engine.api, find_leftovers(engine.api, run))


def test_missing_objects_are_no_error_and_used_ones_are_named(engine: "DockerClient", base_image: str) -> None:
    run = new_run()
    labels = {RUN_LABEL: run, **Owner.this_process().labels}
    name = f"calibration-{run}"
    engine.api.create_volume(name, labels=labels)
    host = engine.api.create_host_config(binds={name: {"bind": "/v", "mode": "rw"}})
    user = engine.api.create_container(base_image, ["true"], host_config=host)
    try:
        gone = [Leftover.of("container", "0" * 64), Leftover.of("volume", f"{name}-gone")]
        assert len(remove(engine.api, gone)) == 2
        code = main(["cleanup", "--run", run])
        assert code == 3
    finally:
        engine.api.remove_container(user, force=True)
        remove(engine.api, find_leftovers(engine.api, run))
