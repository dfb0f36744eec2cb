import base64
import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from calibration.ci.execution.docker.backend import DockerBackend
from calibration.ci.execution.docker.run_objects import find_leftovers
from calibration.ci.execution.job import Container, Job, Limits, Mount, Readiness
from calibration.ci.execution.outcome import End
from calibration.ci.github.service import GITHUB
from calibration.ci.workflow import Runner
from calibration.ci.workflow.streams import LogDisplay
from tests.ci.workflow.test_groups import obeyed
from tests.integration.execution.jobs import python, run_job, run_jobs, shell

if TYPE_CHECKING:
    from docker import DockerClient


def test_in_a_group_per_container_on_github(tmp_path: Path) -> None:
    runner = Runner(GITHUB, stdout=io.StringIO())
    display = LogDisplay(runner)
    hostile = shell(
        "printf '::error::no\\n::stop-commands::x\\n##[error]no\\n\\033[31mred\\n'; sleep 0.3", "robot", after=("sim",)
    )
    sim = shell("echo up; sleep 600", "sim", essential=False, readiness=Readiness(log="up"))
    jobs = [Job("j1", (sim, hostile)), Job("j2", (shell("echo x"),))]
    with DockerBackend(show=display) as backend:
        for _, outcome in backend.run(jobs, tmp_path, 2):
            runner.log(f"::notice::{outcome.job} {outcome.verdict}")
    assert isinstance(runner.stdout, io.StringIO)
    log = runner.stdout.getvalue()
    commands = obeyed(log)
    assert {"::group::j1/sim", "::group::j1/robot", "::group::j2/a", "::notice::j1 pass", "::notice::j2 pass"} <= set(
        commands
    )
    assert not [command for command in commands if "error" in command]
    opened = 0
    for command in commands:
        opened += command.startswith("::group") - command.startswith("::endgroup")
        assert opened in (0, 1)  # the runner does not support nested groups
    assert "##[" not in log
    assert "\x1b" not in log


class Screen(io.StringIO):
    """Lets a container continue when its line has been shown."""

    def __init__(self, folder: Path, seen: Callable[[], None] = lambda: None) -> None:
        super().__init__()
        self._folder = folder
        self._seen = seen
        folder.mkdir()

    def write(self, text: str) -> int:
        if "begun" in text:
            self._seen()
            (self._folder / "now").touch()
        return super().write(text)

    @property
    def container(self) -> Container:
        """Return the container, which waits for the display."""
        text = "echo begun; while ! test -e /go/now; do sleep 0.05; done"
        return shell(text, mounts=(Mount(self._folder, "/go"),), limits=Limits(seconds=60))


def test_live(tmp_path: Path) -> None:
    """A line is shown when it is printed, not when the container ends."""
    screen = Screen(tmp_path / "go")
    [outcome] = run_jobs(tmp_path, Job("j", (screen.container,)), show=LogDisplay(Runner(stdout=screen)))
    assert outcome.reasons == ()
    assert screen.getvalue() == "j/a | begun\n"


def test_much_output_is_kept_whole(tmp_path: Path) -> None:
    for stream in ("stdout", "stderr"):
        text = f"import sys\nprint(*range(200000), sep='\\n', file=sys.{stream})"
        outcome = run_job(tmp_path, python(text), name=stream)
        assert (outcome.folder / "logs" / "a.log").read_text().split("\n")[:-1] == [str(i) for i in range(200000)]


def test_output_that_is_closed_early_is_no_end(tmp_path: Path) -> None:
    outcome = run_job(tmp_path, shell("echo x; exec >&- 2>&-; sleep 0.7; exit 4"))
    assert outcome.reasons == ("container 'a' ended with exit code 4: x",)  # available only after its end


SECRET = "pl4nted-s3cret\nwith a second line"  # noqa: S105


def test_planted_secrets_are_found_nowhere(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    screen = io.StringIO()
    text = """
import base64, os, sys, time
os.dup2(1, 2)  # two streams come in no order
secret = os.environ["TOKEN"]
print("plain", secret)
print(base64.b64encode(secret.encode()).decode())
for letter in secret: sys.stdout.write(letter); sys.stdout.flush()
time.sleep(0.2)
print()
print(repr(os.environ), flush=True)
time.sleep(0.2)
sys.exit("the token " + secret.split()[0] + " was refused")
"""
    robot = python(text, environment={"TOKEN": SECRET}, secrets=frozenset({"TOKEN"}))
    [outcome] = run_jobs(tmp_path, Job("j", (robot,)), show=LogDisplay(Runner(stdout=screen)))
    assert outcome.reasons == ("container 'a' ended with exit code 1: the token *** was refused",)
    written = b"".join(path.read_bytes() for path in tmp_path.rglob("*") if path.is_file())
    said = written + (screen.getvalue() + repr(outcome) + repr(robot) + "".join(capfd.readouterr())).encode()
    for form in (b"pl4nted", b"second line", base64.b64encode(SECRET.encode())):
        assert form not in said
    assert b"plain ***" in written


def test_the_engine_keeps_no_log(tmp_path: Path, engine: "DockerClient") -> None:
    kinds: list[str] = []

    def look() -> None:
        made = [each for each in find_leftovers(engine.api, backend.run_name) if each.kind == "container"]
        kinds.extend(engine.api.inspect_container(each.id)["HostConfig"]["LogConfig"]["Type"] for each in made)

    screen = Screen(tmp_path / "go", look)
    job = Job("j", (shell("sleep 600", "b"), replace(screen.container, after=("b",))))
    with DockerBackend(show=LogDisplay(Runner(stdout=screen))) as backend:
        [(_, outcome)] = backend.run([job], tmp_path)
    assert kinds == ["none"] * 2
    assert outcome.containers[0].end == End.STOPPED


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from calibration.ci.workflow import streams

    plain = streams.Path.open

    def full(path: Path, *arguments: object, **settings: object) -> object:
        return plain(Path("/dev/full") if path.suffix == ".log" else path, *arguments, **settings)  # type: ignore[call-overload]

    monkeypatch.setattr(streams.Path, "open", full)
    outcome = run_job(tmp_path, shell("echo x; sleep 0.3; echo y"))
    assert outcome.exit_code == 3
    assert "a.log: the log cannot be written: No space left on device" in outcome.reasons[0]
