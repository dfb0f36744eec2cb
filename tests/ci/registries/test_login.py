import base64
import io
import json
import stat
from pathlib import Path

import pytest

from calibration.base import CalibrationError, InfrastructureError, InputError
from calibration.ci.github.service import GITHUB
from calibration.ci.registries.reference import Credentials, RegistrySettings
from calibration.ci.registries.registry import registry_login
from calibration.ci.workflow import Runner

PASSWORD = "pl4nted-password"  # noqa: S105
NAME = "ghcr.io/team/robot:v1"


@pytest.fixture(autouse=True)
def docker_config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the path of docker's configuration, with no logins."""
    monkeypatch.setenv("DOCKER_CONFIG", str(tmp_path / "docker"))
    file = tmp_path / "docker" / "config.json"
    file.parent.mkdir()
    file.write_text("{}")
    return file


@pytest.fixture
def log() -> io.StringIO:
    return io.StringIO()


@pytest.fixture
def runner(log: io.StringIO) -> Runner:
    return Runner(GITHUB, stdout=log)


def login(registry: str) -> dict[str, dict[str, str]]:
    return {registry: {"auth": base64.b64encode(f"robot:{PASSWORD}".encode()).decode()}}


def test_the_user_and_variable_of_the_settings(runner: Runner, log: io.StringIO) -> None:
    settings = RegistrySettings("robot", "TOKEN", insecure=True)
    found = registry_login(settings, NAME, runner, {"TOKEN": f"{PASSWORD}\n"})
    assert found == Credentials("ghcr.io", "robot", PASSWORD, insecure=True)
    lines = log.getvalue().splitlines()
    assert f"::add-mask::{PASSWORD}" in lines
    assert f"::add-mask::{base64.b64encode(f'robot:{PASSWORD}'.encode()).decode()}" in lines
    assert all(line.startswith("::add-mask::") for line in lines)
    assert PASSWORD not in repr(found)
    assert found.auth_config() == {"username": "robot", "password": PASSWORD, "serveraddress": "ghcr.io"}


def test_the_variables_of_the_process(runner: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOKEN", PASSWORD)
    assert registry_login(RegistrySettings("robot", "TOKEN"), NAME, runner).password == PASSWORD


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (RegistrySettings("robot"), "registry: password-variable is not given"),
        (RegistrySettings(None, "TOKEN"), "registry: username is not given"),
        (RegistrySettings("robot", "TOKEN"), "registry: the environment variable TOKEN is not set or empty"),
        (RegistrySettings("robot", "EMPTY"), "registry: the environment variable EMPTY is not set or empty"),
    ],
)
def test_settings_that_are_not_complete(runner: Runner, settings: RegistrySettings, message: str) -> None:
    with pytest.raises(InputError) as caught:
        registry_login(settings, NAME, runner, {"EMPTY": " \n"})
    assert str(caught.value).startswith(message)


@pytest.mark.parametrize(
    ("key", "name", "registry"),
    [
        ("ghcr.io", NAME, "ghcr.io"),
        ("https://ghcr.io/v2/", NAME, "ghcr.io"),
        ("127.0.0.1:5000", "127.0.0.1:5000/robot", "127.0.0.1:5000"),
        ("https://index.docker.io/v1/", "team/robot", "docker.io"),
    ],
)
def test_the_login_of_docker(runner: Runner, docker_config: Path, key: str, name: str, registry: str) -> None:
    docker_config.write_text(json.dumps({"auths": login(key)}))
    assert registry_login(None, name, runner, {}) == Credentials(registry, "robot", PASSWORD)


@pytest.mark.parametrize("document", [{}, {"auths": {}}, {"auths": login("quay.io")}, {"auths": {"ghcr.io": {}}}])
def test_without_a_login(runner: Runner, log: io.StringIO, docker_config: Path, document: object) -> None:
    docker_config.write_text(json.dumps(document))
    found = registry_login(None, NAME, runner, {})
    assert found == Credentials("ghcr.io")
    assert found.anonymous
    assert found.auth_config() == {}
    assert log.getvalue() == ""


def helper(folder: Path, monkeypatch: pytest.MonkeyPatch, script: str) -> None:
    program = folder / "docker-credential-calibrationtest"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", str(folder), prepend=":")


@pytest.mark.parametrize(
    ("user", "expected"),
    [
        ("robot", Credentials("ghcr.io", "robot", PASSWORD)),
        ("<token>", Credentials("ghcr.io", identity_token=PASSWORD)),
    ],
)
def test_a_credential_helper(
    runner: Runner, docker_config: Path, monkeypatch: pytest.MonkeyPatch, user: str, expected: Credentials
) -> None:
    docker_config.write_text(json.dumps({"credHelpers": {"ghcr.io": "calibrationtest"}}))
    answer = json.dumps({"ServerURL": "ghcr.io", "Username": user, "Secret": PASSWORD})
    helper(docker_config.parent, monkeypatch, f"cat >/dev/null; echo '{answer}'")
    found = registry_login(None, NAME, runner, {})
    assert found == expected
    assert PASSWORD in found.auth_config().values()
    assert found.auth_config()["serveraddress"] == "ghcr.io"


def test_a_credential_helper_that_fails(runner: Runner, docker_config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    docker_config.write_text(json.dumps({"credHelpers": {"ghcr.io": "calibrationtest"}}))
    helper(docker_config.parent, monkeypatch, "cat >/dev/null; echo locked >&2; echo locked; exit 1")
    with pytest.raises(InfrastructureError, match=r"ghcr\.io: docker's own login cannot be read: .*locked"):
        registry_login(None, NAME, runner, {})


@pytest.mark.parametrize(
    "text",
    [
        '{"auths": {"ghcr.io": {"auth": "%%"}}}',
        '{"auths": {"ghcr.io": {"auth": "AAAA"}}}',
        '{"auths": {"ghcr.io": {"auth": 3}}}',
        '{"auths": 3}',
        "[1]",
        '{"auths": {"ghcr.io": 3}}',
    ],
)
def test_a_broken_file_of_logins(runner: Runner, docker_config: Path, text: str) -> None:
    docker_config.write_text(text)
    with pytest.raises(CalibrationError, match=r"ghcr\.io: docker's (own login|config\.json) cannot be read"):
        registry_login(None, NAME, runner, {})


def test_the_settings_win(runner: Runner, docker_config: Path) -> None:
    docker_config.write_text(json.dumps({"auths": login("ghcr.io")}))
    found = registry_login(RegistrySettings("other", "TOKEN"), NAME, runner, {"TOKEN": "t"})
    assert (found.username, found.password) == ("other", "t")


def test_the_login_of_docker_is_before_aws(runner: Runner, docker_config: Path) -> None:
    """Because the user may have logged in with other tools."""
    registry = "123456789012.dkr.ecr.eu-west-1.amazonaws.com"
    docker_config.write_text(json.dumps({"auths": login(registry)}))
    assert registry_login(None, f"{registry}/robot", runner, {}) == Credentials(registry, "robot", PASSWORD)
