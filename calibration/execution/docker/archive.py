"""Files of a container, as the engine hands them out: also of one that has ended, and without any tool in it.

The SDK can do it too, but can neither end early nor give up on an engine that says nothing any more.
"""

import base64
import json
from collections.abc import Iterator
from contextlib import contextmanager

import docker.errors
import requests
from docker import APIClient

from calibration.docker.engine import engine_errors
from calibration.execution.bringing_out import Archive, NothingThereError, Opener

_CHUNK = 1024**2
_FACTS = "X-Docker-Container-Path-Stat"


@contextmanager
def open_archive(api: APIClient, container: str, path: str) -> Iterator[Archive]:
    """Read a file or folder.

    Raises:
        docker.errors.NotFound: there is none.
        docker.errors.APIError: the engine refuses.
    """
    headers = {"Accept-Encoding": "identity"}
    response = api.get(
        _address(api, container), params={"path": path}, headers=headers, stream=True, timeout=api.timeout
    )
    try:
        try:
            response.raise_for_status()
        except requests.HTTPError as error:
            docker.errors.create_api_error_from_http_exception(error)
        facts = json.loads(base64.b64decode(response.headers.get(_FACTS, "e30=")))
        yield Archive(response.iter_content(_CHUNK), str(facts.get("linkTarget") or ""))
    finally:
        response.close()


def opener_of(api: APIClient, container: str, name: str) -> Opener:
    """What opens the files of a container, whose name is for messages."""

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
    """Whether there is a file or folder."""
    with api.head(_address(api, container), params={"path": path}, timeout=api.timeout) as response:
        return response.ok


def _address(api: APIClient, container: str) -> str:
    return f"{api.base_url}/v{api.api_version}/containers/{container}/archive"
