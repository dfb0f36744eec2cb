"""Where bundles are delivered to: what was delivered last, and a delivery in two steps, so that nothing is half there.

``stage`` sends everything, and nobody sees it; ``complete`` is one request that makes it seen; ``withdraw`` takes back
what was staged. Here are the interface and a folder; `release` and `artifact` are GitHub's releases and registries.
"""

import os
import shutil
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from calibration.addons.delivery.attestation import ATTESTATION_ENDING
from calibration.addons.delivery.fetching import FetchedBundle, fetch_bundle
from calibration.addons.delivery.manifest import Manifest, is_version, version_order
from calibration.base.errors import InfrastructureError, InputError
from calibration.base.files import write_atomically
from calibration.ci.workflow import Runner

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
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._staged = Path(tempfile.mkdtemp(prefix=".delivery-", dir=self.folder))
            self._staged.chmod(0o755)
        except OSError as error:
            raise InfrastructureError(f"{self.folder}: the bundle cannot be written: {error.strerror}") from None
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
