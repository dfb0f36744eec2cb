"""Files of a bundle in a folder: the archive, the statement about it, and its signature where there is a key."""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from calibration.addons.delivery.attestation import (
    ATTESTATION_ENDING,
    MAX_KEY_BYTES,
    parse_signing_key,
    signed_envelope,
    statement_of,
    test_result,
)
from calibration.addons.delivery.bundling import Bundle
from calibration.addons.delivery.results import BundleResults
from calibration.addons.delivery.settings import KEY_VARIABLE
from calibration.base.files import read_bytes, write_atomically
from calibration.ci.report import remove_results

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

PREDICATE_ENDING = ".predicate.json"
"""After the name of a bundle: its test results, for a tool that makes and signs the statement itself."""


@dataclass(frozen=True)
class WrittenBundle:
    """A bundle in a folder."""

    bundle: Bundle
    path: Path
    predicate: Path
    attestation: Path | None
    """Its signed statement; None without a key."""

    def results(self, output: Path) -> BundleResults:
        """Return its results, with paths relative to an output folder around it."""
        manifest = self.bundle.manifest
        return BundleResults(
            name=manifest.name,
            version=manifest.version,
            file=str(self.path.relative_to(output)),
            digest=f"sha256:{self.bundle.digest}",
            attestation=str(self.attestation.relative_to(output)) if self.attestation else None,
            predicate=str(self.predicate.relative_to(output)),
            systems=tuple(system.name for system in manifest.systems),
            left_out=manifest.left_out,
            marks=manifest.marks,
            uncommitted=manifest.uncommitted,
        )


def read_signing_key(key_file: Path | None, environment: Mapping[str, str]) -> "Ed25519PrivateKey | None":
    """Return the private key of a file, or else of `KEY_VARIABLE`; None without one; raises as `write_bundle`."""
    text, where = environment.get(KEY_VARIABLE, ""), KEY_VARIABLE
    if key_file is not None:
        where = str(key_file)
        text = read_bytes(key_file, MAX_KEY_BYTES, "a private key").decode("utf-8", "replace")
    return parse_signing_key(text, where) if text.strip() or key_file is not None else None


def write_bundle(
    bundle: Bundle, folder: Path, key_file: Path | None, environment: Mapping[str, str] = os.environ
) -> WrittenBundle:
    """Write a bundle, its predicate, and its attestation if there is a key; an older attestation is removed.

    Args:
        bundle: the bundle.
        folder: the folder.
        key_file: file with the private key; None for that of `KEY_VARIABLE`, if it is set.
        environment: variables.

    Raises:
        InputError: the key is none.
        InfrastructureError: a file cannot be written, or cryptography is not installed.
    """
    key = read_signing_key(key_file, environment)
    path = folder / bundle.manifest.file_name
    attestation, predicate = (path.with_name(path.name + each) for each in (ATTESTATION_ENDING, PREDICATE_ENDING))
    remove_results(folder, [each.name for each in (path, attestation, predicate)])
    write_atomically(path, bundle.content)
    write_atomically(predicate, json.dumps(test_result(bundle.manifest), indent=1) + "\n")
    if key is not None:
        envelope = signed_envelope(statement_of(bundle.content, path.name, bundle.manifest), key)
        write_atomically(attestation, envelope)
    return WrittenBundle(bundle, path, predicate, attestation if key else None)
