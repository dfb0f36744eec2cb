"""Bundles that were changed by a seed and must be refused: ``python -m tests.addons.delivery.changed``."""

import argparse
import io
import random
import sys
import tarfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from calibration.addons.delivery.checking import CheckedBundle, Expectations, check_bundle
from calibration.addons.delivery.destinations import FetchedBundle
from calibration.addons.delivery.manifest import MANIFEST_FILE, unpack_files
from tests.addons.delivery.bundles import DAY, FILES, MADE, MANIFEST, OTHER_KEY, SYSTEM, TRUSTED, packed, signed

GOOD = signed(packed())
EXPECTED = Expectations(
    keys=TRUSTED,
    serial="SN-1",
    description=SYSTEM.description,
    max_age=30 * DAY,
    at_least="1.3.9",
    now=lambda: MADE + DAY,
)
_Draw = random.Random


@dataclass(frozen=True)
class ChangedBundle:
    """A bundle that must be refused."""

    kind: str
    fetched: FetchedBundle
    reason: str
    """What its reason says."""
    expected: Expectations = EXPECTED


def _flipped(data: bytes, draw: _Draw) -> bytes:
    place = draw.randrange(len(data))
    return data[:place] + bytes([data[place] ^ (1 << draw.randrange(8))]) + data[place + 1 :]


def byte_of_the_bundle(draw: _Draw) -> tuple[FetchedBundle, str]:
    return replace(GOOD, content=_flipped(GOOD.content, draw)), "it is of another bundle"


def byte_of_the_attestation(draw: _Draw) -> tuple[FetchedBundle, str]:
    return replace(GOOD, attestation=_flipped((GOOD.attestation or b"").strip(), draw)), "the attestation does not hold"


def piece_of_the_bundle(draw: _Draw) -> tuple[FetchedBundle, str]:
    content, (start, end) = GOOD.content, sorted(draw.sample(range(len(GOOD.content)), 2))
    changed = draw.choice((content[:start], content[:start] + content[end:], content[:end] + content[start:]))
    return replace(GOOD, content=changed), "it is of another bundle"


def no_attestation(_: _Draw) -> tuple[FetchedBundle, str]:
    return replace(GOOD, attestation=None), "it is not signed"


def other_key(_: _Draw) -> tuple[FetchedBundle, str]:
    return signed(GOOD.content, key=OTHER_KEY), "no signature is of a trusted key"


def red_made_green(draw: _Draw) -> tuple[FetchedBundle, str]:
    """The manifest of a signed red bundle says pass, with new hashes and the old signature, or that of a stranger."""
    red = replace(MANIFEST, systems=(replace(SYSTEM, verdict="fail", marks=("fail: 3 mm",)),), although="a test")
    attestation = signed(packed(red), red).attestation
    if draw.random() < 0.5:
        return FetchedBundle("b", packed(), attestation), "it is of another bundle"
    return signed(packed(), red, OTHER_KEY), "no signature is of a trusted key"


def red(_: _Draw) -> tuple[FetchedBundle, str]:
    marked = replace(MANIFEST, systems=(replace(SYSTEM, verdict="fail", marks=("fail: 3 mm",)),), although="a test")
    return signed(packed(marked), marked), "bundled although: a test"


def red_without_a_mark(_: _Draw) -> tuple[FetchedBundle, str]:
    manifest = replace(MANIFEST, systems=(replace(SYSTEM, verdict="fail", reasons=("3 mm",)),))
    return signed(packed(manifest), manifest), "stereo: fail: 3 mm"


def attested_as_failed(_: _Draw) -> tuple[FetchedBundle, str]:
    red = replace(MANIFEST, systems=(replace(SYSTEM, marks=("fail: 3 mm",)),))
    return signed(GOOD.content, red), "its attestation says FAILED"


def older_version(draw: _Draw) -> tuple[FetchedBundle, str]:
    manifest = replace(MANIFEST, version=draw.choice(("1.3.8", "1.3", "0.99.99", "1", "1.03.08")))
    return signed(packed(manifest), manifest), "it is an older one"


def expired(draw: _Draw) -> tuple[FetchedBundle, str]:
    manifest = replace(MANIFEST, made=MADE - draw.randrange(30, 3000) * DAY)
    return signed(packed(manifest), manifest), "it has expired"


def of_the_future(draw: _Draw) -> tuple[FetchedBundle, str]:
    manifest = replace(MANIFEST, made=MADE + draw.randrange(3, 3000) * DAY)
    return signed(packed(manifest), manifest), "it is of the future"


def other_robot(draw: _Draw) -> tuple[FetchedBundle, str]:
    if draw.random() < 0.5:
        manifest = replace(MANIFEST, serial=draw.choice((None, "SN-10", "sn-1", "SN-1 ")))
        return signed(packed(manifest), manifest), "it is of another robot: found the serial number"
    manifest = replace(MANIFEST, systems=(replace(SYSTEM, description=draw.choice((None, "3" * 64))),))
    return signed(packed(manifest), manifest), "it is of another robot: found no description"


def file_not_as_listed(draw: _Draw) -> tuple[FetchedBundle, str]:
    """A bundle that its own team has packed wrong."""
    files, name = unpack_files(GOOD.content), draw.choice(sorted(FILES))
    if draw.random() < 0.5:
        return signed(_tar({**files, name: _flipped(files[name], draw)})), "has another content than its manifest"
    if draw.random() < 0.5:
        return signed(_tar({**files, "stereo/z": b"z"})), "its manifest does not list it"
    return signed(_tar({each: files[each] for each in files if each != name})), "it is not there"


def broken_manifest(draw: _Draw) -> tuple[FetchedBundle, str]:
    files = unpack_files(GOOD.content)
    text = draw.choice((b"", b"[]", b"{", b'{"bundle": 2}', b"\xff", b"[" * 100_000, files[MANIFEST_FILE][:-9]))
    return signed(_tar({**files, MANIFEST_FILE: text})), MANIFEST_FILE


HOSTILE_MEMBERS: tuple[tuple[str, dict[str, Any], str], ...] = (
    ("stereo/a", {"type": tarfile.SYMTYPE, "linkname": "/etc/passwd"}, "is a link to '/etc/passwd'"),
    ("stereo/a", {"type": tarfile.LNKTYPE, "linkname": "manifest.json"}, "is a link to 'manifest.json'"),
    ("stereo/a", {"type": tarfile.CHRTYPE, "devmajor": 1, "devminor": 3}, "is no regular file"),
    ("stereo/a", {"type": tarfile.BLKTYPE}, "is no regular file"),
    ("stereo/a", {"type": tarfile.FIFOTYPE}, "is no regular file"),
    ("stereo", {"type": tarfile.DIRTYPE}, "is no regular file"),
    ("stereo/a", {"type": tarfile.CONTTYPE}, "is no regular file"),
    ("stereo/a", {"type": tarfile.GNUTYPE_SPARSE, "size": 1 << 40}, "is no regular file"),
    ("stereo/a", {"type": tarfile.XHDTYPE}, "is no regular file"),
    ("stereo/z", {"size": 1 << 32}, "more than there are"),
    ("../../etc/cron.d/a", {}, "leaves the bundle"),
    ("/etc/passwd", {}, "leaves the bundle"),
    ("stereo/../../a", {}, "leaves the bundle"),
    ("stereo/./a", {}, "leaves the bundle"),
    ("stereo//a", {}, "leaves the bundle"),
    ("stereo\\..\\a", {}, "leaves the bundle"),
    ("stereo/a\n", {}, "leaves the bundle"),
    ("stereo/tf_static.yaml", {}, "occurs twice"),
    ("a", {}, "is not in its order"),
    ("stereo/z", {"mode": 0o4755}, "a mode"),
    ("stereo/z", {"uid": 1000}, "an owner"),
    ("stereo/z", {"mtime": 1}, "a time"),
    ("stereo/z", {"uname": "root"}, "an owner"),
)
"""Name and header of a member, and the reason for which it is refused."""


def hostile_member(draw: _Draw) -> tuple[FetchedBundle, str]:
    """A member that a team's own key has signed: a link, a device, a path, a bomb, a repeated name."""
    name, changes, reason = draw.choice(HOSTILE_MEMBERS)
    return with_member(name, changes), reason


def with_member(name: str, changes: dict[str, Any]) -> FetchedBundle:
    """Return a bundle with one member more, signed by a team's own key."""
    return signed(_tar(unpack_files(GOOD.content), (name, changes)))


PADDED = GOOD.content.rindex(FILES["stereo/tf_static.yaml"]) + 100
"""Place in the zeros behind the last file."""
HIDDEN_BYTES = (
    (GOOD.content + b"\0", "does not end behind its last file"),
    (GOOD.content + bytes(512), "does not end behind its last file"),
    (GOOD.content + b"x", "does not end behind its last file"),
    (GOOD.content[:-1], "does not end behind its last file"),
    (GOOD.content[:-1024], "it ends too early"),
    (GOOD.content[:PADDED] + b"x" + GOOD.content[PADDED + 1 :], "there are bytes behind its file"),
)
"""Archives with bytes that no file has, or without some, and the reason for which each is refused."""


def hidden_bytes(draw: _Draw) -> tuple[FetchedBundle, str]:
    content, reason = draw.choice(HIDDEN_BYTES)
    return signed(content), reason


def no_archive(draw: _Draw) -> tuple[FetchedBundle, str]:
    return signed(draw.choice((b"", b"\x1f\x8b" + bytes(600), b"x" * 5000, bytes(2 * 512)))), "it"


def _tar(files: dict[str, bytes], member: tuple[str, dict[str, Any]] | None = None) -> bytes:
    """Return an archive as any tool may write it, with one member more."""
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        for name in sorted(files):
            info = tarfile.TarInfo(name)
            info.size = len(files[name])
            archive.addfile(info, io.BytesIO(files[name]))
        stream.seek(0, io.SEEK_END)
        if member is not None:
            info = tarfile.TarInfo(member[0])
            for key, value in member[1].items():
                setattr(info, key, value)
            stream.write(info.tobuf(tarfile.GNU_FORMAT if info.size >= 1 << 33 else tarfile.USTAR_FORMAT))
    content = stream.getvalue().rstrip(b"\0")
    return content + bytes(-len(content) % 512 + 1024)  # two blocks of zeros at its end


KINDS: tuple[Callable[[_Draw], tuple[FetchedBundle, str]], ...] = (
    byte_of_the_bundle,
    byte_of_the_attestation,
    piece_of_the_bundle,
    no_attestation,
    other_key,
    red_made_green,
    red,
    red_without_a_mark,
    attested_as_failed,
    older_version,
    expired,
    of_the_future,
    other_robot,
    file_not_as_listed,
    broken_manifest,
    hostile_member,
    hostile_member,
    hostile_member,
    hidden_bytes,
    no_archive,
)


def changed_bundle(seed: int) -> ChangedBundle:
    """Return a changed bundle; the kinds take turns."""
    kind, draw = KINDS[seed % len(KINDS)], random.Random(seed)
    fetched, reason = kind(draw)
    return ChangedBundle(kind.__name__, fetched, reason)


def check(case: ChangedBundle) -> CheckedBundle:
    return check_bundle(case.fetched, case.expected)


def main() -> int:
    """Check many changed bundles; print how many of each kind were refused, and those that were not."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    refused: Counter[str] = Counter()
    failures = []
    for seed in range(arguments.seed, arguments.seed + arguments.cases):
        case = changed_bundle(seed)
        reasons = check(case).reasons
        refused[case.kind] += bool(reasons)
        if not reasons or not any(case.reason in each for each in reasons):
            failures.append(f"{seed}: {case.kind}: {reasons}, expected '{case.reason}'")
    print(*(f"{count:5} refused: {kind}" for kind, count in sorted(refused.items())), *failures[:20], sep="\n")
    print(f"{arguments.cases - sum(refused.values())} of {arguments.cases} accepted")
    return int(bool(failures))


if __name__ == "__main__":
    sys.exit(main())
