import hashlib
import json
from typing import TYPE_CHECKING

import pytest

from calibration.base import InputError
from calibration.ci.registries.reference import Credentials
from calibration.ci.registries.registry import Manifest, RegistryClient
from tests.docker_engine import Registry
from tests.integration.image.registries import fresh_name, small_image

if TYPE_CHECKING:
    from docker import DockerClient


def test_images_pushed_by_docker_are_found(engine: "DockerClient", registry: Registry) -> None:
    name = fresh_name(registry.address)
    with small_image(engine, name, "v1"), RegistryClient() as client:
        assert client.find_manifest(f"{name}:v1") is None
        told = [
            line["aux"]["Digest"] for line in engine.images.push(name, "v1", stream=True, decode=True) if "aux" in line
        ]
        assert client.find_manifest(f"{name}:v1") == told[0]
        manifest = client.read_manifest(f"{name}@{told[0]}")
        assert manifest is not None
        assert manifest.media_type == "application/vnd.docker.distribution.manifest.v2+json"
        assert f"sha256:{hashlib.sha256(manifest.content).hexdigest()}" == told[0]


def test_a_manifest_for_several_platforms_stays_byte_for_byte(engine: "DockerClient", registry: Registry) -> None:
    name = fresh_name(registry.address)
    with small_image(engine, name, "v1"), RegistryClient() as client:
        engine.images.push(name, "v1")
        single = client.read_manifest(f"{name}:v1")
        assert single is not None
        kind = "application/vnd.docker.distribution.manifest.list.v2+json"
        platform = {"architecture": "amd64", "os": "linux"}
        part = {
            "mediaType": single.media_type,
            "size": len(single.content),
            "digest": single.digest,
            "platform": platform,
        }
        content = json.dumps({"schemaVersion": 2, "mediaType": kind, "manifests": [part]}, indent=5).encode()
        index = Manifest(f"sha256:{hashlib.sha256(content).hexdigest()}", kind, content)
        client.put_manifest(f"{name}:all", index)
        assert client.read_manifest(f"{name}:all") == index


def test_a_registry_with_a_password(engine: "DockerClient", private_registry: Registry) -> None:
    name = fresh_name(private_registry.address)
    known = Credentials(private_registry.address, private_registry.user, private_registry.password)
    wrong = Credentials(private_registry.address, private_registry.user, "pl4nted")
    with small_image(engine, name, "v1"):
        engine.api.push(name, "v1", auth_config=known.auth_config())
        with RegistryClient(known) as client:
            manifest = client.read_manifest(f"{name}:v1")
            assert manifest is not None
            client.put_manifest(f"{name}:v2", manifest)
        with RegistryClient() as nobody:
            assert nobody.find_manifest(f"{name}:v1") is None
            with pytest.raises(InputError, match="not logged in"):
                nobody.put_manifest(f"{name}:v3", manifest)
        with RegistryClient(wrong) as stranger:
            with pytest.raises(InputError, match=r"denies access \(401 \(UNAUTHORIZED: authentication required\)\)"):
                stranger.read_manifest(f"{name}:v1")
            with pytest.raises(InputError) as caught:
                stranger.find_manifest(f"{name}:v1")
            assert "pl4nted" not in str(caught.value)
