"""Bundles as tar archives of one possible form: the same files are the same bytes, and any other bytes are refused.

Names are sorted, times and owners are 0, modes are 0644. A header that this module would not write itself is refused,
so links, devices, sparse files, extended headers, folders, repeated names and hidden bytes cannot be in a bundle.
"""

import tarfile
from collections.abc import Mapping

from calibration.base.errors import InputError
from calibration.base.text import one_line, shorten

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
