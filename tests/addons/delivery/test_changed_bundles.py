"""Bundles that were changed are refused, each with its reason; the untouched one is accepted."""

import json
from dataclasses import replace
from typing import Any

import pytest

from calibration.addons.delivery.attestation import signed_envelope, statement_of
from calibration.addons.delivery.checking import check_bundle
from calibration.addons.delivery.manifest import pack_files, unpack_files
from calibration.base import InputError

from .bundles import FILES, KEY, MANIFEST, NAME, OTHER_KEY, SYSTEM, packed, signed
from .changed import EXPECTED, GOOD, HIDDEN_BYTES, HOSTILE_MEMBERS, KINDS, changed_bundle, check, with_member

CASES = 3 * len(KINDS)
"""In every run of the tests; ``python -m tests.addons.delivery.changed`` tries 1000."""


def test_the_untouched_bundle_is_accepted() -> None:
    checked = check_bundle(GOOD, EXPECTED)
    assert (checked.reasons, checked.warnings) == ((), ())
    assert checked.signed_by == next(iter(EXPECTED.keys))
    assert {name: checked.files[name] for name in FILES} == FILES


@pytest.mark.parametrize("seed", range(CASES))
def test_a_changed_bundle_is_refused_with_its_reason(seed: int) -> None:
    case = changed_bundle(seed)
    reasons = check(case).reasons
    assert any(case.reason in reason for reason in reasons), (case.kind, reasons)


@pytest.mark.parametrize(("name", "changes", "reason"), HOSTILE_MEMBERS)
def test_a_hostile_member_is_refused_though_it_is_signed(name: str, changes: dict[str, Any], reason: str) -> None:
    [found] = check_bundle(with_member(name, changes), EXPECTED).reasons
    assert reason in found


@pytest.mark.parametrize(("content", "reason"), HIDDEN_BYTES)
def test_bytes_beside_the_files_are_refused(content: bytes, reason: str) -> None:
    [found] = check_bundle(signed(content), EXPECTED).reasons
    assert reason in found


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        (b"application/vnd.in-toto+json", b"application/json", "found the payload 'application/json'"),
        (b'=="}]', b'=="},{}]', "this is no DSSE envelope"),
        (b'"keyid":"', b'"keyid":"0', "no signature is of a trusted key"),
        (b'{"payloadType"', b'{"a":1,"payloadType"', "found more keys"),
        (b'{"keyid"', b'{"a":1,"keyid"', "found more keys"),
        (b'{"payloadType"', b'["payloadType"', "this is no DSSE envelope"),
    ],
)
def test_an_envelope_has_one_form(old: bytes, new: bytes, reason: str) -> None:
    envelope = GOOD.attestation or b""
    assert old in envelope
    [found] = check_bundle(replace(GOOD, attestation=envelope.replace(old, new)), EXPECTED).reasons
    assert reason in found


def test_bits_of_base64_that_do_not_count_are_zero() -> None:
    envelope = GOOD.attestation or b""
    place = envelope.index(b'=="}]') - 1  # its last four bits do not count
    other = bytes([envelope[place] + 1])
    [found] = check_bundle(
        replace(GOOD, attestation=envelope[:place] + other + envelope[place + 1 :]), EXPECTED
    ).reasons
    assert "bits that do not count" in found


@pytest.mark.parametrize(
    ("key", "value", "reason"),
    [
        ("predicateType", "https://slsa.dev/provenance/v1", "found a statement of 'https://slsa.dev"),
        ("_type", "https://in-toto.io/Statement/v0.1", "found a statement of"),
        ("subject", [], "it is of another bundle"),
        ("subject", 3, "this is no statement of in-toto"),
        ("predicate", {"result": "passed"}, "found the result 'passed'"),
    ],
)
def test_a_signed_statement_of_another_kind_is_refused(key: str, value: object, reason: str) -> None:
    statement = json.loads(statement_of(GOOD.content, NAME, MANIFEST))
    payload = json.dumps({**statement, key: value}).encode()
    fetched = replace(GOOD, attestation=signed_envelope(payload, KEY).encode())
    [found] = check_bundle(fetched, EXPECTED).reasons
    assert reason in found


def test_a_bundle_of_no_system_is_refused() -> None:
    manifest = replace(MANIFEST, systems=())
    reasons = check_bundle(signed(packed(manifest), manifest), EXPECTED).reasons
    assert "it has no system" in reasons


def test_one_of_several_attestations_must_hold() -> None:
    stranger = signed(GOOD.content, key=OTHER_KEY).attestation or b""
    both = replace(GOOD, attestation=stranger + (GOOD.attestation or b""))
    assert check_bundle(both, EXPECTED).reasons == ()


def test_a_marked_bundle_is_accepted_only_if_asked_for() -> None:
    manifest = replace(MANIFEST, systems=(replace(SYSTEM, marks=("it is not accepted",)),), although="a test")
    fetched = signed(packed(manifest), manifest)
    assert check_bundle(fetched, EXPECTED).reasons == ("stereo: it is not accepted; bundled although: a test",)
    asked = check_bundle(fetched, replace(EXPECTED, marked=True))
    assert asked.reasons == ()
    assert asked.warnings == ("stereo: it is not accepted; bundled although: a test",)


def test_archives_are_sorted_and_reversible() -> None:
    files = {"b/x": b"1" * 512, "a": b"", "b/é": b"2", "b/" + "y" * 100: b"3"}
    content = pack_files(files)
    assert content == pack_files(dict(reversed(files.items())))
    assert unpack_files(content) == files


def test_what_a_header_cannot_hold_is_an_error() -> None:
    with pytest.raises(InputError, match=r"^y+: this cannot be packed"):
        pack_files({"y" * 101: b""})
