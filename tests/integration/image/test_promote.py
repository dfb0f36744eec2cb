import hashlib
import io
import json
from typing import TYPE_CHECKING

import pytest

from calibration.base import InputError
from calibration.ci.registries.push import promote, push_image
from calibration.ci.registries.reference import Credentials, RegistrySettings
from calibration.ci.registries.registry import Manifest, RegistryClient, registry_login
from calibration.ci.workflow import Runner
from tests.ci.registries.server import Reply, Request
from tests.docker_engine import Registry
from tests.integration.image.registries import faulty, fresh_name, small_image

if TYPE_CHECKING:
    from docker import DockerClient


@pytest.fixture
def log() -> io.StringIO:
    return io.StringIO()


@pytest.fixture
def runner(log: io.StringIO) -> Runner:
    return Runner(stdout=log)


def test_the_same_digest_gets_the_tags(
    engine: "DockerClient", registry: Registry, runner: Runner, log: io.StringIO
) -> None:
    name = fresh_name(registry.address)
    with small_image(engine, name, "key-1"):
        digest = push_image(engine, f"{name}:key-1", [], None)
    with RegistryClient() as client:
        expected = [f"{name}:stable", f"{name}:v1"]
        assert promote(f"{name}:whatever", digest, ["stable", "v1", "stable"], None, runner) == expected
        assert {client.find_manifest(reference) for reference in expected} == {digest}
        before = log.getvalue()
        assert before == f"{expected[0]}: is now {digest}\n{expected[1]}: is now {digest}\n"
        assert promote(name, "key-1", ["stable"], None, runner) == expected[:1]
        assert log.getvalue() == f"{before}{expected[0]}: is already {digest}\n"


def test_a_tag_moves_from_the_image_before(
    engine: "DockerClient", registry: Registry, runner: Runner, log: io.StringIO
) -> None:
    name = fresh_name(registry.address)
    digests = []
    for number in range(2):
        with small_image(engine, name, f"key-{number}"):
            digests.append(push_image(engine, f"{name}:key-{number}", [], None))
        promote(name, digests[-1], ["stable"], None, runner)
    with RegistryClient() as client:
        assert client.find_manifest(f"{name}:stable") == digests[1] != digests[0]
    assert log.getvalue().endswith(f"{name}:stable: is no longer {digests[0]} but {digests[1]}\n")


def test_an_image_for_several_platforms(engine: "DockerClient", registry: Registry, runner: Runner) -> None:
    name = fresh_name(registry.address)
    with small_image(engine, name, "one"):
        push_image(engine, f"{name}:one", [], None)
    with RegistryClient() as client:
        one = client.read_manifest(f"{name}:one")
        assert one is not None
        kind = "application/vnd.oci.image.index.v1+json"
        part = {"mediaType": one.media_type, "size": len(one.content), "digest": one.digest}
        content = json.dumps({"schemaVersion": 2, "mediaType": kind, "manifests": [part]}, indent=1).encode()
        index = Manifest(f"sha256:{hashlib.sha256(content).hexdigest()}", kind, content)
        client.put_manifest(f"{name}:all", index)
        promote(name, index.digest, ["stable"], None, runner)
        assert client.read_manifest(f"{name}:stable") == index


def test_missing_objects(registry: Registry, private_registry: Registry, runner: Runner) -> None:
    digest = "sha256:" + "1" * 64
    for address in (registry.address, private_registry.address):
        for wanted in (digest, "key-1"):
            with pytest.raises(InputError, match="there is no such image to promote: push it first"):
                promote(f"{address}/calibration-test/none", wanted, ["stable"], None, runner)


@pytest.mark.parametrize(("wanted", "tags"), [("sha256:12", ["stable"]), ("key-1", ["not a tag"]), ("a/b", ["stable"])])
def test_invalid_tags(runner: Runner, wanted: str, tags: list[str]) -> None:
    with pytest.raises(InputError, match="found the tag"):
        promote("127.0.0.1:1/robot", wanted, tags, None, runner)


def test_with_a_password(engine: "DockerClient", private_registry: Registry, runner: Runner, log: io.StringIO) -> None:
    name = fresh_name(private_registry.address)
    settings = RegistrySettings(private_registry.user, "REGISTRY_PASSWORD")
    known = registry_login(settings, name, runner, {"REGISTRY_PASSWORD": private_registry.password})
    with small_image(engine, name, "key-1"):
        digest = push_image(engine, f"{name}:key-1", [], known)
    assert promote(name, digest, ["stable"], known, runner) == [f"{name}:stable"]
    with pytest.raises(InputError, match="denies access"):
        promote(name, digest, ["v1"], Credentials(private_registry.address, "robot", "wrong"), runner)
    assert private_registry.password not in log.getvalue()


def test_a_tag_moved_by_another_process(
    engine: "DockerClient", registry: Registry, runner: Runner, log: io.StringIO
) -> None:
    other = "sha256:" + "2" * 64
    heads: list[str] = []

    def fault(request: Request) -> Reply | None:
        if request.method != "HEAD" or not request.path.endswith("/stable"):
            return None
        heads.append(request.path)
        return Reply(404) if len(heads) == 1 else Reply(200, headers={"Docker-Content-Digest": other})

    with faulty(registry.address, fault) as server:
        name = fresh_name(server.address)
        with small_image(engine, name, "key-1"):
            digest = push_image(engine, f"{name}:key-1", [], None)
        assert promote(name, digest, ["stable"], None, runner) == [f"{name}:stable"]
    assert log.getvalue() == f"{name}:stable: was moved to {other} by another process after it was {digest}\n"


def test_a_login_of_aws_at_a_stand_in(
    engine: "DockerClient", registry: Registry, runner: Runner, monkeypatch: pytest.MonkeyPatch, log: io.StringIO
) -> None:
    """The emulator provides the password; the registry needs none, so only the request is tested."""
    moto = pytest.importorskip("moto.server", reason="needs moto[ecr,server]")
    server = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    try:
        host, port = server.get_host_and_port()
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
        for name, value in {"ACCESS_KEY_ID": "AKIA", "SECRET_ACCESS_KEY": "x", "DEFAULT_REGION": "eu-west-1"}.items():
            monkeypatch.setenv(f"AWS_{name}", value)
        name = fresh_name(registry.address)
        settings = RegistrySettings(kind="ecr", create_repository=True)
        credentials = registry_login(settings, name, runner)
        with small_image(engine, name, "key-1"):
            digest = push_image(engine, f"{name}:key-1", [], credentials)
        assert promote(name, digest, ["stable"], credentials, runner) == [f"{name}:stable"]
    finally:
        server.stop()
    assert credentials.password not in log.getvalue()
