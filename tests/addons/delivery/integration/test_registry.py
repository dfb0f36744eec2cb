"""A bundle in a real registry, with a user and a password."""

import pytest

from calibration.addons.delivery.destinations import Delivery, RegistryRepository
from calibration.base import InputError
from calibration.ci.registries.reference import Credentials, parse_reference
from calibration.ci.registries.registry import RegistryClient
from tests.addons.delivery.bundles import MANIFEST, packed, signed
from tests.docker_engine import Registry, private_registry

__all__ = ["private_registry"]


def test_what_is_delivered_is_read_back(private_registry: Registry) -> None:
    fetched = signed(packed())
    delivery = Delivery(MANIFEST, fetched.content, fetched.attestation, "## robot 1.4\n")
    name = parse_reference(f"{private_registry.address}/team/delivered")
    user = Credentials(private_registry.address, private_registry.user, private_registry.password)
    with RegistryClient(user) as client:
        place = RegistryRepository(client, name)
        assert place.last() is None
        place.stage(delivery)
        assert place.last() is None
        place.complete()
        found = place.last()
        assert found is not None
        assert (found.content, found.attestation) == (fetched.content, fetched.attestation)
        assert client.find_manifest(name.with_tag("1.4")) == client.find_manifest(name.with_tag("latest"))
        RegistryRepository(client, name).stage(delivery)  # once more
        with pytest.raises(InputError):
            RegistryRepository(client, name).stage(Delivery(MANIFEST, packed(more=b"1"), None, ""))
    stranger = Credentials(private_registry.address, private_registry.user, "wrong")
    with RegistryClient(stranger) as client, pytest.raises(InputError):
        RegistryRepository(client, name).stage(delivery)
