"""Files of a bundle in a folder: the archive, the statement about it, and its signature where there is a key."""

import json
import os
from collections.abc import Mapping
from pathlib import Path

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

BUNDLE_FOLDER = "bundle"
"""In the output folder of a run."""
PREDICATE_ENDING = ".predicate.json"
"""After the name of a bundle: its test results, for a tool that makes and signs the statement itself."""


def write_bundle(
    bundle: Bundle, output: Path, key_file: Path | None, environment: Mapping[str, str] = os.environ
) -> BundleResults:
    """Write a bundle, its predicate, and its attestation if there is a key; an older attestation is removed.

    Args:
        bundle: the bundle.
        output: output folder of a run, whose folder `BUNDLE_FOLDER` gets the files.
        key_file: file with the private key; None for that of `KEY_VARIABLE`, if it is set.
        environment: variables.

    Raises:
        InputError: the key is none.
        InfrastructureError: a file cannot be written, or cryptography is not installed.
    """
    text, where = environment.get(KEY_VARIABLE, ""), KEY_VARIABLE
    if key_file is not None:
        where, text = str(key_file), read_bytes(key_file, MAX_KEY_BYTES, "a private key").decode("utf-8", "replace")
    key = parse_signing_key(text, where) if text.strip() or key_file is not None else None
    manifest = bundle.manifest
    name = f"{BUNDLE_FOLDER}/{manifest.file_name}"
    attestation, predicate = name + ATTESTATION_ENDING, name + PREDICATE_ENDING
    remove_results(output, [name, attestation, predicate])
    write_atomically(output / name, bundle.content)
    write_atomically(output / predicate, json.dumps(test_result(manifest), indent=1) + "\n")
    if key is not None:
        envelope = signed_envelope(statement_of(bundle.content, manifest.file_name, manifest), key)
        write_atomically(output / attestation, envelope)
    return BundleResults(
        name=manifest.name,
        version=manifest.version,
        file=name,
        digest=f"sha256:{bundle.digest}",
        attestation=attestation if key else None,
        predicate=predicate,
        systems=tuple(system.name for system in manifest.systems),
        left_out=manifest.left_out,
        marks=manifest.marks,
        uncommitted=manifest.uncommitted,
    )
