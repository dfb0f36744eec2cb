"""Push of an image from the Docker Engine to a registry, and promotion: tags for a tested image, without pulling it."""

import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import docker.errors
import requests

from calibration.base import CalibrationError, InfrastructureError, InputError, one_line, shorten
from calibration.base.text import redact
from calibration.ci.registries.reference import Credentials, Reference, check_tag, is_digest, parse_reference
from calibration.ci.registries.registry import Manifest, RegistryClient, denied
from calibration.ci.workflow import Runner
from calibration.ci.workflow.streams import Advance

if TYPE_CHECKING:
    from docker import DockerClient


def promote(
    name: str, digest_or_key: str, tags: Sequence[str], credentials: Credentials | None, runner: Runner
) -> list[str]:
    """Add tags to an image in a registry; its digest is unchanged, also for several platforms.

    Tags that already refer to the image are skipped, so a promotion can be repeated. If another process moves
    a tag at the same time, its change is kept.

    Args:
        name: name of the image; a tag or digest in it is ignored.
        digest_or_key: the image: ``sha256:...``, or one of its tags.
        tags: tags to add.
        credentials: credentials of the registry.
        runner: runner whose log reports the changes.

    Returns:
        Names that now refer to the image: ``ghcr.io/team/robot:stable``.

    Raises:
        InputError: the image is not there, a tag is invalid, or it is denied.
        InfrastructureError: the registry cannot be reached, or fails.
    """
    image = parse_reference(name)
    source = image.with_digest(digest_or_key) if is_digest(digest_or_key) else image.with_tag(digest_or_key)
    wanted = [image.with_tag(check_tag(tag)) for tag in dict.fromkeys(tags)]
    with RegistryClient(credentials) as client:
        manifest = client.read_manifest(source)
        if manifest is None:
            hint = "push it first, and log in if it is private"
            raise InputError(f"{source}: there is no such image to promote: {hint}")
        for reference in wanted:
            runner.log(f"{reference}: {tag_image(client, reference, manifest)} {manifest.digest}")
    return [str(reference) for reference in wanted]


def tag_image(client: RegistryClient, reference: Reference, manifest: Manifest) -> str:
    """Set a tag in the repository of an image; return what was done, as words to put before the digest.

    Raises:
        InputError: that is denied.
        InfrastructureError: the registry cannot be reached, or fails.
    """
    before = client.find_manifest(reference)
    if before == manifest.digest:
        return "is already"
    client.put_manifest(reference, manifest)
    after = client.find_manifest(reference)
    if after != manifest.digest:
        return f"was moved to {after} by another process after it was"
    return "is now" if before is None else f"is no longer {before} but"


LARGE_LAYER_BYTES = 50_000_000
"""Bytes; the upload of larger layers is reported at each quarter."""
_WORDS_OF_DONE = {"Pushed": "pushed", "Layer already exists": "is there already"}


class PushProgress:
    """Converts the engine's events to progress messages."""

    def __init__(self, advance: Advance | None) -> None:
        self._advance = advance
        self._layers: dict[str, bool] = {}
        self._sizes: dict[str, int] = {}
        self._quarters: dict[str, int] = {}

    def event(self, event: Mapping[str, Any]) -> None:
        """Process an event of the engine; events of unknown form are ignored."""
        layer, status = str(event.get("id", "")), str(event.get("status", ""))
        if self._advance is None or not layer:
            return
        known = self._layers.setdefault(layer, False)
        done = next((word for start, word in _WORDS_OF_DONE.items() if status.startswith(start)), None)
        if status.startswith("Mounted from"):
            done = "is there already"
        if done is not None and not known:
            self._layers[layer] = True
            size = f" ({megabytes(self._sizes[layer])})" if layer in self._sizes else ""
            self._report_line(f"layer {layer} {done}{size}", important=False)
        elif status == "Pushing":
            self._report_upload(layer, event.get("progressDetail"))
        elif status.startswith("Retrying in 1 second"):
            self._report_line(f"layer {layer} is sent again", important=True)

    def _report_upload(self, layer: str, detail: object) -> None:
        if not isinstance(detail, Mapping):
            return
        current, total = detail.get("current"), detail.get("total")
        if not (isinstance(current, int) and isinstance(total, int) and 0 <= current <= total):
            return
        self._sizes[layer] = total
        quarter = 4 * current // total if total else 0
        if total >= LARGE_LAYER_BYTES and self._quarters.get(layer, 0) < quarter < 4:
            self._quarters[layer] = quarter
            self._report_line(f"layer {layer}: {megabytes(current)} of {megabytes(total)}", important=True)

    def _report_line(self, line: str, *, important: bool) -> None:
        if self._advance is not None:
            total = len(self._layers)
            self._advance(sum(self._layers.values()), total, shorten(one_line(line)), important=important)


def megabytes(size: int) -> str:
    """Format a size: ``12.3 MB``."""
    return f"{size / 1e6:.1f} MB"


MAX_PUSH_ATTEMPTS = 4
FIRST_PAUSE = 1.0
"""Seconds before the second attempt; doubled before each further one."""

_DENIED_MESSAGE = re.compile(
    r"denied|unauthorized|authentication required|no basic auth|incorrect username|forbidden|\b40[13]\b"
)
_UNKNOWN_NAME_MESSAGE = re.compile(
    r"name unknown|name invalid|repository .*(does not exist|not found)|repository name not known"
)
_NOT_LOCAL = re.compile(r"does not exist locally|no such image")
_HTTP_EXPECTED = re.compile(r"server gave http response to https client|x509|certificate")
_PASSING_MESSAGE = re.compile(
    r"reset|\beof\b|timeout|timed out|too ?many ?requests|refused|broken pipe|unavailable|unreachable|try again"
    r"|\b(429|5\d\d)\b|no such host|temporary failure|tls handshake|closed network connection"
)


def push_image(
    client: "DockerClient",
    reference: str,
    tags: Sequence[str],
    credentials: Credentials | None,
    advance: Advance | None = None,
    *,
    pause: Callable[[float], None] = time.sleep,
) -> str:
    """Push an image under its own tag, and give it further tags in the registry.

    Temporary failures are retried. The layers are uploaded once; further tags are set on the same manifest.

    Args:
        client: client of the engine that has the image.
        reference: name of the image with its tag: ``ghcr.io/team/robot:key-0123456789abcdef``.
        tags: further tags.
        credentials: credentials of the registry.
        advance: receives the progress of each layer.
        pause: sleeps for a number of seconds between two attempts.

    Returns:
        Digest of the image, confirmed by the registry.

    Raises:
        InputError: there is no such image or repository, or it is denied.
        InfrastructureError: the engine or the registry cannot be reached, fails, or has another image afterwards.
    """
    image = parse_reference(reference)
    wanted = [image.with_tag(tag) for tag in dict.fromkeys(tags) if tag != image.tag]
    digest = _push_with_retries(client, image, credentials, advance, pause)
    with RegistryClient(credentials, pause=pause) as registry:
        manifest = registry.read_manifest(image.with_digest(digest))
        if manifest is None or registry.find_manifest(image) != digest:
            raise InfrastructureError(f"{image}: the registry does not have the image that was pushed, {digest}")
        for other in wanted:
            tag_image(registry, other, manifest)
    return digest


def _push_with_retries(
    client: "DockerClient",
    image: Reference,
    credentials: Credentials | None,
    advance: Advance | None,
    pause: Callable[[float], None],
) -> str:
    for attempt in range(MAX_PUSH_ATTEMPTS):
        try:
            return _push_once(client, image, credentials, advance)
        except _PassingError as error:
            problem = str(error)
        if attempt + 1 < MAX_PUSH_ATTEMPTS:
            pause(FIRST_PAUSE * 2**attempt)
    raise InfrastructureError(f"{image}: the push failed: {problem} ({MAX_PUSH_ATTEMPTS} attempts)")


def _push_once(
    client: "DockerClient", image: Reference, credentials: Credentials | None, advance: Advance | None
) -> str:
    shown, digest, problem = PushProgress(advance), "", ""
    for event in _push_events(client, image, credentials):  # read to the end, to free the connection
        detail = event.get("errorDetail")
        if detail is not None or "error" in event:
            reason = (detail.get("message") if isinstance(detail, Mapping) else None) or event.get("error")
            problem = problem or str(reason or "no reason")
        shown.event(event)
        aux = event.get("aux")
        if isinstance(aux, Mapping) and is_digest(str(aux.get("Digest", ""))):
            digest = str(aux["Digest"])
    if problem:
        raise _error_of_message(problem, image, credentials)
    if not digest:
        raise _PassingError("the engine ended without a digest")
    return digest


def _push_events(
    client: "DockerClient", image: Reference, credentials: Credentials | None
) -> Iterator[Mapping[str, Any]]:
    """Yield the engine's events during the push."""
    # Passed even if empty: otherwise docker-py would search for a login itself.
    login = {} if credentials is None else credentials.auth_config()
    try:
        stream = client.api.push(image.name, image.tag, stream=True, decode=True, auth_config=login)
        for event in stream:
            if isinstance(event, Mapping):
                yield event
    except docker.errors.APIError as error:
        raise _error_of_message(str(error.explanation or error), image, credentials) from None
    except (requests.RequestException, OSError, ValueError) as error:
        raise InfrastructureError(
            f"{image}: the engine broke off the push: {shorten(one_line(str(error)), 200)}"
        ) from None


class _PassingError(Exception):
    """A temporary failure, to be retried."""


def _error_of_message(
    message: str, image: Reference, credentials: Credentials | None
) -> CalibrationError | _PassingError:
    """Return the error to raise for an error message of the engine."""
    message = shorten(one_line(redact(message, credentials.secrets if credentials else ())), 300)
    text = message.lower()
    if _NOT_LOCAL.search(text):
        return InputError(f"{image}: the engine has no such image to push")
    if _UNKNOWN_NAME_MESSAGE.search(text):
        hint = "check image.name; registry.create-repository: true creates it on ECR"
        return InputError(f"{image}: {image.registry} has no such repository ({message}): {hint}")
    if _DENIED_MESSAGE.search(text):
        return denied(image, credentials, message)
    if _HTTP_EXPECTED.search(text):
        hint = "the engine has to trust it (its certificate, or insecure-registries in daemon.json)"
        return InputError(f"{image}: {image.registry} is not trusted by the engine ({message}): {hint}")
    if _PASSING_MESSAGE.search(text):
        return _PassingError(message)
    return InfrastructureError(f"{image}: the push failed: {message}")
