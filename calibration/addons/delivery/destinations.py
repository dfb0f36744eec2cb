"""Where bundles are: files, unpacked folders, registries and GitHub's releases; and a delivery in two steps.

``stage`` sends everything, and nobody sees it; ``complete`` is one request that makes it seen, never half of it;
``withdraw`` takes back what was staged. In a registry, an OCI artifact, layers come first, then the tags of the version
and ``latest``. A release is a draft that nobody sees, and is then published:
https://docs.github.com/en/rest/releases
"""

import hashlib
import json
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import quote

from calibration.addons.delivery.attestation import ATTESTATION_ENDING, MAX_ATTESTATION_BYTES
from calibration.addons.delivery.manifest import (
    BUNDLE_ENDING,
    MANIFEST_FILE,
    MAX_BUNDLE_BYTES,
    MAX_FILES,
    Manifest,
    RefusedBundleError,
    is_version,
    pack_files,
    version_order,
)
from calibration.base import InfrastructureError, InputError, read_bytes, write_atomically, writing
from calibration.ci.github.service import GitHubApi, MissingError, RefusedRequestError
from calibration.ci.registries.reference import Reference, parse_reference
from calibration.ci.registries.registry import Manifest as RegistryManifest
from calibration.ci.registries.registry import RegistryClient, registry_login
from calibration.ci.workflow import Runner

ATTESTATION_IN_FOLDER = f"attestation{ATTESTATION_ENDING}"
"""Name of the attestation in an unpacked folder."""
ARTIFACT_TYPE = "application/vnd.calibration-ci.bundle.v1"
"""Type of a bundle in a registry: a manifest of OCI with the layers of these two types."""
BUNDLE_LAYER, ATTESTATION_LAYER = f"{ARTIFACT_TYPE}.tar", f"{ARTIFACT_TYPE}.attestation"
MANIFEST_TYPE = "application/vnd.oci.image.manifest.v1+json"
EMPTY_TYPE, EMPTY = "application/vnd.oci.empty.v1+json", b"{}"
LATEST_TAG = "latest"


@dataclass(frozen=True)
class FetchedBundle:
    """A bundle to be verified."""

    where: str
    content: bytes
    attestation: bytes | None


def fetch_bundle(text: str, attestation: Path | None, runner: Runner, *, offline: bool) -> FetchedBundle:
    """Read a bundle.

    Args:
        text: path of a bundle or a folder, or its name in a registry.
        attestation: file of its attestation; None for that beside it.
        runner: runner that masks the secrets of a registry.
        offline: whether a registry is an error.

    Raises:
        InputError: there is none, or it is too large.
        InfrastructureError: a registry does not answer.
        RefusedBundleError: an unpacked folder has links or special files.
    """
    path = Path(text)
    if path.is_dir():
        found = _from_folder(path)
    elif os.path.lexists(path) or ("/" not in text and ":" not in text):
        found = _from_file(path)
    elif offline:
        raise InputError(f"{text}: found no such file or folder, expected one, as --offline allows no registry")
    else:
        found = _from_registry(text, runner)
    if attestation is None:
        return found
    return FetchedBundle(text, found.content, read_bytes(attestation, MAX_ATTESTATION_BYTES, "an attestation"))


def _from_file(path: Path) -> FetchedBundle:
    content, beside = read_bytes(path, MAX_BUNDLE_BYTES, "a bundle"), path.with_name(path.name + ATTESTATION_ENDING)
    attestation = read_bytes(beside, MAX_ATTESTATION_BYTES, "an attestation") if beside.exists() else None
    return FetchedBundle(str(path), content, attestation)


def _from_folder(folder: Path) -> FetchedBundle:
    """Read a folder: an unpacked bundle, or a folder with one bundle in it."""
    if not (folder / MANIFEST_FILE).exists():
        bundles = sorted(path for path in folder.iterdir() if path.name.endswith(BUNDLE_ENDING))
        if len(bundles) != 1:
            expected = f"expected one file *{BUNDLE_ENDING}, or an unpacked bundle with {MANIFEST_FILE}"
            raise InputError(f"{folder}: found {len(bundles)} bundles, {expected}")
        return _from_file(bundles[0])
    files: dict[str, bytes] = {}
    for path in _regular_files(folder):
        files[path.relative_to(folder).as_posix()] = read_bytes(path, MAX_BUNDLE_BYTES, "a file of a bundle")
        if len(files) > MAX_FILES or sum(map(len, files.values())) > MAX_BUNDLE_BYTES:
            raise RefusedBundleError("it has more files or bytes than a bundle may have")
    attestation = files.pop(ATTESTATION_IN_FOLDER, None)
    return FetchedBundle(str(folder), pack_files(files), attestation)


def _regular_files(folder: Path) -> Iterator[Path]:
    folders = [folder]
    while folders:
        for path in folders.pop().iterdir():
            mode = path.lstat().st_mode
            if stat.S_ISDIR(mode):
                folders.append(path)
            elif stat.S_ISREG(mode):
                yield path
            else:
                raise RefusedBundleError(f"its file '{path.relative_to(folder)}' is a link or no regular file")


def _from_registry(text: str, runner: Runner) -> FetchedBundle:
    with RegistryClient(registry_login(None, text, runner), most_bytes=MAX_BUNDLE_BYTES) as client:
        found = read_artifact(client, parse_reference(text))
    if found is None:
        raise InputError(f"{text}: found no such file, folder or artifact of a registry, expected a bundle")
    return found


def read_artifact(client: RegistryClient, reference: Reference) -> FetchedBundle | None:
    """Read a bundle from a registry; None if there is nothing of this name.

    Raises:
        InputError: it is something else, or access is denied.
        InfrastructureError: the registry does not answer.
    """
    manifest = client.read_manifest(reference)
    if manifest is None:
        return None
    layers = _layers_by_type(manifest.content, str(reference))
    content = client.read_blob(reference, layers[BUNDLE_LAYER])
    attested = layers.get(ATTESTATION_LAYER)
    attestation = None if attested is None else client.read_blob(reference, attested)
    return FetchedBundle(str(reference), content, attestation)


def _layers_by_type(content: bytes, text: str) -> dict[str, str]:
    """Return the digests of an artifact's layers by their media types."""
    try:
        layers = {str(each["mediaType"]): str(each["digest"]) for each in json.loads(content)["layers"]}
    except (ValueError, LookupError, TypeError, RecursionError):
        layers = {}
    if BUNDLE_LAYER not in layers:
        raise InputError(f"{text}: found an artifact without a layer {BUNDLE_LAYER}, expected a bundle")
    return layers


CHANGELOG_FILE = "CHANGELOG.md"


@dataclass(frozen=True)
class Delivery:
    """A bundle to be delivered."""

    manifest: Manifest
    content: bytes
    attestation: bytes | None
    changelog: str

    @property
    def files(self) -> dict[str, bytes]:
        """The files by their names: the bundle, its attestation if there is one, and the changelog."""
        name = self.manifest.file_name
        attested = {} if self.attestation is None else {name + ATTESTATION_ENDING: self.attestation}
        return {name: self.content, **attested, CHANGELOG_FILE: self.changelog.encode()}


class Destination(Protocol):
    """Where bundles of one robot are delivered to."""

    @property
    def name(self) -> str:
        """What it is, for messages."""

    def last(self) -> FetchedBundle | None:
        """Return what was delivered last; None if nothing was."""

    def stage(self, delivery: Delivery) -> None:
        """Send a delivery, so that nobody sees it yet; raises `InputError` if its version is taken."""

    def complete(self) -> None:
        """Make what was staged seen, at once; raises `InfrastructureError` if another delivery was faster."""

    def withdraw(self) -> None:
        """Remove what was staged, and not completed."""


def taken_meanwhile(what: str) -> InfrastructureError:
    """Return the error for a version that another delivery has taken since this one began."""
    return InfrastructureError(f"{what}: another delivery has taken this version meanwhile: run it again")


@dataclass
class DeliveryFolder:
    """A folder with a folder for each version."""

    folder: Path
    runner: Runner
    _staged: Path | None = field(default=None, init=False)
    _target: Path = field(default=Path(), init=False)

    @property
    def name(self) -> str:
        """The path."""
        return str(self.folder)

    def last(self) -> FetchedBundle | None:
        """Return the bundle in the folder of the largest version."""
        names = [each.name for each in self.folder.iterdir()] if self.folder.is_dir() else []
        version = max(filter(is_version, names), key=version_order, default=None)
        if version is None:
            return None
        return fetch_bundle(str(self.folder / version), None, self.runner, offline=True)

    def stage(self, delivery: Delivery) -> None:
        """Write a hidden folder beside those of the versions."""
        self._target = self.folder / delivery.manifest.version
        if os.path.lexists(self._target):
            raise InputError(f"{self._target}: this exists already, expected no delivery of this version")
        with writing(self.folder, "the bundle"):
            self.folder.mkdir(parents=True, exist_ok=True)
            self._staged = Path(tempfile.mkdtemp(prefix=".delivery-", dir=self.folder))
            self._staged.chmod(0o755)
        for name, content in delivery.files.items():
            write_atomically(self._staged / name, content)

    def complete(self) -> None:
        """Rename the hidden folder, which fails if there is one of the version."""
        if self._staged is not None:
            try:
                self._staged.rename(self._target)
            except OSError:
                raise taken_meanwhile(str(self._target)) from None
            self._staged = None

    def withdraw(self) -> None:
        """Remove the hidden folder."""
        if self._staged is not None:
            shutil.rmtree(self._staged, ignore_errors=True)


@dataclass
class RegistryRepository:
    """A repository of a registry with the bundles of a robot; ``latest`` is what was delivered last."""

    client: RegistryClient
    repository: Reference
    _tag: Reference | None = field(default=None, init=False)
    _manifest: RegistryManifest | None = field(default=None, init=False)
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
        self._manifest = RegistryManifest(f"sha256:{hashlib.sha256(content).hexdigest()}", MANIFEST_TYPE, content)
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
