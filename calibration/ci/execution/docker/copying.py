"""Copying of files into containers before their start, and out of containers, without tools in the image.

The SDK's own functions cannot stop early, and have no time-out for an engine that does not answer.
"""

import base64
import io
import json
import tarfile
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, cast

import docker.errors
import requests
from docker import APIClient

from calibration.base import InputError
from calibration.ci.docker_engine import engine_errors
from calibration.ci.execution.artifacts import Archive, NothingThereError, Opener
from calibration.ci.execution.job import OUTPUT, Mount

_CHUNK_BYTES = 1024**2
# The engine tells only here, as JSON in base64, that the path is a link: the archive then has the link, not its target.
_STAT_HEADER = "X-Docker-Container-Path-Stat"
_IN_MEMORY = 16 * 1024**2


def open_output(api: APIClient, container: str) -> None:
    """Make the job's volume writable for all users of the image; by default it belongs to root."""
    entry = tarfile.TarInfo(OUTPUT.strip("/"))
    entry.type, entry.mode = tarfile.DIRTYPE, 0o1777
    file = io.BytesIO()
    with tarfile.open(fileobj=file, mode="w") as archive:
        archive.addfile(entry)
    api.put_archive(container, "/", file.getvalue())


def copy_in(api: APIClient, container: str, mounts: Iterable[Mount]) -> None:
    """Copy mounts into a container, for an engine that cannot access our file system.

    Raises:
        InputError: a mount is writable, which a copy does not support, or cannot be read.
    """
    mounts = tuple(mounts)
    for mount in mounts:
        if mount.writable:
            raise InputError(
                f"mount '{mount.target}': the Docker Engine cannot access the files of this machine (it runs on "
                "another one, or this is a container); only read-only mounts can be copied to it"
            )
    if not mounts:
        return
    with tempfile.SpooledTemporaryFile(max_size=_IN_MEMORY) as file:
        try:
            with tarfile.open(fileobj=file, mode="w") as archive:
                for mount in mounts:
                    archive.add(mount.source.resolve(), mount.target.strip("/"), filter=_as_readable)
        except OSError as error:
            raise InputError(f"mount '{mount.target}': {error.filename}: cannot be read: {error.strerror}") from None
        file.seek(0)
        api.put_archive(container, "/", cast("Any", file))


def _as_readable(entry: tarfile.TarInfo) -> tarfile.TarInfo:
    """Make a tar entry readable for all users, without an owner."""
    entry.uid = entry.gid = 0
    entry.uname = entry.gname = ""
    entry.mode |= 0o555 if entry.isdir() or entry.mode & 0o100 else 0o444
    return entry


@contextmanager
def open_archive(api: APIClient, container: str, path: str) -> Iterator[Archive]:
    """Open a file or folder as a tar stream.

    Raises:
        docker.errors.NotFound: it does not exist.
        docker.errors.APIError: the engine refuses the request.
    """
    headers = {"Accept-Encoding": "identity"}
    response = api.get(
        _archive_url(api, container), params={"path": path}, headers=headers, stream=True, timeout=api.timeout
    )
    try:
        try:
            response.raise_for_status()
        except requests.HTTPError as error:
            docker.errors.create_api_error_from_http_exception(error)
        facts = json.loads(base64.b64decode(response.headers.get(_STAT_HEADER, "e30=")))
        yield Archive(response.iter_content(_CHUNK_BYTES), str(facts.get("linkTarget") or ""))
    finally:
        response.close()


def opener_of(api: APIClient, container: str, name: str) -> Opener:
    """Return an opener for the files of a container, whose name is used in messages."""

    @contextmanager
    def opened(path: str) -> Iterator[Archive]:
        with engine_errors(f"container '{name}', artifact '{path}'"):  # the engine's errors are OSErrors too
            try:
                with open_archive(api, container, path) as archive:
                    yield archive
            except docker.errors.NotFound:
                raise NothingThereError from None

    return opened


def exists(api: APIClient, container: str, path: str) -> bool:
    """Return whether a file or folder exists."""
    with api.head(_archive_url(api, container), params={"path": path}, timeout=api.timeout) as response:
        return response.ok


def _archive_url(api: APIClient, container: str) -> str:
    return f"{api.base_url}/v{api.api_version}/containers/{container}/archive"
