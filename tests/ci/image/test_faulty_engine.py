"""Faulty answers of an engine become one line for the user."""

import json

import docker
import pytest

from calibration.base import InfrastructureError
from calibration.ci.github.service import GITHUB
from calibration.ci.image.build_request import BuildFailedError, BuildLog, BuildRequest
from calibration.ci.image.builders import build_by_engine
from calibration.ci.image.context import Context
from calibration.ci.image.plan import fetch
from calibration.ci.registries.reference import Credentials
from calibration.ci.workflow import Runner
from tests.ci.registries.server import Reply, serve

STEP = {"stream": "Step 1/1 : RUN x"}


def log() -> BuildLog:
    return BuildLog(Runner(GITHUB), lambda *_, **__: None)


def build(*replies: Reply) -> str:
    """Build with an engine that gives these answers, and repeats the last one."""
    context = Context()
    context.add_bytes("Dockerfile", b"FROM x")
    left = list(replies)
    with serve(lambda _: left.pop(0) if len(left) > 1 else left[0]) as server:
        client = docker.DockerClient(base_url=f"tcp://{server.address}", version="1.41", timeout=60)
        try:
            return build_by_engine(client, BuildRequest("robot", context, "Dockerfile"), log())
        finally:
            client.close()


def message(text: str, status: int = 500) -> Reply:
    return Reply(status, json.dumps({"message": text}).encode(), {"Content-Type": "application/json"})


@pytest.mark.parametrize(
    ("reply", "kind", "said"),
    [
        (message("no space left on device"), InfrastructureError, "the build broke off: no space left on device"),
        (message("unknown instruction: FORM", 400), BuildFailedError, "image robot: unknown instruction: FORM"),
        (Reply(reset=True), InfrastructureError, "the engine broke off the build"),
        (Reply(body=b"<html>"), InfrastructureError, "the engine broke off the build"),
        (Reply(body=json.dumps(STEP).encode()), InfrastructureError, "the engine ended without an image"),
        (
            Reply(body=json.dumps({"error": "it broke", "errorDetail": "not a mapping"}).encode()),
            BuildFailedError,
            "image robot: it broke",
        ),
    ],
)
def test_a_build(reply: Reply, kind: type[Exception], said: str) -> None:
    with pytest.raises(kind, match=said) as error:
        build(reply)
    assert str(error.value).isprintable()


GONE = Reply(body=json.dumps({"errorDetail": {"message": f"unknown parent image ID sha256:{'0' * 64}"}}).encode())


def test_a_layer_removed_during_the_build() -> None:
    built = Reply(body=json.dumps({"aux": {"ID": "sha256:1"}}).encode())
    assert build(GONE, GONE, built) == "sha256:1"
    with pytest.raises(
        InfrastructureError, match=r"^image robot: layers of this build were removed by another process: run it again$"
    ):
        build(GONE)


def test_a_pull_that_the_engine_refuses() -> None:
    replies = iter([message("no such image", 404), message("dial tcp: lookup r: no such host")])
    with serve(lambda _: next(replies)) as server:
        client = docker.DockerClient(base_url=f"tcp://{server.address}", version="1.41", timeout=60)
        with pytest.raises(InfrastructureError, match=r"image 'r/x': it cannot be pulled: .*no such host"):
            fetch(client, "r/x", lambda _: Credentials("docker.io"), None, log())
        client.close()
