"""A bundle as a tar archive of one possible form, and its ``manifest.json``.

The same files are the same bytes: names are sorted, times and owners are 0, modes are 0644. A header that this module
would not write itself is refused, so links, devices, sparse files, extended headers, folders, repeated names and hidden
bytes cannot be in a bundle. The manifest says what it holds, of which robot, made from what, and how it was judged.
"""

import re
import tarfile
from collections.abc import Mapping
from itertools import dropwhile
from typing import Annotated, Literal

from calibration.base import InputError, one_line, parse_json_of, shorten
from calibration.base.records import field, length, matching, read, result, text_of
from calibration.base.verdict import Verdict

MAX_BUNDLE_BYTES = 64 * 1024**2
MAX_FILES = 10_000
BLOCK_BYTES = 512
_LINK_TYPES = (tarfile.LNKTYPE, tarfile.SYMTYPE)


class RefusedBundleError(Exception):
    """A bundle is not accepted; the message says why, in one line."""


def pack_files(files: Mapping[str, bytes]) -> bytes:
    """Return the archive of files, by their paths.

    Raises:
        InputError: a path is too long for a header (100 bytes, with folders 255), or there is too much to pack.
    """
    parts = []
    for name in sorted(files):
        try:
            parts.append(_header(name, len(files[name])))
        except ValueError as error:
            raise InputError(f"{shorten(one_line(name), 200)}: this cannot be packed: {error}") from None
        parts += [files[name], bytes(-len(files[name]) % BLOCK_BYTES)]
    content = b"".join([*parts, bytes(2 * BLOCK_BYTES)])
    if len(content) > MAX_BUNDLE_BYTES or len(files) > MAX_FILES:
        raise InputError(
            f"found {len(files)} files of {len(content)} bytes, expected at most {MAX_FILES} of {MAX_BUNDLE_BYTES}"
        )
    return content


def unpack_files(content: bytes) -> dict[str, bytes]:
    """Return the files of an archive that `pack_files` has written, by their paths.

    Raises:
        RefusedBundleError: it could not have written these bytes.
    """
    files: dict[str, bytes] = {}
    at, last = 0, ""
    while (header := content[at : at + BLOCK_BYTES]) != bytes(BLOCK_BYTES):
        if len(header) < BLOCK_BYTES:
            raise RefusedBundleError("it ends too early")
        name, size = _checked_header(header)
        if name <= last:
            what = "occurs twice" if name in files else "is not in its order"
            raise RefusedBundleError(f"its file {_quoted(name)} {what}")
        at += BLOCK_BYTES
        if size > len(content) - at:
            raise RefusedBundleError(f"its file {_quoted(name)} claims {size} bytes, more than there are")
        files[name], last = content[at : at + size], name
        at += size
        if any(content[at : at + -size % BLOCK_BYTES]):
            raise RefusedBundleError(f"there are bytes behind its file {_quoted(name)}")
        at += -size % BLOCK_BYTES
        if len(files) > MAX_FILES:
            raise RefusedBundleError(f"it has more than {MAX_FILES} files")
    if content[at:] != bytes(2 * BLOCK_BYTES):
        raise RefusedBundleError("it does not end behind its last file")
    return files


def _header(name: str, size: int) -> bytes:
    info = tarfile.TarInfo(name)
    info.size = size
    return info.tobuf(tarfile.USTAR_FORMAT, "utf-8", "strict")


def _checked_header(header: bytes) -> tuple[str, int]:
    """Return the name and the size in a header."""
    try:
        info = tarfile.TarInfo.frombuf(header, "utf-8", "strict")
    except (tarfile.HeaderError, ValueError) as error:
        raise RefusedBundleError(f"it is no bundle: {one_line(str(error))}") from None
    if info.type in _LINK_TYPES:
        raise RefusedBundleError(f"its file {_quoted(info.name)} is a link to {_quoted(info.linkname)}")
    if info.type != tarfile.REGTYPE:
        raise RefusedBundleError(f"its file {_quoted(info.name)} is no regular file")
    parts = info.name.split("/")
    if not info.name.isprintable() or "\\" in info.name or any(part in ("", ".", "..") for part in parts):
        raise RefusedBundleError(f"its file {_quoted(info.name)} has a path that leaves the bundle, or is none")
    try:
        canonical = info.size >= 0 and header == _header(info.name, info.size)
    except ValueError:
        canonical = False
    if not canonical:
        raise RefusedBundleError(f"its file {_quoted(info.name)} has an owner, a mode, a time or more in its header")
    return info.name, info.size


def _quoted(name: str) -> str:
    return repr(shorten(one_line(name), 200))


MANIFEST_FILE = "manifest.json"
MANIFEST_VERSION: Literal[1] = 1
Sha256 = Annotated[str, matching("[0-9a-f]{64}", "64 hexadecimal digits")]
Name = Annotated[str, length(1, 500)]
VERSION_PATTERN = r"[0-9]{1,18}(\.[0-9]{1,18}){0,3}"
Version = Annotated[str, matching(VERSION_PATTERN, "one to four numbers such as 1.4.2")]


BUNDLE_ENDING = ".calibration.tar"
"""End of the name of a bundle's file."""


def is_version(text: str) -> bool:
    """Return whether a text is a version of a bundle."""
    return re.fullmatch(VERSION_PATTERN, text, re.ASCII) is not None


def version_order(version: str) -> tuple[int, ...]:
    """Return the key by which versions are ordered: 1.10 is after 1.9, and 1.0 is 1."""
    numbers = [int(part) for part in version.split(".")]
    return tuple(reversed(list(dropwhile(lambda number: number == 0, reversed(numbers)))))


@result(kw_only=True)
class BundledTransform:
    """Calibrated transform, as it must be in use."""

    parent: Name = field("The parent frame.")
    child: Name = field("The child frame.")
    trans: Annotated[tuple[float, ...], length(3, 3)] = field("Translation.", unit="m")
    quat: Annotated[tuple[float, ...], length(4, 4)] = field("Rotation, a quaternion xyzw.")
    joint: bool = field("Whether it is a joint that moves, at position 0: only a URDF has its origin.", default=False)


@result(kw_only=True)
class BundledCamera:
    """Camera, as it must be in use; its rectification is none, and its projection matrix has K."""

    name: Name = field("The camera.")
    frame: Name = field("Frame of its images.")
    width: int = field("Of its images.", unit="px")
    height: int = field("Of its images.", unit="px")
    distortion_model: Name = field("Lens model, by its name in ROS.")
    K: Annotated[tuple[float, ...], length(9, 9)] = field("Camera matrix, row by row.", key="K")
    D: tuple[float, ...] = field("Coefficients of the lens.", key="D")


@result
class JudgedStart:
    """One calibration of the system, from one initial guess."""

    name: Name = field("The system, and the noise of the guess.")
    verdict: Verdict = field("Pass; undecided; or fail.")


@result(kw_only=True)
class BundledSystem:
    """Calibrated system in a bundle; its files are in the folder of its name."""

    name: Name = field("The system.")
    verdict: Verdict = field("The worst of its starts.")
    reasons: tuple[str, ...] = field("Why the verdict is not pass.", default=())
    marks: tuple[str, ...] = field(
        "Why it would not be bundled unless asked for: it is red, undecided or not accepted.", default=()
    )
    starts: tuple[JudgedStart, ...] = field("Its calibrations from all initial guesses.")
    labels: Sha256 | None = field("SHA-256 of its labels.", default=None)
    inputs: Mapping[str, str] = field("Hashes of its other inputs, as in the baseline.", default_factory=dict)
    description: Sha256 | None = field("SHA-256 of the robot's description that was calibrated.", default=None)
    accepted_although: str | None = field("Reason for accepting it although it had failed.", default=None)
    transforms: tuple[BundledTransform, ...] = field("Its calibrated transforms.", default=())
    cameras: tuple[BundledCamera, ...] = field("Its cameras.", default=())


@result
class SystemLeftOut:
    """System that is not in the bundle."""

    name: Name = field("The system.")
    why: str = field("Why it is not in it.")


@result
class BundledFile:
    """File of a bundle."""

    path: Name = field("Its path in the bundle.")
    size: int = field("Its size, bytes.")
    sha256: Sha256 = field("Its SHA-256.")


@result(kw_only=True)
class Manifest:
    """Manifest of a bundle: calibrations for one robot, and where they come from."""

    bundle: Literal[1] = field("Version of this format.")
    name: Name = field("The robot.")
    version: Version = field("Its version: one to four numbers; a later bundle has a larger one.")
    made: int = field("Time of the commit, or SOURCE_DATE_EPOCH; seconds since 1970, UTC.")
    serial: str | None = field("Serial number of the robot.", default=None)
    engine: Name = field("Version of Calibration CI that calibrated.")
    commit: str | None = field("The commit that was tested.", default=None)
    uncommitted: bool = field(
        "Whether files differed from that commit, or the accepted calibrations were in none.", default=False
    )
    configuration: Sha256 = field("SHA-256 of calibration.yml.")
    although: str | None = field("Why it was bundled although systems are marked.", default=None)
    systems: tuple[BundledSystem, ...] = field("The systems.")
    left_out: tuple[SystemLeftOut, ...] = field("Systems of calibration.yml that are not in it.", default=())
    files: tuple[BundledFile, ...] = field("All files but this one.")

    @property
    def marks(self) -> tuple[str, ...]:
        """Why systems would not be bundled unless asked for."""
        return tuple(f"{system.name}: {mark}" for system in self.systems for mark in system.marks)

    @property
    def file_name(self) -> str:
        """Name of the bundle's file."""
        return f"{self.name}{BUNDLE_ENDING}"

    @property
    def text(self) -> str:
        """The content of its file."""
        return text_of(self)


def parse_manifest(content: bytes, where: str) -> Manifest:
    """Parse a manifest.

    Raises:
        InputError: it is not valid; the message begins with ``where``.
    """
    return read(Manifest, parse_json_of(content, where, "a manifest"), where)
