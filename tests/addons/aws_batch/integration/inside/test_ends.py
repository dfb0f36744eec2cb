"""Ends of containers and jobs in a task have the same messages as on Docker."""

import threading
from pathlib import Path

import pytest

pytest.importorskip("docker")

from calibration.addons.aws_batch.inside.__main__ import prepare
from calibration.addons.aws_batch.inside.script import Signs
from calibration.addons.aws_batch.inside.watch import Watch, WatchTimeouts
from calibration.addons.aws_batch.wire import TaskJob
from calibration.base import ExitCode
from calibration.ci.execution.job import OUTPUT, Container, Job, Limits, Readiness
from calibration.ci.execution.outcome import End
from tests.addons.aws_batch.integration.inside.tasks import NONE, run_task, started
from tests.docker_engine import PYTHON_IMAGE, wait_until
from tests.integration.execution.jobs import python, shell

MIB = 1024**2
EAT = "bytearray(300 * 2**20)"


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("container", "end", "code", "reason"),
    [
        (shell("exit 0"), End.EXITED, 0, None),
        (shell("exit 3", success=(0, 3)), End.EXITED, 3, None),
        (shell("exit 0", success=()), End.EXITED, 0, "container 'a' ended with exit code 0, before the job was done"),
        (shell("exit 3"), End.EXITED, 3, "container 'a' ended with exit code 3"),
        (shell("kill -SEGV $$"), End.SIGNALLED, 139, "container 'a' was killed by SIGSEGV"),
        (
            python(EAT, limits=Limits(memory=64 * MIB)),
            End.OUT_OF_MEMORY,
            137,
            "container 'a' ran out of memory: its limit is 64 MiB (memory)",
        ),
        (
            shell(f"python3 -c '{EAT}'; sleep 0.3; exit 0", limits=Limits(memory=64 * MIB)),
            End.OUT_OF_MEMORY,
            0,
            "container 'a' ran out of memory: its limit is 64 MiB (memory)",
        ),
        (
            Container("a", PYTHON_IMAGE, ("nosuch",)),
            End.EXITED,
            127,
            "container 'a' ended with exit code 127 (its command was not found)",
        ),
        (
            Container("a", PYTHON_IMAGE, ("/etc/passwd",)),
            End.EXITED,
            126,
            "container 'a' ended with exit code 126 (its command is not executable)",
        ),
    ],
)
def test_each_end_has_its_own_message(
    tmp_path: Path, container: Container, end: End, code: int, reason: str | None
) -> None:
    ran = run_task(tmp_path, container)
    [found] = ran.outcome.containers
    assert ran.outcome.reasons == (() if reason is None else (reason,))
    assert (found.end, found.exit_code) == (end, code)
    assert ran.outcome.exit_code == (ExitCode.PASS if reason is None else ExitCode.FAIL)
    assert ran.codes == {"a": code}


def test_a_job_ends_with_its_essential_container(tmp_path: Path) -> None:
    """Two fail, two are stopped, one was never started."""
    stubborn = "import signal, time; signal.signal(15, signal.SIG_IGN); print('up', flush=True); time.sleep(600)"
    ran = run_task(
        tmp_path,
        python(stubborn, "sim", essential=False, readiness=Readiness(log="^up")),
        shell(
            f"trap 'exit 4' TERM; touch {OUTPUT}/traps; while :; do sleep 0.1; done",
            "polite",
            essential=False,
            readiness=Readiness(file=f"{OUTPUT}/traps"),
        ),
        shell(f"touch {OUTPUT}/ends; exit 7", "helper", essential=False),
        shell(f"until [ -e {OUTPUT}/ends ]; do sleep 0.1; done; sleep 1; exit 5", "robot", after=("sim", "polite")),
        shell("true", "never", after=("waits",), essential=False),
        shell("sleep 600", "waits", essential=False, readiness=Readiness(file="/never")),
    )
    assert ran.outcome.reasons == (
        "container 'robot' ended with exit code 5",
        "container 'helper' ended with exit code 7",
    )
    assert {c.name: (c.end, c.exit_code) for c in ran.outcome.containers} == {
        "sim": (End.STOPPED, 137),
        "polite": (End.STOPPED, 4),
        "helper": (End.EXITED, 7),
        "robot": (End.EXITED, 5),
        "never": (End.NOT_STARTED, None),
        "waits": (End.STOPPED, 143),
    }
    assert ran.codes == {"sim": 137, "polite": 4, "helper": 7, "robot": 5, "never": 0, "waits": 143}
    assert ran.logs["sim"].splitlines()[0].startswith("calibration: this user may not add '127.0.0.1 sim polite ")
    assert "up" in ran.logs["sim"].splitlines()


@pytest.mark.parametrize(
    ("container", "settings", "end", "exit_code", "reason"),
    [
        (
            shell("sleep 600", limits=Limits(seconds=1)),
            {},
            End.TIMED_OUT,
            ExitCode.INFRASTRUCTURE,
            "container 'a' ran longer than its 1 s",
        ),
        (
            shell("sleep 600"),
            {"seconds": 1.5},
            End.TIMED_OUT,
            ExitCode.INFRASTRUCTURE,
            "the job ran longer than its 1.5 s: still running were a",
        ),
        (
            shell("sleep 600", readiness=Readiness(port=1, log="up", file="/up", command=("sleep", "60"), seconds=1)),
            {},
            End.NOT_READY,
            ExitCode.FAIL,
            "container 'a' was not ready within 1 s (command sleep 60, file /up, port 1, a line of its log with 'up')",
        ),
    ],
)
def test_limits_in_time(
    tmp_path: Path, container: Container, settings: dict[str, float], end: End, exit_code: ExitCode, reason: str
) -> None:
    ran = run_task(tmp_path, container, **settings)
    assert ran.outcome.reasons == (reason,)
    assert (ran.outcome.exit_code, ran.outcome.containers[0].end) == (exit_code, end)
    assert ran.codes == {"a": 143}  # it has ended on request


def test_one_that_is_killed_as_a_whole(tmp_path: Path) -> None:
    job = Job("job", (shell("sleep 600"), shell("sleep 600", "b")))
    signs, output = Signs(tmp_path / "signs"), tmp_path / "output"
    output.mkdir()
    prepare(TaskJob(job), None, signs, tmp_path, output)  # type: ignore[arg-type]
    with started(job, signs.folder, output) as running:
        watch = Watch(job, signs, output, WatchTimeouts(60, 4, 60))
        thread = threading.Thread(target=watch.run, args=(tmp_path / "artifacts",))
        thread.start()
        wait_until(lambda: signs.has("a", "pid"), "a runs")
        running["a"].kill()
        thread.join(60)
        outcome = watch.outcome(1)
        assert running["b"].wait(timeout=60)["StatusCode"] == 143
    assert outcome.reasons == ("container 'a' ended without an exit code: it was killed",)
    assert outcome.exit_code == ExitCode.FAIL
    assert [c.end for c in outcome.containers] == [End.LOST, End.STOPPED]


def test_one_that_never_comes(tmp_path: Path) -> None:
    """For example because its image has its own entrypoint."""
    ran = run_task(tmp_path, shell("echo ran"), shell("true", "b", image=NONE), timeouts=WatchTimeouts(1))
    assert ran.outcome.exit_code == ExitCode.BAD_INPUT
    [reason] = ran.outcome.reasons
    assert reason == (
        "within 1 s container 'b' did not start: its image cannot be pulled or has no /bin/sh, or its "
        "entrypoint does not execute its arguments"
    )
    assert [c.end for c in ran.outcome.containers] == [End.NOT_STARTED] * 2
    assert (ran.codes, ran.logs) == ({"a": 0}, {"a": ""})


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("exit 0", "container 'server' ended with exit code 0; it was not ready yet (port 1)"),
        ("exit 4", "container 'server' ended with exit code 4; it was not ready yet (port 1)"),
    ],
)
def test_an_end_before_it_is_ready(tmp_path: Path, text: str, reason: str) -> None:
    server = shell(text, "server", readiness=Readiness(port=1), essential=False)
    ran = run_task(tmp_path, server, shell("true", after=("server",)))
    assert ran.outcome.reasons == (reason,)


def test_input_of_a_command(tmp_path: Path) -> None:
    """Arguments, variables, folder and signals arrive unchanged, without interpretation by a shell."""
    show = (
        "import os, signal, sys; print(sys.argv[1:], [os.environ.get(n) for n in ('A', 'B-c', 'PATH')], os.getcwd(), "
        "signal.getsignal(signal.SIGINT) is signal.default_int_handler, os.getuid())"
    )
    arguments = ("$HOME `id` $(id)", "it's", "a\nb\\", "", "*", "-n", "é")
    environment = {"A": "1 '$A' \n2", "B-c": "$(id)", "PATH": "/usr/bin"}
    container = Container(
        "a",
        "",
        ("-c", show, *arguments),
        entrypoint=("python3",),
        environment=environment,
        working_directory="/tmp/w d/é",  # noqa: S108
    )
    ran = run_task(tmp_path, container)
    expected = f"{list(arguments)} {list(environment.values())} /tmp/w d/é True 1000\n"
    assert ran.logs["a"] == expected


def test_names_lead_to_the_one_address(tmp_path: Path) -> None:
    ask = "import socket; print(socket.gethostbyname('server'))"
    ran = run_task(tmp_path, python(ask, user="0"), shell("sleep 600", "server", essential=False))
    assert ran.logs["a"] == "127.0.0.1\n"
    assert ran.outcome.reasons == ()
