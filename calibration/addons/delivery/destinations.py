"""Where bundles are: read from a file, an unpacked folder or a registry; and a delivery in two steps, never half there.

``stage`` sends everything, and nobody sees it; ``complete`` is one request that makes it seen; ``withdraw`` takes back
what was staged. Here are the interface and a folder; `artifact` has registries and GitHub's releases.
"""

import json
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

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
from calibration.ci.workflow import Runner

ATTESTATION_IN_FOLDER = f"attestation{ATTESTATION_ENDING}"
"""Name of the attestation in an unpacked folder."""
ARTIFACT_TYPE = "application/vnd.calibration-ci.bundle.v1"
"""Type of a bundle in a registry: a manifest of OCI with the layers of these two types."""
BUNDLE_LAYER, ATTESTATION_LAYER = f"{ARTIFACT_TYPE}.tar", f"{ARTIFACT_TYPE}.attestation"


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
    # A robot that reads files needs no client of a registry.
    from calibration.ci.registries.login import registry_login
    from calibration.ci.registries.reference import parse_reference
    from calibration.ci.registries.registry import RegistryClient

    with RegistryClient(registry_login(None, text, runner), most_bytes=MAX_BUNDLE_BYTES) as client:
        found = read_artifact(client, parse_reference(text))
    if found is None:
        raise InputError(f"{text}: found no such file, folder or artifact of a registry, expected a bundle")
    return found


def read_artifact(client: "RegistryClient", reference: "Reference") -> FetchedBundle | None:
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


if TYPE_CHECKING:
    from calibration.ci.registries.reference import Reference
    from calibration.ci.registries.registry import RegistryClient
