"""Whether a bundle is accepted on this robot: what it is, who signed it, how it was judged, how old it is, whose."""

import hashlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from calibration.addons.delivery.attestation import SignedStatement, verify_attestation
from calibration.addons.delivery.destinations import FetchedBundle
from calibration.addons.delivery.manifest import (
    MANIFEST_FILE,
    BundledFile,
    Manifest,
    RefusedBundleError,
    parse_manifest,
    unpack_files,
    version_order,
)
from calibration.base.errors import InputError

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

SECONDS_OF_DAY = 86400.0
MAX_CLOCK_ERROR = SECONDS_OF_DAY
"""Seconds that a bundle may be younger than this machine's clock says."""


@dataclass(frozen=True, kw_only=True)
class Expectations:
    """What is expected of a bundle."""

    keys: "Mapping[str, Ed25519PublicKey]" = field(default_factory=dict)
    """Trusted public keys by their ids; none if it need not be signed."""
    serial: str | None = None
    description: str | None = None
    """SHA-256 of this robot's description."""
    max_age: float | None = None
    """Seconds."""
    at_least: str | None = None
    """Smallest version."""
    marked: bool = False
    """Whether systems may be marked."""
    now: Callable[[], float]
    """The present time, seconds since 1970."""


@dataclass(frozen=True, kw_only=True)
class CheckedBundle:
    """A bundle that was checked; what is not authentic is not parsed."""

    digest: str
    manifest: Manifest | None = None
    files: Mapping[str, bytes] = field(default_factory=dict)
    signed_by: str | None = None
    reasons: tuple[str, ...] = ()
    """Why it is refused; empty if it is accepted."""
    warnings: tuple[str, ...] = ()


def check_bundle(fetched: FetchedBundle, expected: Expectations) -> CheckedBundle:
    """Check a bundle: first its signature, then its files, then what its manifest says."""
    digest = hashlib.sha256(fetched.content).hexdigest()
    statement = None
    try:
        if expected.keys:
            statement = verify_attestation(fetched.attestation, digest, expected.keys)
        files = unpack_files(fetched.content)
        manifest = _listed_files(files)
    except RefusedBundleError as error:
        return CheckedBundle(digest=digest, signed_by=statement.signer if statement else None, reasons=(str(error),))
    return CheckedBundle(
        digest=digest,
        manifest=manifest,
        files=files,
        signed_by=statement.signer if statement else None,
        reasons=tuple(_reasons(manifest, statement, files, expected)),
        warnings=tuple(_warnings(manifest, statement)),
    )


def _listed_files(files: Mapping[str, bytes]) -> Manifest:
    """Return the manifest of files that are those that it lists."""
    if MANIFEST_FILE not in files:
        raise RefusedBundleError(f"it has no {MANIFEST_FILE}")
    try:
        manifest = parse_manifest(files[MANIFEST_FILE], MANIFEST_FILE)
    except InputError as error:
        raise RefusedBundleError(str(error)) from None
    there = {path: content for path, content in files.items() if path != MANIFEST_FILE}
    listed = {each.path: each for each in manifest.files}
    if strange := sorted(there.keys() ^ listed.keys()):
        found = "it is not there" if strange[0] in listed else "its manifest does not list it"
        raise RefusedBundleError(f"its file '{strange[0]}': {found}")
    for path, content in there.items():
        own = BundledFile(path, len(content), hashlib.sha256(content).hexdigest())
        if listed[path] != own:
            raise RefusedBundleError(f"its file '{path}' has another content than its manifest says")
    return manifest


def _reasons(
    manifest: Manifest, statement: SignedStatement | None, files: Mapping[str, bytes], expected: Expectations
) -> Iterator[str]:
    if not expected.marked:
        yield from (f"{mark}; bundled although: {manifest.although}" for mark in manifest.marks)
        for system in manifest.systems:
            if system.verdict == "fail" and not system.marks:
                yield f"{system.name}: fail: {'; '.join(system.reasons[:1])}"
        if statement is not None and statement.result == "FAILED" and not manifest.marks:
            yield "its attestation says FAILED, and its manifest does not"
    if not manifest.systems:
        yield "it has no system"
    if expected.serial is not None and manifest.serial != expected.serial:
        yield f"it is of another robot: found the serial number {manifest.serial!r}, expected {expected.serial!r}"
    if expected.description is not None and expected.description not in _descriptions(manifest, files):
        yield f"it is of another robot: found no description of sha256 {expected.description[:16]}..."
    if expected.at_least is not None and version_order(manifest.version) < version_order(expected.at_least):
        yield f"it is an older one: found version {manifest.version}, expected at least {expected.at_least}"
    if expected.max_age is not None:
        age = expected.now() - manifest.made
        days = f"{age / SECONDS_OF_DAY:.1f} days"
        if age > expected.max_age:
            yield f"it has expired: found an age of {days}, expected at most {expected.max_age / SECONDS_OF_DAY:g}"
        elif age < -MAX_CLOCK_ERROR:
            yield f"it is of the future: found an age of {days}: is the clock of this machine right?"


def _descriptions(manifest: Manifest, files: Mapping[str, bytes]) -> set[str]:
    """Return the hashes of the descriptions that were calibrated, and of those with calibrated origins."""
    given = {system.description for system in manifest.systems if system.description}
    urdfs = (content for path, content in files.items() if path.endswith(".urdf"))
    return given | {hashlib.sha256(content).hexdigest() for content in urdfs}


def _warnings(manifest: Manifest, statement: SignedStatement | None) -> Iterator[str]:
    if statement is None:
        yield "its signature is not checked: it may be from anyone"
    if manifest.uncommitted:
        yield "files differed from the commit when it was made"
    for each in manifest.left_out:
        yield f"{each.name}: not in the bundle: {each.why}"
    for system in manifest.systems:
        if system.verdict == "undecided" and not system.marks:
            yield f"{system.name}: undecided, which its configuration lets pass: {'; '.join(system.reasons[:1])}"
        if system.accepted_although:
            yield f"{system.name}: accepted although it had failed: {system.accepted_although}"
    yield from (f"{mark}; bundled although: {manifest.although}" for mark in manifest.marks)
