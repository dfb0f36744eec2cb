"""Delivery to a registry, as an OCI artifact: layers first, then the tags of the version and ``latest``."""

import hashlib
import json
from dataclasses import dataclass, field

from calibration.addons.delivery.attestation import ATTESTATION_ENDING
from calibration.addons.delivery.destinations import (
    ARTIFACT_TYPE,
    ATTESTATION_LAYER,
    BUNDLE_LAYER,
    CHANGELOG_FILE,
    Delivery,
    FetchedBundle,
    read_artifact,
    taken_meanwhile,
)
from calibration.base.errors import InputError
from calibration.ci.registries.reference import Reference
from calibration.ci.registries.registry import Manifest, RegistryClient

MANIFEST_TYPE = "application/vnd.oci.image.manifest.v1+json"
EMPTY_TYPE, EMPTY = "application/vnd.oci.empty.v1+json", b"{}"
LATEST_TAG = "latest"


@dataclass
class RegistryRepository:
    """A repository of a registry with the bundles of a robot; ``latest`` is what was delivered last."""

    client: RegistryClient
    repository: Reference
    _tag: Reference | None = field(default=None, init=False)
    _manifest: Manifest | None = field(default=None, init=False)
    _known: str | None = field(default=None, init=False)
    """Digest that the tag had; None if it was free."""

    @property
    def name(self) -> str:
        """The repository."""
        return self.repository.name

    def last(self) -> FetchedBundle | None:
        """Return the bundle of the tag latest."""
        return read_artifact(self.client, self.repository.with_tag(LATEST_TAG))

    def stage(self, delivery: Delivery) -> None:
        """Push the layers, and the manifest by its digest."""
        self._tag = self.repository.with_tag(delivery.manifest.version)
        self._known = self.client.find_manifest(self._tag)
        if self._known is not None:  # left by a delivery that broke off before it moved latest
            there = read_artifact(self.client, self._tag)
            if there is not None and there.content != delivery.content:
                raise InputError(f"{self._tag}: this tag has another content, expected none or this bundle")
        layers = [self._pushed(name, content) for name, content in delivery.files.items()]
        document = {
            "schemaVersion": 2,
            "mediaType": MANIFEST_TYPE,
            "artifactType": ARTIFACT_TYPE,
            "config": self._descriptor(EMPTY_TYPE, EMPTY),
            "layers": layers,
            "annotations": {
                "org.opencontainers.image.version": delivery.manifest.version,
                "org.opencontainers.image.revision": delivery.manifest.commit or "",
            },
        }
        content = json.dumps(document).encode()
        self._manifest = Manifest(f"sha256:{hashlib.sha256(content).hexdigest()}", MANIFEST_TYPE, content)
        self.client.put_manifest(self.repository.with_digest(self._manifest.digest), self._manifest)

    def complete(self) -> None:
        """Set the tags; a registry cannot set one only if it is free, so it is looked at before and after."""
        if self._tag is not None and self._manifest is not None:
            if self.client.find_manifest(self._tag) != self._known:
                raise taken_meanwhile(str(self._tag))
            self.client.put_manifest(self._tag, self._manifest)
            if self.client.find_manifest(self._tag) != self._manifest.digest:
                raise taken_meanwhile(str(self._tag))
            self.client.put_manifest(self.repository.with_tag(LATEST_TAG), self._manifest)

    def withdraw(self) -> None:
        """Leave what has no tag to the registry, which removes it."""

    def _pushed(self, name: str, content: bytes) -> dict[str, object]:
        """Push a file as a layer, and return its descriptor, by which oras writes it under its name."""
        kind = BUNDLE_LAYER
        if name.endswith(ATTESTATION_ENDING):
            kind = ATTESTATION_LAYER
        elif name == CHANGELOG_FILE:
            kind = "text/markdown"
        return {**self._descriptor(kind, content), "annotations": {"org.opencontainers.image.title": name}}

    def _descriptor(self, kind: str, content: bytes) -> dict[str, object]:
        return {"mediaType": kind, "digest": self.client.put_blob(self.repository, content), "size": len(content)}
