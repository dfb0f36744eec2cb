from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("docker")

from calibration.ci.execution.job import Container, Readiness
from tests.addons.aws_batch.integration.inside.tasks import run_task
from tests.docker_engine import free_port
from tests.integration.execution.jobs import python, shell

SERVE = """
import http.server, os, pathlib, time
time.sleep(0.3)
server = http.server.HTTPServer(("127.0.0.1", int(os.environ["PORT"])), http.server.SimpleHTTPRequestHandler)
pathlib.Path("/tmp/up").touch()
print("serving now", flush=True)
server.serve_forever()
"""


@pytest.mark.thorough
@pytest.mark.parametrize(
    "ready",
    [
        {"port": True},
        {"log": r"serving \w+"},
        {"file": "/tmp/up"},  # noqa: S108
        {"port": True, "log": "serving", "command": ("sh", "-c", 'test -e /tmp/up -a "$PORT" -gt 1')},
    ],
)
def test_who_comes_after_finds_it_ready(tmp_path: Path, ready: dict[str, Any]) -> None:
    port = free_port()
    readiness = Readiness(**{name: port if value is True else value for name, value in ready.items()})
    environment = {"PORT": str(port)}
    server = python(SERVE, "server", readiness=readiness, essential=False, environment=environment)
    ask = f"import urllib.request as u; print(u.urlopen('http://127.0.0.1:{port}/').status)"
    ran = run_task(tmp_path, python(ask, "client", after=("server",)), server, network_mode="host")
    assert ran.outcome.reasons == ()
    assert ran.logs["client"].endswith("200\n")
    assert [c.name for c in ran.outcome.containers] == ["server", "client"]


def test_output_that_is_looked_at_stays_complete(tmp_path: Path) -> None:
    """Both streams, in order, larger than the pipe's buffer; a child that keeps the pipe open does not block."""
    text = "sleep 60 & seq 20000; echo up >&2; seq 3; exit 3"
    ran = run_task(tmp_path, shell(text, readiness=Readiness(log="^up$")))
    numbers = [str(number) for number in range(1, 20001)]
    assert ran.logs["a"].splitlines() == [*numbers, "up", "1", "2", "3"]
    assert ran.outcome.reasons == ("container 'a' ended with exit code 3",)


def test_a_command_that_is_asked_again(tmp_path: Path) -> None:
    count = 'n=$(cat /tmp/n 2>/dev/null); echo "x$n" > /tmp/n; [ "$n" = xx ]'
    server = Container("server", "", ("sleep", "60"), essential=False, readiness=Readiness(command=("sh", "-c", count)))
    ran = run_task(tmp_path, server, shell("true", after=("server",)))
    assert ran.outcome.reasons == ()
