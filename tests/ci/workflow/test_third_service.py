"""A third CI service: what differs from a terminal is one class, and no command knows of it."""

import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import pytest

from calibration.__main__ import main
from calibration.ci.services import SERVICES, event_of
from calibration.ci.workflow import Runner, add_mask, group
from calibration.ci.workflow.runner import Event, OutputValue, PullRequestComments, Terminal


class KeptComments:
    """Comments on merge request 5."""

    number, run_url, commit = 5, "https://forge.example/runs/9", "a" * 40
    kept: dict[str, str]

    def __init__(self) -> None:
        self.kept = {}

    def keep(self, name: str, text: str) -> str:
        self.kept[name] = text
        return "created"

    def remove(self, name: str) -> int:
        return int(self.kept.pop(name, None) is not None)


class Forge(Terminal):
    """A service with sections in its log and a folder for outputs."""

    interactive = False
    written = KeptComments()

    def runs_here(self, environment: Mapping[str, str]) -> bool:
        return "FORGE" in environment

    def runner(self, environment: Mapping[str, str]) -> Runner:
        return Runner(self, output_file=Path(environment["FORGE"]))

    def event(self, environment: Mapping[str, str]) -> Event:
        return Event(name="merge_request", pull_request_commit="a" * 40)

    @contextmanager
    def group(self, runner: Runner, title: str) -> Iterator[None]:
        runner.log(f"section_start:{title}")
        yield
        runner.log("section_end")

    def mask(self, runner: Runner, forms: Iterable[str]) -> None:
        for form in forms:
            runner.log(f"hide {form}")

    def set_outputs(self, runner: Runner, values: Mapping[str, OutputValue]) -> None:
        assert runner.output_file is not None
        for name, value in values.items():
            (runner.output_file / name).write_text(str(value))

    def comments(
        self, environment: Mapping[str, str], token: str | None, api_url: str | None
    ) -> PullRequestComments | None:
        return self.written


@pytest.fixture
def forge(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Run in a step of the service; return its folder of outputs."""
    for name in [name for name in os.environ if name.startswith(("GITHUB_", "INPUT_", "RUNNER_"))]:
        monkeypatch.delenv(name)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(os.environ, "FORGE", str(tmp_path))
    monkeypatch.setattr("calibration.ci.services.SERVICES", [*SERVICES, Forge()])
    return tmp_path


def test_a_command_speaks_to_the_service(forge: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("t.csv").write_text("k,v\na,5\n")
    assert main(["introspect-csv", "--file", "t.csv", "--column", "v", "--max", "3"]) == 1
    assert (forge / "verdict").read_text() == "fail"
    out, err = capsys.readouterr()
    assert err.startswith("error: t.csv:2: v, a: found 5")
    assert "::" not in out


def test_its_log_has_sections_and_hides_secrets(forge: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runner = Runner.from_environment(os.environ)
    add_mask(runner, "word")
    with group(runner, "a\ntitle"):
        runner.log("x")
    lines = capsys.readouterr().out.splitlines()
    assert "hide word" in lines
    assert lines[-3:] == ["section_start:a title", "x", "section_end"]
    assert event_of(os.environ).pull_request_commit == "a" * 40


def test_its_merge_request_gets_the_comment(forge: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["comment", "--name", "arm"]) == 0
    assert "pull request 5: comment created" in capsys.readouterr().out
    assert "[run](https://forge.example/runs/9) · aaaaaaa" in Forge.written.kept["arm"]
    assert main(["comment", "--name", "arm", "--mode", "delete"]) == 0
    assert Forge.written.kept == {}
