"""Classic builder through the engine's API: for machines without a ``docker`` command that supports BuildKit.

The engine uses BuildKit only for clients that keep a session open beside the request (context, secrets, SSH),
which the Docker SDK for Python does not support (docker-py issue 2230). The ``docker`` command does with its plugin
buildx, or without it in versions 18.09 to 22. It is missing in a job container with nothing but the engine's socket,
and the plugin is missing in some installations; every engine since 18.09 has this builder.
"""

import re
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

import docker
import requests
import urllib3

from calibration.base import CalibrationError, InfrastructureError
from calibration.ci.image.build_request import BuildLog, BuildRequest, build_problem

if TYPE_CHECKING:
    from docker import DockerClient


_STEP_LINE = re.compile(r"^Step (\d+)/(\d+) : (.*)", re.DOTALL)
_LAYER_GONE = "unknown parent image ID"
"""The engine's message if another process has removed a cached layer during the build."""
_MAX_ATTEMPTS = 3
_ENGINE_LINE = re.compile(r"^ ---> |^Removing intermediate container|^Successfully (built|tagged) ")


class _LayerGoneError(Exception):
    """A cached layer was removed: a retry may succeed."""


def build_by_engine(client: "DockerClient", request: BuildRequest, log: BuildLog) -> str:
    """Build an image and return its id; a failed or stopped build leaves nothing behind.

    Raises:
        BuildFailedError: a step failed, or the Dockerfile is wrong.
        InfrastructureError: the engine, its disk or the network failed.
    """
    for _ in range(_MAX_ATTEMPTS):
        with suppress(_LayerGoneError):
            return _build_once(client, request, log)
    raise InfrastructureError(
        f"image {request.name}: layers of this build were removed by another process: run it again"
    )


def _build_once(client: "DockerClient", request: BuildRequest, log: BuildLog) -> str:
    """Build once; see `build_by_engine`."""
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
                forcerm=True,  # also remove the container of a failed step
                decode=True,
                use_config_proxy=True,
            )
            for event in events:
                image = _show_event(event, request, log) or image
        except docker.errors.APIError as error:
            raise build_problem(request.name, "", str(error.explanation or error), log) from None
        except (requests.RequestException, urllib3.exceptions.HTTPError, OSError, ValueError):
            raise InfrastructureError(f"image {request.name}: the engine broke off the build") from None
    if not image:
        raise InfrastructureError(f"image {request.name}: the engine ended without an image")
    return image


@contextmanager
def _closing_answers(client: "DockerClient") -> Iterator[None]:
    """Close the engine's responses at the end of the block, which stops a running build."""
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


def _show_event(event: Mapping[str, Any], request: BuildRequest, log: BuildLog) -> str | None:
    """Show an event; return the image's id if the event contains it."""
    if "error" in event or "errorDetail" in event:
        raise _error_of_event(event, request, log)
    text = str(event.get("stream", ""))
    if found := _STEP_LINE.match(text):
        log.step(int(found[1]), int(found[2]), found[3])
    elif text and not _ENGINE_LINE.match(text):
        log.output(text)
    elif event.get("status") and not event.get("progressDetail"):
        log.output(f"{event.get('id', '')} {event['status']}\n")
    aux = event.get("aux")
    return str(aux["ID"]) if isinstance(aux, Mapping) and "ID" in aux else None


def _error_of_event(event: Mapping[str, Any], request: BuildRequest, log: BuildLog) -> CalibrationError:
    detail = event.get("errorDetail")
    detail = detail if isinstance(detail, Mapping) else {}
    code = detail.get("code")
    message = f"exit code {code}" if code else str(detail.get("message") or event.get("error"))
    if message.startswith(_LAYER_GONE):
        raise _LayerGoneError
    return build_problem(request.name, log.step_name, message, log)
