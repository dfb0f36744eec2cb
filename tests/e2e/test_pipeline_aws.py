"""The workflow's step that asks for a role in AWS, with a token service and an AWS on this machine."""

import os
import subprocess
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import boto3
import pytest
import yaml
from moto.server import ThreadedMotoServer

from .pipeline import WORKFLOW

STEP: dict[str, Any] = next(
    step
    for step in yaml.safe_load(WORKFLOW.read_text())["jobs"]["image"]["steps"]
    if step.get("name") == "Ask for the role in AWS"
)
ROLE = "arn:aws:iam::123456789012:role/robots/push"
PLANTED = "runner-token"


class TokenService(BaseHTTPRequestHandler):
    """What GitHub gives a job that may ask for tokens."""

    def do_GET(self) -> None:
        right = (
            self.headers["Authorization"] == f"bearer {PLANTED}" and self.path == "/t?v=1&audience=sts.amazonaws.com"
        )
        self.send_response(200 if right else 403)
        self.end_headers()
        self.wfile.write(b'{"count":1,"value":"eyJ.planted.jwt"}')

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def service() -> Iterator[str]:
    with HTTPServer(("127.0.0.1", 0), TokenService) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/t?v=1"
        server.shutdown()


def ask(folder: Path, role: str = ROLE, region: str = "eu-west-1", **variables: str) -> tuple[int, str]:
    environment = {"PATH": os.environ["PATH"], "RUNNER_TEMP": str(folder), "ROLE": role, "REGION": region}
    done = subprocess.run(
        ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", STEP["run"]],
        env=environment | {f"ACTIONS_ID_TOKEN_REQUEST_{name}": value for name, value in variables.items()},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=60,
        check=False,
    )
    return done.returncode, done.stdout


def test_aws_takes_the_token_for_the_role(service: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code, log = ask(tmp_path, URL=service, TOKEN=PLANTED)
    assert code == 0, log
    assert log == "::add-mask::eyJ.planted.jwt\n"
    configuration = tmp_path / "calibration-aws" / "config"
    assert (configuration.stat().st_mode & 0o077, (configuration.parent / "token").stat().st_mode & 0o077) == (0, 0)

    server = ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    server.start()
    try:
        for name in [name for name in os.environ if name.startswith("AWS_")]:
            monkeypatch.delenv(name)
        monkeypatch.setenv("AWS_CONFIG_FILE", str(configuration))
        monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
        host, port = server.get_host_and_port()
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
        session = boto3.session.Session()
        assert session.region_name == "eu-west-1"
        client = session.client("sts")
        assert ":assumed-role/push/" in client.get_caller_identity()["Arn"]
        client.close()
    finally:
        server.stop()


def test_a_job_that_may_not_ask_goes_on_with_a_warning(tmp_path: Path) -> None:
    code, log = ask(tmp_path)
    assert code == 0
    assert log.startswith("::warning::aws-role is not used")
    assert not (tmp_path / "calibration-aws").exists()


def test_a_service_that_refuses_is_told_in_one_line(service: str, tmp_path: Path) -> None:
    code, log = ask(tmp_path, URL=service, TOKEN="wrong")  # noqa: S106
    assert code == 3
    assert log.splitlines()[-1] == "::error::aws-role: GitHub's token service gives no token"
    assert not (tmp_path / "calibration-aws" / "token").exists()


@pytest.mark.parametrize(
    ("role", "region"),
    [("push", "eu-west-1"), (ROLE + "\nsource_profile = x", "eu-west-1"), (ROLE, "eu west"), (ROLE, "")],
)
def test_what_is_no_role_or_region_is_refused(role: str, region: str, tmp_path: Path) -> None:
    code, log = ask(tmp_path, role, region, TOKEN=PLANTED)
    assert code == 2
    assert log.startswith("::error::aws-role or aws-region is none")
