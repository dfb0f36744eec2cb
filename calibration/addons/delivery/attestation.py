"""Attestation of a bundle: an in-toto statement about its tests in a DSSE envelope, signed by a team's Ed25519 key.

Formats: in-toto Statement v1 with the predicate test-result v0.1, DSSE v1.0. Signatures are those of the package
cryptography, which is imported when a key is used.
"""

import base64
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calibration.addons.delivery.manifest import Manifest, RefusedBundleError
from calibration.base import InputError, parse_json, read_bytes
from calibration.base.optional import optional

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

STATEMENT_TYPE = "https://in-toto.io/Statement/v1"
TEST_RESULT = "https://in-toto.io/attestation/test-result/v0.1"
PAYLOAD_TYPE = "application/vnd.in-toto+json"
ATTESTATION_ENDING = ".intoto.jsonl"
"""After the name of a bundle: its attestations, one a line."""
MAX_KEY_BYTES, MAX_ATTESTATION_BYTES = 64 * 1024, 4 * 1024**2
MAX_SIGNATURES = 100
_HOW_TO_MAKE = "openssl genpkey -algorithm ed25519 -out signing.pem; openssl pkey -in signing.pem -pubout"


def test_result(manifest: Manifest) -> dict[str, Any]:
    """Return the predicate of a bundle: what was tested with which configuration, what passed and what failed."""
    lists: dict[str, list[str]] = {"passedTests": [], "warnedTests": [], "failedTests": []}
    of_verdict = {"pass": "passedTests", "undecided": "warnedTests", "fail": "failedTests"}
    configuration = [{"name": "calibration.yml", "digest": {"sha256": manifest.configuration}}]
    if manifest.commit:
        configuration.append({"name": "commit", "digest": {"gitCommit": manifest.commit}})
    for system in manifest.systems:
        for start in system.starts:
            lists[of_verdict[start.verdict]].append(start.name)
        for mark in system.marks:
            lists["failedTests"].append(f"{system.name}: {mark}")
        hashes = {"labels": system.labels, "description": system.description}
        configuration += [
            {"name": f"{what} of {system.name}", "digest": {"sha256": value}} for what, value in hashes.items() if value
        ]
    warned = lists["warnedTests"] or manifest.uncommitted or manifest.left_out
    outcome = "FAILED" if lists["failedTests"] else "WARNED" if warned else "PASSED"
    return {"result": outcome, "configuration": configuration, **lists}


test_result.__test__ = False  # type: ignore[attr-defined] # keeps pytest from collecting it


def statement_of(bundle: bytes, file: str, manifest: Manifest) -> bytes:
    """Return the in-toto statement about a bundle, the bytes that are signed."""
    statement = {
        "_type": STATEMENT_TYPE,
        "subject": [{"name": file, "digest": {"sha256": hashlib.sha256(bundle).hexdigest()}}],
        "predicateType": TEST_RESULT,
        "predicate": test_result(manifest),
    }
    return json.dumps(statement, separators=(",", ":"), sort_keys=True).encode()


def signed_envelope(payload: bytes, key: "Ed25519PrivateKey") -> str:
    """Return the DSSE envelope of a statement, as one line of JSON."""
    signature = {"keyid": key_id(key.public_key()), "sig": _base64(key.sign(_signed_bytes(payload)))}
    envelope = {"payloadType": PAYLOAD_TYPE, "payload": _base64(payload), "signatures": [signature]}
    return json.dumps(envelope, separators=(",", ":")) + "\n"


@dataclass(frozen=True)
class SignedStatement:
    """A statement whose signature is valid."""

    signer: str
    """Id of the key."""
    result: str
    """``PASSED``, ``WARNED`` or ``FAILED``."""


def verify_attestation(content: bytes | None, digest: str, keys: Mapping[str, "Ed25519PublicKey"]) -> SignedStatement:
    """Return the statement about a bundle that one of some keys has signed.

    Args:
        content: envelopes, one a line; None if there are none.
        digest: SHA-256 of the bundle.
        keys: trusted public keys, by their ids.

    Raises:
        RefusedBundleError: there is none.
    """
    if content is None:
        raise RefusedBundleError("it is not signed: found no attestation beside it")
    problems = []
    for number, line in enumerate(content.splitlines(), start=1):
        if line.strip():
            try:
                return _verified_statement(line, digest, keys)
            except RefusedBundleError as error:
                problems.append(f"line {number}: {error}")
    raise RefusedBundleError(f"the attestation does not hold: {'; '.join(problems[:3]) or 'found nothing in it'}")


def _verified_statement(line: bytes, digest: str, keys: Mapping[str, "Ed25519PublicKey"]) -> SignedStatement:
    try:
        envelope = parse_json(line)
        payload = _bytes_of_base64(envelope["payload"])
        signatures = [
            (str(each["keyid"]), _bytes_of_base64(each["sig"])) for each in envelope["signatures"][:MAX_SIGNATURES]
        ]
        kind = envelope["payloadType"]
        if len(envelope) > 3 or any(len(each) > 2 for each in envelope["signatures"]):
            raise ValueError("found more keys than payload, payloadType and signatures with keyid and sig")
    except (ValueError, LookupError, TypeError, RecursionError) as error:
        raise RefusedBundleError(f"this is no DSSE envelope: {error}") from None
    if kind != PAYLOAD_TYPE:
        raise RefusedBundleError(f"found the payload {kind!r:.80}, expected {PAYLOAD_TYPE}")
    signer = next((name for name, each in signatures if name in keys and _is_signed(payload, each, keys[name])), None)
    if signer is None:
        raise RefusedBundleError(f"no signature is of a trusted key ({', '.join(each[:12] for each in keys)})")
    try:
        statement = parse_json(payload)
        subjects = [subject["digest"]["sha256"] for subject in statement["subject"]]
        types = (statement["_type"], statement["predicateType"])
        outcome = statement["predicate"]["result"]
    except (ValueError, LookupError, TypeError, RecursionError) as error:
        raise RefusedBundleError(f"this is no statement of in-toto: {error}") from None
    if types != (STATEMENT_TYPE, TEST_RESULT):
        raise RefusedBundleError(f"found a statement of {types[1]!r:.80}, expected {TEST_RESULT}")
    if digest not in subjects:
        raise RefusedBundleError(
            f"it is of another bundle: found sha256 {digest}, expected {', '.join(map(str, subjects)):.80}"
        )
    if outcome not in ("PASSED", "WARNED", "FAILED"):
        raise RefusedBundleError(f"found the result {outcome!r:.80}, expected PASSED, WARNED or FAILED")
    return SignedStatement(signer, outcome)


def _is_signed(payload: bytes, signature: bytes, key: "Ed25519PublicKey") -> bool:
    invalid = optional("cryptography.exceptions", "verify").InvalidSignature
    try:
        key.verify(signature, _signed_bytes(payload))
    except invalid:
        return False
    return True


def _signed_bytes(payload: bytes) -> bytes:
    """Return what DSSE signs, its "pre-authentication encoding"."""
    kind = PAYLOAD_TYPE.encode()
    return b"DSSEv1 %d %s %d %s" % (len(kind), kind, len(payload), payload)


def _bytes_of_base64(text: str) -> bytes:
    """Decode base64 of one possible form: the bits that do not count are 0."""
    content = base64.b64decode(text, validate=True)
    if _base64(content) != text:
        raise ValueError("found base64 with bits that do not count, expected zeros")
    return content


def _base64(content: bytes) -> str:
    return base64.b64encode(content).decode("ascii")


def read_public_keys(paths: Sequence[Path]) -> dict[str, "Ed25519PublicKey"]:
    """Read public keys in PEM, and return them by their ids.

    Raises:
        InputError: a file has no Ed25519 key.
        InfrastructureError: cryptography is not installed.
    """
    keys = (_loaded_key(read_bytes(path, MAX_KEY_BYTES, "a public key"), str(path), private=False) for path in paths)
    return {key_id(key): key for key in keys}


def parse_signing_key(text: str, where: str) -> "Ed25519PrivateKey":
    """Parse a private key in PEM; no message quotes it.

    Raises:
        InputError: it is no Ed25519 key, or is encrypted.
        InfrastructureError: cryptography is not installed.
    """
    key: Ed25519PrivateKey = _loaded_key(text.strip().encode() + b"\n", where, private=True)
    return key


def _loaded_key(content: bytes, where: str, *, private: bool) -> Any:
    serialization = optional("cryptography.hazmat.primitives.serialization", "signing and verify")
    kinds = optional("cryptography.hazmat.primitives.asymmetric.ed25519", "signing and verify")
    what = "private" if private else "public"
    try:
        if private:
            key = serialization.load_pem_private_key(content, password=None)
        else:
            key = serialization.load_pem_public_key(content)
    except (ValueError, TypeError, optional("cryptography.exceptions", "verify").UnsupportedAlgorithm):
        # The reason is not quoted: it may have parts of the key.
        raise InputError(f"{where}: expected an unencrypted {what} key in PEM ({_HOW_TO_MAKE})") from None
    if not isinstance(key, kinds.Ed25519PrivateKey if private else kinds.Ed25519PublicKey):
        raise InputError(f"{where}: found another kind of {what} key, expected Ed25519 ({_HOW_TO_MAKE})")
    return key


def key_id(key: "Ed25519PublicKey") -> str:
    """Return the id of a key: the SHA-256 of its DER form."""
    serialization = optional("cryptography.hazmat.primitives.serialization", "signing and verify")
    der = key.public_bytes(serialization.Encoding.DER, serialization.PublicFormat.SubjectPublicKeyInfo)
    return hashlib.sha256(der).hexdigest()
