"""Delivery to a registry, as an OCI artifact, and as assets of a GitHub release.

Layers come first, then the tags of the version and ``latest``; a release is a draft that nobody sees, and is then
published: https://docs.github.com/en/rest/releases
"""

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import quote

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
from calibration.addons.delivery.manifest import BUNDLE_ENDING, MAX_BUNDLE_BYTES, is_version, version_order
from calibration.base import InfrastructureError, InputError
from calibration.ci.github.api import GitHubApi, MissingError, RefusedRequestError
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


@dataclass
class GitHubReleases:
    """Releases of a repository for one robot, whose tags are ``ROBOT-VERSION``."""

    api: GitHubApi
    repository: str
    """OWNER/NAME."""
    robot: str
    _draft: int | None = field(default=None, init=False)
    _tag: str = field(default="", init=False)

    @property
    def name(self) -> str:
        """The releases of the repository."""
        return f"releases of {self.repository}"

    def last(self) -> FetchedBundle | None:
        """Return the bundle of the release with the largest version."""
        releases = {version: each for each in self._releases() if (version := self._version_of(each)) is not None}
        version = max(releases, key=version_order, default=None)
        if version is None:
            return None
        where = f"release {self.robot}-{version}"
        assets = {str(each.get("name")): each.get("id") for each in releases[version].get("assets", ())}
        bundle = f"{self.robot}{BUNDLE_ENDING}"
        if bundle not in assets:
            raise InputError(f"{where}: found no file {bundle}, expected the bundle that was delivered")
        attested = assets.get(bundle + ATTESTATION_ENDING)
        attestation = None if attested is None else self._asset(attested)
        return FetchedBundle(where, self._asset(assets[bundle]), attestation)

    def stage(self, delivery: Delivery) -> None:
        """Make a draft with the files."""
        self._tag = f"{self.robot}-{delivery.manifest.version}"
        try:
            self.api.request("GET", self._path(f"git/ref/tags/{self._tag}"))
        except MissingError:  # as it should be
            pass
        else:
            raise InputError(f"{self.repository}: there is a tag {self._tag} without the release, expected none")
        document = {
            "tag_name": self._tag,
            "target_commitish": delivery.manifest.commit,
            "name": f"{delivery.manifest.name} {delivery.manifest.version}",
            "body": delivery.changelog,
            "draft": True,
        }
        draft = self._changed("POST", "releases", document)
        try:
            self._draft, place = int(draft["id"]), str(draft["upload_url"]).partition("{")[0]
        except (LookupError, TypeError, ValueError):
            raise InfrastructureError(f"{self.repository}: GitHub's answer describes no release") from None
        for name, content in delivery.files.items():
            self.api.upload(f"{place}?name={quote(name)}", content)

    def complete(self) -> None:
        """Publish the draft, which makes its tag; GitHub refuses a second release of a tag."""
        try:
            self._changed("PATCH", f"releases/{self._draft}", {"draft": False})
        except RefusedRequestError:
            raise taken_meanwhile(f"{self.repository}: {self._tag}") from None
        self._draft = None

    def withdraw(self) -> None:
        """Delete the draft."""
        if self._draft is not None:
            self._changed("DELETE", f"releases/{self._draft}")

    def _releases(self) -> Iterator[dict[str, Any]]:
        try:
            yield from self.api.pages(self._path("releases?"))
        except MissingError as error:
            raise InputError(f"{error}: the token has no access to {self.repository}, or it does not exist") from None

    def _version_of(self, release: dict[str, Any]) -> str | None:
        tag = str(release.get("tag_name"))
        version = tag.removeprefix(f"{self.robot}-")
        return version if version != tag and is_version(version) and not release.get("draft") else None

    def _asset(self, number: object) -> bytes:
        try:
            content = self.api.download(self._path(f"releases/assets/{number}"))
        except MissingError as error:
            raise InfrastructureError(f"{error}: the release was changed meanwhile: run it again") from None
        if len(content) > MAX_BUNDLE_BYTES:
            raise InputError(f"{self.repository}: found an asset of {len(content)} bytes, expected a bundle")
        return content

    def _changed(self, method: str, path: str, document: object = None) -> Any:
        """Send a request that changes something: to a token that may not, GitHub may say that it is not there."""
        try:
            return self.api.request(method, self._path(path), document)
        except MissingError as error:
            raise InputError(f"{error}: the job needs permissions: {self.api.permission}") from None

    def _path(self, path: str) -> str:
        return f"/repos/{self.repository}/{path}"
