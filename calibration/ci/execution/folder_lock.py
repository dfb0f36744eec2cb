"""Lock of an output folder: one run at a time uses it."""

import errno
import fcntl
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from calibration.base.errors import InfrastructureError, InputError

_NO_LOCKS = (errno.EBADF, errno.EINVAL, errno.ENOLCK, errno.ENOTSUP)
"""What file systems say that cannot lock a folder, such as NFS; there nothing is locked."""


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a folder during the block; the lock is gone too when this process was killed.

    The folder and those above are created where they are missing, and removed again if they stay empty.

    Raises:
        InputError: another run uses this folder.
        InfrastructureError: the folder cannot be created or read.
    """
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        descriptor = _locked_descriptor(folder)
    except BaseException:
        _remove_empty(made)
        raise
    try:
        yield
    finally:
        _remove_empty(made)  # under the lock: else another run may have locked the folder that is removed
        os.close(descriptor)


def _remove_empty(folders: Sequence[Path]) -> None:
    for path in folders:
        with suppress(OSError):  # not empty, or not created
            path.rmdir()


def _locked_descriptor(folder: Path) -> int:
    """Return an open descriptor of a folder, which is locked until it is closed."""
    while True:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        except (FileExistsError, NotADirectoryError):
            raise InfrastructureError(f"{folder}: cannot be written: it, or a folder above it, is a file") from None
        except FileNotFoundError:
            continue  # another run has just removed it
        except OSError as error:
            raise InfrastructureError(f"{folder}: cannot be written: {error.strerror}") from error
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(descriptor)
            raise InputError(f"{folder}: another run uses this folder; wait for it, or stop it") from None
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                os.close(descriptor)
                raise InfrastructureError(f"{folder}: cannot be locked: {error.strerror}") from error
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(descriptor), folder.stat()):
                return descriptor
        os.close(descriptor)  # another run removed it before it was locked
