"""Folders and files put into a container that has been created and not started."""

import io
import tarfile
import tempfile
from collections.abc import Iterable
from typing import Any, cast

from docker import APIClient

from calibration.errors import InputError
from calibration.execution.job import OUTPUT, Mount

_IN_MEMORY = 16 * 1024**2


def open_output(api: APIClient, container: str) -> None:
    """Let every user of the image write to the job's volume, which belongs to root else."""
    entry = tarfile.TarInfo(OUTPUT.strip("/"))
    entry.type, entry.mode = tarfile.DIRTYPE, 0o1777
    file = io.BytesIO()
    with tarfile.open(fileobj=file, mode="w") as archive:
        archive.addfile(entry)
    api.put_archive(container, "/", file.getvalue())


def copy_in(api: APIClient, container: str, mounts: Iterable[Mount]) -> None:
    """Copy what an engine that does not see our files cannot mount.

    Raises:
        InputError: a mount is writable, so a copy would not do, or cannot be read.
    """
    mounts = tuple(mounts)
    for mount in mounts:
        if mount.writable:
            raise InputError(
                f"mount '{mount.target}': the Docker Engine does not see the files of this machine (it is another one, "
                "or this is a container); only what is read-only can be copied to it"
            )
    if not mounts:
        return
    with tempfile.SpooledTemporaryFile(max_size=_IN_MEMORY) as file:
        try:
            with tarfile.open(fileobj=file, mode="w") as archive:
                for mount in mounts:
                    archive.add(mount.source.resolve(), mount.target.strip("/"), filter=_readable)
        except OSError as error:
            raise InputError(f"mount '{mount.target}': {error.filename}: cannot be read: {error.strerror}") from None
        file.seek(0)
        api.put_archive(container, "/", cast("Any", file))


def _readable(entry: tarfile.TarInfo) -> tarfile.TarInfo:
    """For every user, and nobody's in particular."""
    entry.uid = entry.gid = 0
    entry.uname = entry.gname = ""
    entry.mode |= 0o555 if entry.isdir() or entry.mode & 0o100 else 0o444
    return entry
