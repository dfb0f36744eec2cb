"""`calibrate-matrix --image` with an image that only a user of its registry may see."""

import secrets
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from calibration.__main__ import main, run_action
from calibration.commands.parameters import PASSWORD_VARIABLE
from tests.docker_engine import Registry

if TYPE_CHECKING:
    from docker import DockerClient

DATASET = Path(__file__).parents[3] / "datasets" / "riwbot"
COMMAND = "sh -c \"printf 'Collection #,RMS (pix)\\nAverages,0.5\\n' > {output}/t.csv\""


@pytest.fixture
def image(engine: "DockerClient", base_image: str, private_registry: Registry) -> Iterator[str]:
    """An image in the private registry, which the engine does not have."""
    name = f"{private_registry.address}/private-{secrets.token_hex(4)}/robot"
    engine.images.get(base_image).tag(name, "1")
    login = {"username": private_registry.user, "password": private_registry.password}
    for event in engine.api.push(name, "1", stream=True, decode=True, auth_config=login):
        assert "error" not in event
    engine.api.remove_image(f"{name}:1")
    yield f"{name}:1"
    for left in engine.images.list(name):
        for tag in left.tags:
            if tag.startswith(name):
                engine.api.remove_image(tag)


@pytest.fixture
def calibrate(
    image: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str]]:
    """Return a call of the action with the image; it gives the exit code and the log."""
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    monkeypatch.setenv("DOCKER_CONFIG", str(tmp_path))  # nobody is logged in
    inputs = {"DATASET": str(DATASET), "IMAGE": image, "COMMAND": COMMAND, "OUTPUT": str(tmp_path / "out")}
    inputs["CALIBRATED"] = "none"  # it leaves a table alone

    def run(username: str = "", password: str = "") -> tuple[int, str]:
        given = {**inputs, "REGISTRY_USERNAME": username, "REGISTRY_PASSWORD": password}
        for name, value in given.items():
            monkeypatch.setenv(f"INPUT_{name}", value)
        code = run_action("calibrate-matrix")
        out, err = capfd.readouterr()
        return code, out + err

    return run


def test_with_a_login_it_is_pulled(
    calibrate: Callable[..., tuple[int, str]], private_registry: Registry, image: str, engine: "DockerClient"
) -> None:
    code, log = calibrate(private_registry.user, private_registry.password)
    assert code == 0, log
    assert engine.images.get(image)
    lines = log.splitlines()
    masked = [i for i, line in enumerate(lines) if line == f"::add-mask::{private_registry.password}"]
    assert masked[0] < min(i for i, line in enumerate(lines) if "::group::" in line)  # before anything is printed
    assert not [line for line in lines if private_registry.password in line and not line.startswith("::add-mask::")]
    code, log = calibrate()  # it is there now
    assert code == 0, log


@pytest.mark.parametrize(
    ("user", "password"), [("", ""), ("robot", "wrong password"), ("nobody", "correct horse battery staple")]
)
def test_without_the_right_login_it_is_one_line(
    user: str, password: str, calibrate: Callable[..., tuple[int, str]], image: str
) -> None:
    code, log = calibrate(user, password)
    assert code == 2
    [line] = [line for line in log.splitlines() if line.startswith("error: ")]
    assert image in line
    assert "log in" in line
    assert not password or password not in line
    assert "Traceback" not in log


def test_a_registry_that_does_not_answer_is_an_infrastructure_error(
    engine: "DockerClient", monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = ["--dataset", str(DATASET), "--image", "127.0.0.1:1/robot:1", "--command", COMMAND]
    monkeypatch.setenv(PASSWORD_VARIABLE, "secret words")
    assert main(["calibrate-matrix", *arguments, "--registry-username", "robot"]) == 3
