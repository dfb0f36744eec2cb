"""Connection to missing engines, and conversion of the errors of existing ones."""

from pathlib import Path

import pytest

pytest.importorskip("docker")

import docker.errors
import requests

from calibration.base import InfrastructureError, InputError
from calibration.ci.docker_engine import EngineLostError, connect, engine_available, engine_errors


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("unix:///nosuch.sock", "no Docker Engine answers at unix:///nosuch.sock: No such file or directory; start it"),
        ("tcp://127.0.0.1:1", "no Docker Engine answers at tcp://127.0.0.1:1: Connection refused; start it, or set"),
        ("nonsense", "no Docker Engine answers at nonsense: "),
        ("ssh://nobody@127.0.0.1", "Install paramiko package"),
    ],
)
def test_no_engine_is_one_line(monkeypatch: pytest.MonkeyPatch, address: str, message: str) -> None:
    monkeypatch.setenv("DOCKER_HOST", address)
    with pytest.raises(InfrastructureError) as caught:
        connect(5)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400
    assert not engine_available()


def test_no_engine_answers_at_a_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "docker.sock").write_text("")
    monkeypatch.setenv("DOCKER_HOST", f"unix://{tmp_path}/docker.sock")
    with pytest.raises(InfrastructureError, match="Connection refused"):
        connect(5)


def api_error(status: int, said: str) -> docker.errors.APIError:
    response = requests.Response()
    response.status_code = status
    return docker.errors.APIError("failed", response=response, explanation=said)


@pytest.mark.parametrize(
    ("error", "kind", "message"),
    [
        (api_error(400, "no command\nspecified"), InputError, "here: the Docker Engine reports: no command specified"),
        (api_error(500, "unable to find user x"), InputError, "unable to find user x"),
        (
            api_error(500, "layer does not exist"),
            InfrastructureError,
            "here: the Docker Engine reports: layer does not exist",
        ),
        (requests.ConnectionError("gone"), EngineLostError, "does not answer any more: gone"),
        (requests.exceptions.ChunkedEncodingError("cut"), EngineLostError, "does not answer any more: cut"),
        (ConnectionResetError(104, "Connection reset by peer"), EngineLostError, "any more: Connection reset by peer"),
        (TimeoutError("timed out"), EngineLostError, "any more: timed out"),
        (docker.errors.DockerException(), EngineLostError, "any more: DockerException"),
    ],
)
def test_whose_fault_it_is(error: Exception, kind: type[Exception], message: str) -> None:
    with pytest.raises(kind) as caught, engine_errors("here"):
        raise error
    assert type(caught.value) is kind
    assert message in str(caught.value)
