"""The engine's classic builder, by the engine's own interface: for machines where no ``docker`` program does BuildKit.

The engine builds by BuildKit only for a client that keeps a session open beside the request (context, secrets, SSH),
which the Docker SDK for Python does not. Programs that do are Docker's own with the plugin buildx, or of versions 18.09
to 22. A job in a container that has only the engine's socket has none, nor has one whose Docker comes without the
plugin; every engine from 18.09 on still has this builder.
"""

import re
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

import docker
import requests
import urllib3

from calibration.errors import CalibrationError, InfrastructureError
from calibration.image.builders.build_log import BuildLog
from calibration.image.builders.failure import build_problem
from calibration.image.builders.request import BuildRequest

if TYPE_CHECKING:
    from docker import DockerClient

_STEP = re.compile(r"^Step (\d+)/(\d+) : (.*)", re.DOTALL)
_LAYER_GONE = "unknown parent image ID"
"""What the engine says where a layer of its cache went in the midst, with an image that somebody else removed."""
_ATTEMPTS = 3
_CONTROL = re.compile(r"^ ---> |^Removing intermediate container|^Successfully (built|tagged) ")


class _LayerGoneError(Exception):
    """The same build may well succeed."""


def build_by_engine(client: "DockerClient", request: BuildRequest, log: BuildLog) -> str:
    """Build an image and return its id. Nothing is left of a build that fails or is stopped.

    Raises:
        BuildFailedError: a step failed, or the Dockerfile is wrong.
        InfrastructureError: the engine, its disk or the network failed.
    """
    for _ in range(_ATTEMPTS):
        with suppress(_LayerGoneError):
            return _build(client, request, log)
    raise InfrastructureError(f"image {request.name}: others remove images that this build is made of: run it again")


def _build(client: "DockerClient", request: BuildRequest, log: BuildLog) -> str:
    """Build once."""
    with tempfile.TemporaryFile() as archive, _closing_answers(client):
        request.context.write_tar(archive)
        archive.seek(0)
        image = ""
        try:
            events = client.api.build(
                fileobj=archive,
                custom_context=True,
                dockerfile=request.dockerfile,
                buildargs=dict(request.build_arguments),
                labels=dict(request.labels),
                target=request.target,
                platform=next(iter(request.platforms), None),
                nocache=request.no_cache,
                rm=True,
                forcerm=True,  # the container of a failed step too
                decode=True,
                use_config_proxy=True,
            )
            for event in events:
                image = _heed(event, request, log) or image
        except docker.errors.APIError as error:
            raise build_problem(request.name, "", str(error.explanation or error), log) from None
        except (requests.RequestException, urllib3.exceptions.HTTPError, OSError, ValueError):
            raise InfrastructureError(f"image {request.name}: the engine broke off the build") from None
    if not image:
        raise InfrastructureError(f"image {request.name}: the engine ended without an image")
    return image


@contextmanager
def _closing_answers(client: "DockerClient") -> Iterator[None]:
    """Close what the engine still sends when nobody listens any more: it then stops the build."""
    answers: list[requests.Response] = []

    def remember(answer: "requests.Response", **_: object) -> None:
        answers.append(answer)

    hooks = client.api.hooks["response"]
    hooks.append(remember)
    try:
        yield
    finally:
        hooks.remove(remember)
        for answer in answers:
            answer.close()


def _heed(event: Mapping[str, Any], request: BuildRequest, log: BuildLog) -> str | None:
    """Show an event; returns the image's id where it is the one that says so."""
    if "error" in event or "errorDetail" in event:
        raise _failure(event, request, log)
    text = str(event.get("stream", ""))
    if found := _STEP.match(text):
        log.step(int(found[1]), int(found[2]), found[3])
    elif text and not _CONTROL.match(text):
        log.output(text)
    elif event.get("status") and not event.get("progressDetail"):
        log.output(f"{event.get('id', '')} {event['status']}\n")
    aux = event.get("aux")
    return str(aux["ID"]) if isinstance(aux, Mapping) and "ID" in aux else None


def _failure(event: Mapping[str, Any], request: BuildRequest, log: BuildLog) -> CalibrationError:
    detail = event.get("errorDetail")
    detail = detail if isinstance(detail, Mapping) else {}
    code = detail.get("code")
    message = f"exit code {code}" if code else str(detail.get("message") or event.get("error"))
    if message.startswith(_LAYER_GONE):
        raise _LayerGoneError
    return build_problem(request.name, log.step_name, message, log)
