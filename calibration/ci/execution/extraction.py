"""Extraction of untrusted tar streams: only regular files and folders, inside one folder, with size limits."""

import hashlib
import io
import posixpath
import tarfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, cast

from calibration.base import CalibrationError, ExitCode, InfrastructureError, one_line, shorten, writing
from calibration.ci.execution.job import describe_bytes

MAX_FOLDER_DEPTH = 64
"""Limit of nested folders."""
_LONGEST_NAME = 255
_BLOCK_BYTES = 512
_MAX_HEADER_BYTES = 1024**2
"""Limit of the size of an entry's headers, in bytes."""
_CHUNK_BYTES = 1024**2


class RefusedError(CalibrationError):
    """An artifact is refused as unsafe or too large: the job has failed."""

    exit_code = ExitCode.FAIL


@dataclass
class Budget:
    """Remaining size and number of artifacts."""

    size: int
    """Bytes."""
    files: int
    """Files and folders."""
    passed_over: int = field(init=False)
    """Remaining bytes of other files, which have to be read too."""
    most: tuple[int, int] = field(init=False)

    def __post_init__(self) -> None:
        self.passed_over = self.size + 1024**3
        self.most = (self.size, self.files)


@dataclass(frozen=True)
class Extracted:
    """An extracted file."""

    path: str
    """Path relative to the folder."""
    size: int
    sha256: str


@dataclass
class Extraction:
    """Result of an extraction."""

    files: list[Extracted] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    """Notes on links within the folder, which are skipped."""
    seen: list[str] = field(default_factory=list)
    """Examples of files that were not requested."""


def extract(
    stream: Iterable[bytes],
    landing: Callable[[Sequence[str]], tuple[str, ...] | None],
    source: str,
    folder: Path,
    budget: Budget,
) -> Extraction:
    """Extract requested files into a folder, and never write outside it.

    Sizes are checked in the header, before the content is read. A hard link becomes a copy of its
    target.

    Args:
        stream: uncompressed tar.
        landing: returns the target path of an entry, from its parts below the archive's root; None to skip it.
        source: absolute path in the container of the archive's root, for links and messages.
        folder: existing folder without other writers.
        budget: limits, which are reduced.

    Raises:
        RefusedError: an entry is outside the folder, not a file or folder, conflicts with another, or is too large.
        InfrastructureError: the stream is truncated, or a file cannot be written.
    """
    result = Extraction()
    written: dict[tuple[str, ...], tuple[str, ...]] = {}
    for entry, content in _archive_entries(stream):
        inside = path_parts(entry.name)[1:]
        to = landing(inside)
        if to is None:
            _pass_over(entry, source, budget)
            if entry.isreg() and len(result.seen) < 5:
                result.seen.append("/".join(inside))
        elif entry.isdir():
            _charge_budget(entry, budget)
            _make_folder(folder, to)
        elif entry.issym():
            result.left_out.append(_link_inside(entry, inside, source))
        elif entry.islnk():
            first = path_parts(entry.linkname)[1:]
            if first not in written:
                raise _refused_entry(
                    entry, f"is a hard link to '{_shortened_name(entry.linkname)}', which is not an artifact"
                )
            entry.size = folder.joinpath(*written[first]).stat().st_size
            _charge_budget(entry, budget)
            with folder.joinpath(*written[first]).open("rb") as original:
                result.files.append(_write_file(entry, original, folder, to))
        elif entry.isreg():
            _charge_budget(entry, budget)
            result.files.append(_write_file(entry, content(), folder, to))
            written[inside] = to
        else:
            raise _refused_entry(entry, "is no file or folder, but a device or a pipe")
    return result


def _archive_entries(stream: Iterable[bytes]) -> Iterator[tuple[tarfile.TarInfo, Callable[[], IO[bytes]]]]:
    """Yield entries, and functions that open their content.

    Raises:
        InfrastructureError: the stream is truncated, or not a tar.
    """
    source = _Source(stream)
    try:
        with tarfile.open(fileobj=cast("IO[bytes]", source), mode="r|", bufsize=_BLOCK_BYTES * 128) as archive:
            for entry in archive:
                source.allow(entry.size + _MAX_HEADER_BYTES)

                def content(entry: tarfile.TarInfo = entry) -> IO[bytes]:
                    opened = archive.extractfile(entry)
                    assert opened is not None  # noqa: S101 (a regular file)
                    return opened

                yield entry, content
    except (tarfile.TarError, EOFError, ValueError, OverflowError, UnicodeError) as error:
        raise _broken_archive(error) from None
    if not source.is_complete:
        raise InfrastructureError("the archive of the artifacts ends too early")


class _Source:
    """File object of a stream that limits reads, to stop endless headers."""

    def __init__(self, stream: Iterable[bytes]) -> None:
        self._chunks = iter(stream)
        self._buffer = bytearray()
        self._last = b""
        self._allowed = _MAX_HEADER_BYTES

    def allow(self, count: int) -> None:
        """Set the number of bytes that may be read until the next call."""
        self._allowed = count + _BLOCK_BYTES * 128

    @property
    def is_complete(self) -> bool:
        """Whether it ended with zeros, as required for a tar."""
        return len(self._last) >= _BLOCK_BYTES and not any(self._last[-_BLOCK_BYTES:])

    def read(self, count: int) -> bytes:
        """Read a number of bytes; fewer at the end.

        Raises:
            InfrastructureError: the limit is exceeded.
        """
        while len(self._buffer) < count:
            chunk = next(self._chunks, None)
            if chunk is None:
                break
            self._buffer += chunk
        data = bytes(self._buffer[:count])
        del self._buffer[: len(data)]
        self._last = (self._last + data)[-_BLOCK_BYTES:]
        self._allowed -= len(data)
        if self._allowed < 0:
            raise InfrastructureError("the archive of the artifacts is broken: a header has no end")
        return data


def path_parts(name: str) -> tuple[str, ...]:
    """Split the name of an entry.

    Raises:
        RefusedError: it is outside the folder, or invalid on some file systems.
    """
    parts = tuple(part for part in name.split("/") if part not in ("", "."))
    if name.startswith("/") or ".." in parts or not parts:
        raise RefusedError(f"artifact '{_shortened_name(name)}' leaves its folder")
    if len(parts) > MAX_FOLDER_DEPTH:
        raise RefusedError(f"artifact '{_shortened_name(name)}' is nested in more than {MAX_FOLDER_DEPTH} folders")
    for part in parts:
        if not part.isprintable() or "\\" in part or len(part.encode("utf-8", "surrogateescape")) > _LONGEST_NAME:
            raise RefusedError(f"artifact '{_shortened_name(name)}' has a name that some file systems do not allow")
    return parts


def _link_inside(entry: tarfile.TarInfo, inside: tuple[str, ...], source: str) -> str:
    """Return the note on a link within the folder.

    Raises:
        RefusedError: it points outside.
    """
    root = source.rstrip("/") + "/"
    at = posixpath.dirname(root + "/".join(inside)) if inside else root
    leads_to = posixpath.normpath(posixpath.join(at, entry.linkname))
    if not f"{leads_to}/".startswith(root):
        raise _refused_entry(entry, f"is a link to '{_shortened_name(entry.linkname)}', which leaves the folder")
    return f"'{_shortened_name(entry.name)}' is a link to '{_shortened_name(entry.linkname)}'"


def _charge_budget(entry: tarfile.TarInfo, budget: Budget) -> None:
    if entry.size < 0 or entry.size > budget.size:
        raise _refused_entry(
            entry,
            f"has {describe_bytes(entry.size)}: more than the {describe_bytes(budget.most[0])} allowed for the "
            "artifacts of a job",
        )
    if budget.files < 1:
        raise _refused_entry(entry, f"exceeds the limit of {budget.most[1]} artifacts of a job")
    budget.size -= entry.size
    budget.files -= 1


def _pass_over(entry: tarfile.TarInfo, source: str, budget: Budget) -> None:
    budget.passed_over -= max(0, entry.size) + _BLOCK_BYTES
    if budget.passed_over < 0:
        raise _refused_entry(
            entry, f"and others beside the artifacts in {source} are too large to be read: give a more specific path"
        )


def _make_folder(folder: Path, parts: tuple[str, ...]) -> None:
    try:
        folder.joinpath(*parts).mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise RefusedError(f"artifact '{_shortened_name('/'.join(parts))}' is a folder and a file") from None
    except OSError as error:
        raise InfrastructureError(f"{folder}: an artifact cannot be written: {error.strerror}") from error


def _write_file(entry: tarfile.TarInfo, content: IO[bytes], folder: Path, parts: tuple[str, ...]) -> Extracted:
    _make_folder(folder, parts[:-1])
    digest = hashlib.sha256()
    size = 0
    with _new_file(folder.joinpath(*parts), entry) as file:
        while chunk := _read_chunk(content):
            digest.update(chunk)
            size += len(chunk)
            with writing(folder, "an artifact"):
                file.write(chunk)
    if size != entry.size:
        raise InfrastructureError("the archive of the artifacts ends too early")
    return Extracted("/".join(parts), size, digest.hexdigest())


def _new_file(path: Path, entry: tarfile.TarInfo) -> io.FileIO:
    try:
        return io.FileIO(path, "x")
    except (FileExistsError, IsADirectoryError):
        raise _refused_entry(entry, "has the same target as another file") from None
    except OSError as error:
        raise InfrastructureError(f"{path}: an artifact cannot be written: {error.strerror}") from error


def _read_chunk(content: IO[bytes]) -> bytes:
    """Read content, separately from writing, to distinguish errors of the stream from errors of the disk."""
    try:
        return content.read(_CHUNK_BYTES)
    except tarfile.TarError as error:
        raise _broken_archive(error) from None


def _broken_archive(error: Exception) -> InfrastructureError:
    return InfrastructureError(f"the archive of the artifacts is broken: {shorten(one_line(str(error)))}")


def _refused_entry(entry: tarfile.TarInfo, why: str) -> RefusedError:
    return RefusedError(f"artifact '{_shortened_name(entry.name)}' {why}")


def _shortened_name(name: str) -> str:
    return shorten(one_line(name), 200)
