"""Unpacking of bags with a limit: the library rosbags has none, and a file of some kilobytes can hold gigabytes."""

import bz2
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from calibration.base.optional import optional

MAX_CHUNK = 1 << 28
"""Limit of the bytes that one chunk, or one message, unpacks to."""
UNPACKED_FREELY = 1 << 26
"""Bytes that a bag may unpack to, however small it is: a few images of one colour, or depths without a return."""
UNPACKED_FREELY_TO_DISK = 1 << 28
"""The same of a file that is compressed as a whole: there it goes to the disk."""
MAX_RATIO = 250
"""Limit of unpacked bytes for each packed one, beyond these; recorded images have 2 to 10, rendered ones 100."""
_TOO_MUCH = f"it unpacks to more than {MAX_RATIO} times its size"
MAX_LZ4_RATIO = 255
"""Limit that lz4's format has itself."""


class UnpackingError(Exception):
    """Something unpacks to too much, or is truncated."""


class UnpackingBudget:
    """What may still be unpacked in one pass over a bag."""

    def __init__(self) -> None:
        self._left = UNPACKED_FREELY

    @property
    def room(self) -> int:
        """Limit of the next chunk."""
        return min(self._left, MAX_CHUNK)

    def unpack(self, decompressor: Callable[[], Any], packed: bytes) -> bytes:
        """Unpack a chunk.

        Args:
            decompressor: class of bz2, lz4 or zstd that unpacks one stream up to a length.
            packed: the chunk: one stream, or several in succession.

        Raises:
            UnpackingError: it unpacks to more than is left, or is truncated.
        """
        self._left += MAX_RATIO * len(packed)
        parts = []
        rest: bytes | None = packed
        while rest:
            stream, room = decompressor(), self.room
            parts.append(stream.decompress(rest, max_length=room + 1))
            self._spend_bytes(len(parts[-1]))
            if len(parts[-1]) > room:
                raise UnpackingError(f"found a chunk that unpacks to more than {MAX_CHUNK} bytes")
            if not stream.eof:
                raise UnpackingError("found a chunk that is truncated")
            rest = stream.unused_data
        return b"".join(parts)

    def unpack_lz4(self, packed: bytes) -> bytes:
        """Unpack a chunk of lz4, as `unpack` does; at once, where no more than there is room for can come out of it.

        Raises:
            UnpackingError: it unpacks to more than is left, or is truncated.
        """
        lz4 = optional("lz4.frame", "reading bags")
        if MAX_LZ4_RATIO * len(packed) > self.room:
            return self.unpack(lz4.LZ4FrameDecompressor, packed)
        self._left += MAX_RATIO * len(packed)
        found: bytes = lz4.decompress(packed)
        self._spend_bytes(len(found))
        return found

    def _spend_bytes(self, size: int) -> None:
        self._left -= size
        if self._left < 0:
            raise UnpackingError(_TOO_MUCH)


def unpack_files(files: Sequence[Path], folder: Path) -> list[Path]:
    """Unpack files of zstd into a folder, and return theirs, whose names lack the last suffix.

    Raises:
        UnpackingError: they unpack to more than they may.
        OSError, zstd.ZstdError: one cannot be read or written, or is damaged.
    """
    zstd = optional("compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd", "reading bags")
    left = UNPACKED_FREELY_TO_DISK + MAX_RATIO * sum(file.stat().st_size for file in files)
    unpacked = [folder / file.stem for file in files]
    for file, target in zip(files, unpacked, strict=True):
        with file.open("rb") as packed, zstd.open(packed, "rb") as source, target.open("xb") as output:
            while part := source.read(1 << 20):
                left -= len(part)
                if left < 0:
                    raise UnpackingError(_TOO_MUCH)
                output.write(part)
    return unpacked


_budget = UnpackingBudget()


def begin_pass() -> None:
    """Begin a pass over a bag: what the library unpacks in it is counted anew."""
    global _budget
    _budget = UnpackingBudget()


def bound_library() -> None:
    """Replace the functions by which the library unpacks chunks and messages."""
    reader1, reader2, mcap = (
        optional(f"rosbags.{name}", "reading bags")
        for name in ("rosbag1.reader", "rosbag2.reader", "rosbag2.storage_mcap")
    )
    if isinstance(reader2.zstd, SimpleNamespace):
        return  # it is done

    def unpack_zstd(packed: bytes, _size: int = 0, decompressor: Any = reader2.zstd.ZstdDecompressor) -> bytes:
        return _budget.unpack(decompressor, packed)

    reader1.decompressors["bz2"] = lambda packed: _budget.unpack(bz2.BZ2Decompressor, packed)
    reader1.decompressors["lz4"] = lambda packed: _budget.unpack_lz4(packed)
    mcap.DECOMPRESSORS |= {"lz4": lambda packed, _: _budget.unpack_lz4(packed), "zstd": unpack_zstd}
    reader2.zstd = SimpleNamespace(decompress=unpack_zstd)  # without open: `unpack_files` is there for whole files
