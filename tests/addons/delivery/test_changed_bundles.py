"""Bundles that were changed are refused, each with its reason; the untouched one is accepted."""

from dataclasses import replace

import pytest

from calibration.addons.delivery.archive import pack_files, unpack_files
from calibration.addons.delivery.checking import check_bundle
from calibration.base.errors import InputError

from .bundles import FILES, MANIFEST, OTHER_KEY, SYSTEM, packed, signed
from .changed import EXPECTED, GOOD, KINDS, changed_bundle, check

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
