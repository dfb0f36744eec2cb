"""Images of containers, found on the engine or pulled before anything is started."""

from collections.abc import Iterable

import docker.errors
from docker import APIClient
from docker.utils import parse_repository_tag

from calibration.base.errors import InfrastructureError, InputError
from calibration.base.text import one_line, shorten
from calibration.ci.docker.engine import engine_errors, engine_message

_NOT_THERE = (
    "not found",
    "manifest unknown",
    "name unknown",
    "does not exist",
    "denied",
    "unauthorized",
    "no basic auth",
    "invalid reference",
    "invalid repository name",
    "no matching manifest",
)
"""Parts of registries' messages if an image does not exist, or access is denied."""


def find_images(api: APIClient, images: Iterable[str]) -> dict[str, str]:
    """Find images on the engine, or pull them.

    Returns:
        Id of each image, so that a tag moved meanwhile has no effect.

    Raises:
        InputError: an image does not exist, or access is denied.
        InfrastructureError: the engine or the registry cannot be reached.
    """
    return {image: _find_image(api, image) or _pull_image(api, image) for image in dict.fromkeys(images)}


def _find_image(api: APIClient, image: str) -> str | None:
    with engine_errors(f"image '{image}'"):
        try:
            return str(api.inspect_image(image)["Id"])  # type: ignore[no-untyped-call]
        except docker.errors.NotFound:
            return None


def _pull_image(api: APIClient, image: str) -> str:
    repository, tag = parse_repository_tag(image)
    with engine_errors(f"image '{image}'"):
        try:
            for event in api.pull(repository, tag=tag or "latest", stream=True, decode=True):
                if "error" in event:
                    raise _not_pulled(image, str(event["error"]))
        except docker.errors.APIError as error:
            raise _not_pulled(image, engine_message(error)) from None
    found = _find_image(api, image)
    if found is None:
        raise InfrastructureError(f"image '{image}': was pulled, but the engine does not have it")
    return found


def _not_pulled(image: str, message: str) -> InputError | InfrastructureError:
    message = shorten(one_line(message), 300)
    if any(sentence in message.lower() for sentence in _NOT_THERE):
        return InputError(
            f"image '{image}' is not on the engine, and cannot be pulled: {message}; "
            "build it, log in to its registry, or correct its name"
        )
    return InfrastructureError(f"image '{image}' is not on the engine, and its registry cannot be reached: {message}")
