"""Files and folders: reading with a size limit, atomic writing, patterns of paths, and temporary folders."""

import os
import shutil
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from glob import glob, has_magic
from itertools import takewhile
from pathlib import Path
from tempfile import TemporaryDirectory

from calibration.base.errors import InfrastructureError, InputError
from calibration.base.process import held_back


def read_bytes(path: Path | str, limit: int, what: str) -> bytes:
    """Return the content of a regular file; ``what`` describes it in messages ("a CSV file").

    Raises:
        InputError: the file does not exist, is not readable, is not a regular file, or has more than
            ``limit`` bytes.
        InfrastructureError: reading fails.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)  # non-blocking, because opening a named pipe would wait
    except (OSError, ValueError) as error:  # ValueError: a NUL or a lone surrogate in the name
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise InputError(f"{path}: {what} was expected, but it cannot be read: {reason}") from None
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise InputError(f"{path}: this is no regular file, {what} was expected")
        if status.st_size > limit:
            raise InputError(f"{path}: found {status.st_size} bytes, {what} of at most {limit} was expected")
        return os.read(descriptor, status.st_size)
    except (OSError, MemoryError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else "not enough memory"
        raise InfrastructureError(f"{path}: {what} cannot be read: {reason}") from error
    finally:
        os.close(descriptor)


def write_atomically(path: Path | str, content: bytes | str) -> None:
    """Write a file so that readers see the old content or the new, never a part; creates missing folders.

    Text is written as UTF-8; lone surrogates, which UTF-8 cannot encode, are written as escapes.

    Raises:
        InfrastructureError: the file cannot be written.
        InputError: a folder of its path is a link, below one of `follow_no_links`.
    """
    data = content.encode("utf-8", "backslashreplace") if isinstance(content, str) else content
    with _replace_file(Path(path)) as temporary:
        temporary.write_bytes(data)


_without_links: set[Path] = set()
"""Folders below which nothing is written through a link."""


def follow_no_links(folder: Path) -> None:
    """Refuse from now on to write through links to folders that are below a folder: they may come with a checkout."""
    _without_links.add(Path.cwd() / os.path.normpath(folder))


def _refuse_links(path: Path) -> None:
    absolute = Path.cwd() / os.path.normpath(path)
    for folder in _without_links.intersection(absolute.parents):
        below = absolute.parents[: absolute.parents.index(folder)]
        if link := next((each for each in below if each.is_symlink()), None):
            raise InputError(
                f"{link}: found a link, expected a folder: remove it, as results are not written through links"
            )


def link_or_copy(source: Path | str, target: Path | str) -> None:
    """Hard-link ``target`` to ``source``, or copy it where links are not possible; creates missing folders.

    Replacing one of the two by renaming (as `write_atomically` does) leaves the other unchanged.

    Raises:
        InfrastructureError: the target cannot be written, or the source cannot be read.
    """
    with _replace_file(Path(target)) as temporary:
        try:
            temporary.hardlink_to(source)
        except OSError:
            shutil.copyfile(source, temporary)


@contextmanager
def writing(place: object, what: str = "") -> Iterator[None]:
    """Convert an OSError of the block to the error that something cannot be written.

    Args:
        place: file or folder, for the message.
        what: what of it is written, for the message; by default it.

    Raises:
        InfrastructureError: instead of OSError.
    """
    try:
        yield
    except OSError as error:
        reason = error.strerror or error
        raise InfrastructureError(f"{place}: {what}{' ' if what else ''}cannot be written: {reason}") from error


@contextmanager
def _replace_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside a file, which replaces the file if the block succeeds."""
    _refuse_links(path)
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
        raise InfrastructureError(f"{path}: cannot be written: {reason}") from error


def matching(patterns: Iterable[str]) -> list[str]:
    """Return the files that match paths and patterns (``results/**/*.csv``), without duplicates, sorted by pattern.

    Raises:
        InputError: a pattern matches no file, or would search the whole machine.
    """
    files: dict[str, None] = {}
    for pattern in patterns:
        if os.path.exists(pattern) or not has_magic(pattern):  # noqa: PTH110 (Path.exists may raise)
            files[pattern] = None
            continue
        parts = Path(pattern).parts
        if Path(pattern).is_absolute() and "**" in parts[1:2]:
            raise InputError(f"{pattern}: this searches the whole machine: a folder was expected before the first **")
        found = sorted(file for file in glob(pattern, recursive=True) if os.path.isfile(file))  # noqa: PTH113, PTH207
        if not found:
            folder = Path(*takewhile(lambda part: not has_magic(part), parts))
            closed = os.path.isdir(folder) and not os.access(folder, os.R_OK | os.X_OK)  # noqa: PTH112
            problem = f"the folder {folder} cannot be read" if closed else "no file matches this pattern"
            raise InputError(f"{pattern}: {problem}")
        files.update(dict.fromkeys(found))
    return list(files)


@contextmanager
def temporary_folder(
    prefix: str = "calibration-", parent: Path | str | None = None, *, ignore_cleanup_errors: bool = False
) -> Iterator[Path]:
    """Yield a new folder (mode 0700), and remove it at the end of the block.

    Unlike `tempfile.TemporaryDirectory`, a signal interrupts neither its creation nor its removal.

    Args:
        prefix: beginning of its name.
        parent: folder that it is created in; that of the system for temporary files by default.
        ignore_cleanup_errors: leave what cannot be removed, such as files of another user.

    Raises:
        OSError: it cannot be created or removed.
    """
    folder: TemporaryDirectory[str] | None = None
    try:
        with held_back():
            folder = TemporaryDirectory(prefix=prefix, dir=parent, ignore_cleanup_errors=ignore_cleanup_errors)
        yield Path(folder.name)
    finally:
        if folder is not None:
            with held_back():
                folder.cleanup()
