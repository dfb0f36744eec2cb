"""Images that are built, pushed, found by their key, and promoted."""

import uuid
from typing import Any

import pytest

from calibration.ci.registries.reference import parse_reference
from calibration.ci.registries.registry import RegistryClient
from tests.docker_engine import Registry
from tests.integration.image.builds import Builds, builds

__all__ = ["builds"]

BASE = "debian:bookworm"


def in_registry(reference: str) -> str | None:
    with RegistryClient() as client:
        return client.find_manifest(reference)


@pytest.fixture
def pushed(builds: Builds, registry: Registry) -> dict[str, Any]:
    """Return the specification of an image for the registry."""
    builds.name = f"{registry.address}/{builds.name}"
    return {"name": builds.name, "base": BASE, "commands": ["echo x > /x"], "push": True, "tags": ["edge"]}


def test_pushed_found_and_not_pulled(builds: Builds, pushed: dict[str, Any]) -> None:
    image = builds.build(**pushed)
    assert image.built
    assert image.digest is not None
    assert in_registry(image.reference) == in_registry(f"{builds.name}:edge") == image.digest

    local = builds.build(**pushed)
    assert (local.built, local.found_in, local.digest) == (False, "local", image.digest)

    builds.forget()
    pushed["tags"] = ["edge", "next"]
    found = builds.build({"load": False}, **pushed)
    assert (found.built, found.found_in, found.digest, found.id) == (False, "registry", image.digest, None)
    assert in_registry(f"{builds.name}:next") == image.digest
    assert builds.tags() == []

    loaded = builds.build(**pushed)
    assert (loaded.built, loaded.found_in, loaded.digest) == (False, "registry", image.digest)
    assert builds.run(loaded.reference, "cat", "/x") == "x"
    assert builds.run(f"{builds.name}:next", "cat", "/x") == "x"


def test_an_unpushed_image_is_looked_for_where_its_name_has_a_host(builds: Builds, pushed: dict[str, Any]) -> None:
    image = builds.build(**pushed)
    builds.forget()
    found = builds.build({"push": False}, **pushed)
    assert (found.built, found.found_in, found.digest) == (False, "registry", image.digest)


def test_a_registry_that_is_down_is_no_reason_not_to_build(builds: Builds) -> None:
    image = builds.build(name=f"127.0.0.1:1/{builds.name}", base=BASE, commands=["true"])
    assert image.built
    assert "the registry was not searched: " in builds.log
    builds.engine.images.remove(image.reference, force=True)
    builds.engine.images.remove(image.tags[0], force=True)


def test_an_image_of_others_under_the_tag_is_not_taken(builds: Builds, pushed: dict[str, Any]) -> None:
    image = builds.build(**pushed)
    builds.engine.images.get(BASE).tag(*image.reference.rsplit(":", 1))
    for _ in builds.engine.api.push(image.reference, stream=True):
        pass
    builds.forget()
    again = builds.build({"push": False}, **pushed)
    assert again.built
    assert "was built for another key" in builds.log
    assert builds.run(again.reference, "cat", "/x") == "x"


def test_another_base_under_the_same_name_is_another_key(builds: Builds, registry: Registry) -> None:
    base = f"{registry.address}/base/{builds.name}"
    reference = parse_reference(f"{base}:1")

    def publish(content: str) -> None:
        made = builds.build(name=base, base=BASE, commands=[f"echo {content} > /base"])
        builds.engine.images.get(made.reference).tag(reference.name, "1")
        for _ in builds.engine.api.push(reference.name, "1", stream=True):
            pass

    name = f"robot/{builds.name}"
    publish("one")
    first = builds.build(name=name, base=str(reference))
    assert builds.run(first.reference, "cat", "/base") == "one"
    assert not builds.build({"pull": True}, name=name, base=str(reference)).built
    builds.forget()  # as on a new runner: the base is resolved in the registry
    assert builds.build(name=name, base=str(reference)).key == first.key

    publish("two")
    builds.engine.images.remove(str(reference), force=True)
    second = builds.build({"pull": True}, name=name, base=str(reference))
    assert second.built
    assert second.key != first.key
    assert builds.run(second.reference, "cat", "/base") == "two"
    builds.write("Dockerfile", f"FROM {reference}\nRUN cat /base\n")
    own = builds.build({"pull": True}, name=name, dockerfile="Dockerfile")
    assert builds.run(own.reference, "cat", "/base") == "two"


def test_a_private_registry(builds: Builds, private_registry: Registry, monkeypatch: pytest.MonkeyPatch) -> None:
    builds.name = f"{private_registry.address}/{builds.name}"
    monkeypatch.setenv("PLANTED_PASSWORD", private_registry.password)
    login = {"username": private_registry.user, "password-variable": "PLANTED_PASSWORD"}
    entry: dict[str, Any] = {"base": BASE, "commands": [f"echo {uuid.uuid4().hex}"], "registry": login, "push": True}
    image = builds.build(**entry)
    assert image.digest
    builds.forget()
    again = builds.build(**entry)
    assert (again.built, again.digest) == (False, image.digest)
    log = "\n".join(line for line in builds.log.splitlines() if not line.startswith("::add-mask::"))
    assert private_registry.password not in log
    assert private_registry.password not in repr(again)
