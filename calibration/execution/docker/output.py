"""What a container prints, as it comes.

The SDK reads it from the bare socket, which it then leaves open; this is the same call as plain HTTP.
"""

import struct
from collections.abc import Iterator

import docker.errors
import requests
from docker import APIClient
from requests import Response

_HEADER = struct.Struct(">BxxxL")


def attach(api: APIClient, container: str) -> Response:
    """Begin to listen: from now on nothing is missed. Whoever asks closes it.

    Raises:
        docker.errors.APIError: the engine refuses.
    """
    url = f"{api.base_url}/v{api.api_version}/containers/{container}/attach"
    asked = {"stream": 1, "stdout": 1, "stderr": 1}
    response = api.post(url, params=asked, stream=True, timeout=(api.timeout, None))  # silence may last
    try:
        response.raise_for_status()
    except requests.HTTPError as error:
        response.close()
        docker.errors.create_api_error_from_http_exception(error)
    return response


def pieces(response: Response) -> Iterator[bytes]:
    """What comes, stdout and stderr in the order of arrival, until the container has ended."""
    while len(header := response.raw.read(_HEADER.size)) == _HEADER.size:
        _, size = _HEADER.unpack(header)
        yield response.raw.read(size)
