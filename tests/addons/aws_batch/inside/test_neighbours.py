import json
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest

from calibration.addons.aws_batch.inside import watch as watching
from calibration.addons.aws_batch.inside.script import BEAT_FILE, Signs
from calibration.addons.aws_batch.inside.watch import METADATA_VARIABLE, Watch, WatchTimeouts, ended_neighbours
from calibration.base import ExitCode
from calibration.ci.execution.job import Container, Job


class Metadata(HTTPServer):
    """Stand-in of ECS's metadata, which records its requests."""

    answer = b"{}"
    asked: str = ""


class _Handler(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        assert isinstance(self.server, Metadata)
        self.server.asked = self.path
        self.send_response(200)
        self.end_headers()
        self.wfile.write(self.server.answer)

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def ecs() -> Iterator[Metadata]:
    server = Metadata(("127.0.0.1", 0), _Handler)
    thread = threading.Thread(target=server.serve_forever, args=(0.05,))
    thread.start()
    yield server
    server.shutdown()
    thread.join()
    server.server_close()


def ask(ecs: Metadata) -> dict[str, int | None]:
    return ended_neighbours({METADATA_VARIABLE: f"http://127.0.0.1:{ecs.server_port}/v4/x"})


def test_those_that_have_ended(ecs: Metadata) -> None:
    containers = [
        {"Name": "prepare", "KnownStatus": "STOPPED", "ExitCode": 0},
        {"Name": "robot", "KnownStatus": "STOPPED"},
        {"Name": "sim", "KnownStatus": "RUNNING"},
    ]
    ecs.answer = json.dumps({"Cluster": "c", "Containers": containers}).encode()
    assert ask(ecs) == {"prepare": 0, "robot": None}
    assert ecs.asked == "/v4/x/task"


@pytest.mark.parametrize("answer", [b"", b"{}", b"[]", b'{"Containers": [1]}', b'{"Containers": 1}', b"[" * 100_000])
def test_an_invalid_answer(ecs: Metadata, answer: bytes) -> None:
    ecs.answer = answer
    assert ask(ecs) == {}


def test_without_metadata() -> None:
    assert ended_neighbours({}) == {}
    assert ended_neighbours({METADATA_VARIABLE: "file:///etc"}) == {}
    assert ended_neighbours({METADATA_VARIABLE: "http://127.0.0.1:1"}) == {}


@pytest.mark.parametrize(("code", "how"), [(2, " with exit code 2"), (None, "")])
def test_one_that_ended_before_it_could_be_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int | None, how: str
) -> None:
    """The time-out of the job must not pass before."""
    monkeypatch.setattr(watching, "_SECONDS_BETWEEN_REQUESTS", 0.1)
    job = Job("j", (Container("a", ""), Container("b", "")))
    signs = Signs(tmp_path)
    signs.make(job)
    (tmp_path / "state" / "a" / BEAT_FILE).touch()
    watch = Watch(job, signs, tmp_path, WatchTimeouts(60), lambda: {"a": 0, "b": code})
    watch.run(tmp_path / "artifacts")
    found = watch.outcome(1)
    assert found.reasons == (
        (
            f"container 'b' ended at once{how}: its image cannot be pulled or has no /bin/sh, or its "
            "entrypoint does not execute its arguments"
        ),
    )
    assert found.exit_code == ExitCode.BAD_INPUT
    assert (tmp_path / "stop").exists()
