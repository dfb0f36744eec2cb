from pathlib import Path
from typing import Any

import pytest

from calibration.base import ExitCode
from calibration.ci.execution.docker import container_run
from calibration.ci.execution.job import Job, Readiness
from calibration.ci.execution.outcome import End
from tests.integration.execution.jobs import python, run_job, run_jobs, shell

SERVE = """
import http.server, threading, time, pathlib
time.sleep(0.4)
server = http.server.HTTPServer(("", 8000), http.server.SimpleHTTPRequestHandler)
pathlib.Path("/tmp/up").touch()
print("serving now", flush=True)
server.serve_forever()
"""
ASK = "import urllib.request as u; print(u.urlopen('http://server:8000/').status)"


@pytest.mark.parametrize(
    ("ready", "network"),
    [
        ({"port": 8000}, "private"),
        ({"port": 8000}, "internal"),
        ({"log": r"serving \w+"}, "private"),
        ({"file": "/tmp/up"}, "private"),  # noqa: S108
        ({"port": 8000, "log": "serving", "command": ("test", "-e", "/tmp/up")}, "internal"),  # noqa: S108
    ],
)
def test_who_comes_after_finds_it_ready(tmp_path: Path, ready: dict[str, Any], network: Any) -> None:
    server = python(SERVE, "server", readiness=Readiness(**ready), essential=False)
    outcome = run_job(tmp_path, python(ASK, "client", after=("server",)), server, network=network)
    assert outcome.reasons == ()
    assert (outcome.folder / "logs" / "client.log").read_text() == "200\n"


@pytest.mark.parametrize("network", ["none", "private"])
def test_a_port_out_of_reach_is_looked_up_in_the_container(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, network: Any
) -> None:
    if network == "private":  # as with Docker Desktop, whose containers are unreachable from here

        def unreachable(*_: object) -> None:
            raise TimeoutError

        monkeypatch.setattr(container_run.socket, "create_connection", unreachable)
    server = python(SERVE, "server", readiness=Readiness(port=8000), essential=False)
    never = python(SERVE, "server", readiness=Readiness(port=8001, seconds=2), essential=False)
    after = shell("true", "client", after=("server",))
    fine, not_ready = run_jobs(
        tmp_path, Job("fine", (server, after), network), Job("never", (never, after), network), workers=2
    )
    assert fine.reasons == ()
    [reason] = not_ready.reasons
    assert reason.startswith("container 'server' was not ready within 2 s (port 8001)")


def test_never_ready_is_the_softwares_fault(tmp_path: Path) -> None:
    ready = Readiness(port=1, log="up", file="/up", command=("sleep", "60"), seconds=1)
    outcome = run_job(
        tmp_path, shell("sleep 600", "server", readiness=ready), shell("true", "client", after=("server",))
    )
    assert outcome.exit_code == ExitCode.FAIL
    missing = "command sleep 60, file /up, port 1, a line of its log with 'up'"
    assert outcome.reasons == (f"container 'server' was not ready within 1 s ({missing})",)
    assert [c.end for c in outcome.containers] == [End.NOT_READY, End.NOT_STARTED]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("exit 0", "container 'server' ended with exit code 0; it was not ready yet (port 8000)"),
        ("echo no; exit 4", "container 'server' ended with exit code 4: no; it was not ready yet (port 8000)"),
    ],
)
def test_an_end_before_it_is_ready(tmp_path: Path, text: str, reason: str) -> None:
    server = shell(text, "server", readiness=Readiness(port=8000), essential=False)
    outcome = run_job(tmp_path, server, shell("true", after=("server",)))
    assert outcome.reasons == (reason,)
    assert outcome.exit_code == ExitCode.FAIL
