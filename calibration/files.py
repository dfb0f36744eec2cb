"""Files: read up to a size, written as a whole or not at all."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from calibration.errors import InputError, WorldError


def read_bytes(path: Path | str, limit: int, what: str) -> bytes:
    """The bytes of a regular file; ``what`` it should be is for messages ("a CSV file").

    Raises:
        InputError: there is no such file, it may not be read, is no regular file, or has more than
            ``limit`` bytes.
        WorldError: reading fails.
    """
    path = Path(path)
    try:
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: this is no regular file, {what} was expected")
        file = path.open("rb")
    except (OSError, ValueError) as error:  # ValueError: a NUL or a lone surrogate in the name
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise InputError(f"{path}: {what} was expected, but it cannot be opened: {reason}") from None
    with file:
        try:
            data = file.read(limit + 1)
        except OSError as error:
            raise WorldError(f"{path}: the file cannot be read: {error.strerror}") from error
    if len(data) > limit:
        raise InputError(f"{path}: the file is larger than {limit // 1024**2} MiB, too large for {what}")
    return data


def write_atomically(path: Path | str, content: bytes | str) -> None:
    """Write a file so that a reader sees the old content or the new, never a part; folders are made.

    Text is written as UTF-8; half a surrogate pair, which UTF-8 cannot hold, as an escape.

    Raises:
        WorldError: the file cannot be written.
    """
    data = content.encode("utf-8", "backslashreplace") if isinstance(content, str) else content
    with _replacing(Path(path)) as temporary:
        temporary.write_bytes(data)


def place(source: Path | str, target: Path | str) -> None:
    """Make ``target`` the same file as ``source``: a hard link, or a copy where links are not possible.

    Folders are made. Whoever rewrites one of the two by renaming (as `write_atomically` does)
    leaves the other as it is.

    Raises:
        WorldError: the file cannot be written, or the source not read.
    """
    with _replacing(Path(target)) as temporary:
        try:
            temporary.hardlink_to(source)
        except OSError:
            shutil.copyfile(source, temporary)


@contextmanager
def _replacing(path: Path) -> Iterator[Path]:
    """A name beside the file for its new content, which replaces the file if nothing goes wrong."""
    temporary = path.with_name(f".{os.urandom(8).hex()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            yield temporary
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    except (OSError, ValueError) as error:  # ValueError: a NUL or a lone surrogate in the name
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise WorldError(f"{path}: cannot be written: {reason}") from error
