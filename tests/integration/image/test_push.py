import base64
import io
import json
from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

from calibration.base import CalibrationError, InfrastructureError, InputError
from calibration.ci.registries.push import push_image
from calibration.ci.registries.reference import Credentials
from calibration.ci.registries.registry import RegistryClient
from calibration.ci.workflow import Runner
from calibration.ci.workflow.streams import progress
from tests.ci.registries.server import Reply, Request, serve
from tests.docker_engine import Registry
from tests.integration.image.registries import faulty, fresh_name, small_image

if TYPE_CHECKING:
    from docker import DockerClient

PASSWORD = "pl4nted-password"  # noqa: S105


def test_one_image_under_every_tag(engine: "DockerClient", registry: Registry) -> None:
    name, log = fresh_name(registry.address), io.StringIO()
    with small_image(engine, name, "key-1"), progress(Runner(stdout=log), "push") as advance:
        digest = push_image(engine, f"{name}:key-1", ["v1", "latest", "key-1"], None, advance)
        with RegistryClient() as client:
            assert {client.find_manifest(f"{name}:{tag}") for tag in ("key-1", "v1", "latest")} == {digest}
        assert digest in engine.images.get(f"{name}:key-1").attrs["RepoDigests"][0]
        assert log.getvalue().startswith("[1/1] layer ")
        assert " pushed" in log.getvalue()
        assert push_image(engine, f"{name}:key-1", [], None, advance) == digest
    assert log.getvalue().splitlines()[1].endswith(" is there already")


def test_a_registry_with_a_password(engine: "DockerClient", private_registry: Registry) -> None:
    name = fresh_name(private_registry.address)
    known = Credentials(private_registry.address, private_registry.user, private_registry.password)
    with small_image(engine, name, "key-1"):
        with pytest.raises(InputError, match="not logged in: set"):
            push_image(engine, f"{name}:key-1", [], None)
        wrong = Credentials(private_registry.address, private_registry.user, PASSWORD)
        with pytest.raises(InputError) as caught:
            push_image(engine, f"{name}:key-1", [], wrong)
        assert f"check the password of {private_registry.user}" in str(caught.value)
        assert PASSWORD not in str(caught.value)
        assert push_image(engine, f"{name}:key-1", ["v1"], known).startswith("sha256:")


def test_an_image_that_the_engine_does_not_have(engine: "DockerClient", registry: Registry) -> None:
    with pytest.raises(InputError, match="the engine has no such image to push"):
        push_image(engine, f"{registry.address}/calibration-test/none:v1", [], None)


def uploads(status: int, code: str, message: str) -> Callable[[Request], Reply | None]:
    """Return a fault of a registry that refuses layers."""
    body = json.dumps({"errors": [{"code": code, "message": message}]}).encode()
    refusal = Reply(status, body, {"Content-Type": "application/json"})
    return lambda request: refusal if request.path.endswith("/blobs/uploads/") else None


@pytest.mark.parametrize(
    ("fault", "error", "message"),
    [
        (uploads(403, "DENIED", "not yours"), InputError, "denies access (denied: not yours); check the password of"),
        (uploads(404, "NAME_UNKNOWN", "no such repository"), InputError, "has no such repository (name unknown: "),
        (uploads(403, "DENIED", f"not with {PASSWORD}"), InputError, "(denied: not with ***)"),
    ],
)
def test_permanent_failures_are_not_retried(
    engine: "DockerClient",
    registry: Registry,
    fault: Callable[[Request], Reply | None],
    error: type[CalibrationError],
    message: str,
) -> None:
    pauses: list[float] = []
    with faulty(registry.address, fault) as server:
        name = fresh_name(server.address)
        with small_image(engine, name, "v1"), pytest.raises(error) as caught:
            push_image(engine, f"{name}:v1", [], Credentials(server.address, "robot", PASSWORD), pause=pauses.append)
    assert str(caught.value).startswith(f"{name}:v1: ")
    assert message in str(caught.value)
    assert PASSWORD not in str(caught.value)
    assert pauses == []


def test_temporary_failures_are_retried(engine: "DockerClient", registry: Registry) -> None:
    pauses: list[float] = []
    left = [Reply(503), Reply(503)]

    def fault(request: Request) -> Reply | None:
        return left.pop() if left and request.method == "PUT" and "/manifests/" in request.path else None

    with faulty(registry.address, fault) as server:
        name = fresh_name(server.address)
        with small_image(engine, name, "v1"):
            digest = push_image(engine, f"{name}:v1", ["v2"], None, pause=pauses.append)
    assert pauses == [1.0, 2.0]
    with RegistryClient() as client:
        assert client.find_manifest(name.replace(server.address, registry.address) + ":v2") == digest


def test_persistent_failures_end_the_retries(engine: "DockerClient", registry: Registry) -> None:
    pauses: list[float] = []

    def fault(request: Request) -> Reply | None:
        return Reply(503, b"<html>") if request.method == "PUT" and "/manifests/" in request.path else None

    with faulty(registry.address, fault) as server:
        name = fresh_name(server.address)
        with (
            small_image(engine, name, "v1"),
            pytest.raises(InfrastructureError, match=r"the push failed: .* \(4 attempts\)"),
        ):
            push_image(engine, f"{name}:v1", [], None, pause=pauses.append)
    assert pauses == [1.0, 2.0, 4.0]


def test_no_registry(engine: "DockerClient") -> None:
    with serve(lambda _: Reply()) as server:
        pass
    name = fresh_name(server.address)
    with small_image(engine, name, "v1"), pytest.raises(InfrastructureError, match=r"refused.* \(4 attempts\)"):
        push_image(engine, f"{name}:v1", [], None, pause=lambda _: None)


def test_a_registry_that_loses_the_image(engine: "DockerClient", registry: Registry) -> None:
    def fault(request: Request) -> Reply | None:
        lost = request.method in ("GET", "HEAD") and "/manifests/" in request.path
        return Reply(404) if lost else None

    with faulty(registry.address, fault) as server:
        name = fresh_name(server.address)
        with (
            small_image(engine, name, "v1"),
            pytest.raises(InfrastructureError, match="does not have the image that was pushed"),
        ):
            push_image(engine, f"{name}:v1", [], None)


def test_a_registry_that_has_something_else_afterwards(engine: "DockerClient", registry: Registry) -> None:
    other = {"Docker-Content-Digest": "sha256:" + "0" * 64}

    def fault(request: Request) -> Reply | None:
        return Reply(200, headers=other) if request.method == "HEAD" and request.path.endswith("manifests/v1") else None

    with faulty(registry.address, fault) as server:
        name = fresh_name(server.address)
        with (
            small_image(engine, name, "v1"),
            pytest.raises(InfrastructureError, match="does not have the image that was pushed"),
        ):
            push_image(engine, f"{name}:v1", [], None)


def test_the_password_is_on_no_line(engine: "DockerClient", private_registry: Registry) -> None:
    known = Credentials(private_registry.address, private_registry.user, private_registry.password)
    name, log = fresh_name(private_registry.address), io.StringIO()
    with small_image(engine, name, "v1"), progress(Runner(stdout=log), "push") as advance:
        push_image(engine, f"{name}:v1", ["v2"], known, advance)
        kept = f"{engine.images.get(f'{name}:v1').attrs}{engine.images.get(f'{name}:v1').history()}"
    pair = base64.b64encode(f"{known.username}:{known.password}".encode()).decode()
    for secret in (known.password, pair):
        assert secret not in log.getvalue() + kept + repr(known)


def engine_at(url: str) -> "DockerClient":
    import docker

    return docker.DockerClient(url, version="1.41")


def test_an_engine_that_is_gone() -> None:
    pytest.importorskip("docker", reason="needs the package docker")
    with serve(lambda _: Reply()) as server:
        pass
    nowhere = engine_at(f"tcp://{server.address}")
    with pytest.raises(InfrastructureError, match="the engine broke off the push"):
        push_image(nowhere, "127.0.0.1:1/robot:v1", [], None)
    nowhere.close()


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (Reply(200, b'{"status": "done"}'), "the engine ended without a digest"),
        (Reply(200, b"[]"), "the engine ended without a digest"),
        (Reply(200, b'{"error": ""}'), "no reason"),
        (Reply(200, b'{"errorDetail": 3}'), "no reason"),
        (Reply(200, b"<html>"), "the engine broke off the push"),
        (Reply(500, b'{"message": "disk full"}'), "the push failed: disk full"),
        (Reply(200, b'{"error": "x509: unknown authority"}'), "not trusted by the engine"),
    ],
)
def test_something_else_than_a_push(answer: Reply, message: str) -> None:
    pytest.importorskip("docker", reason="needs the package docker")
    with serve(lambda _: answer) as server:
        other = engine_at(f"tcp://{server.address}")
        try:
            with pytest.raises(CalibrationError, match=message):
                push_image(other, "127.0.0.1:1/robot:v1", [], None, pause=lambda _: None)
        finally:
            other.close()
