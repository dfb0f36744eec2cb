"""Content key: a hash of all input of a build, equal exactly for images with the same content; labels of its origin."""

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from urllib.parse import urlsplit, urlunsplit

from calibration.base.errors import CalibrationError
from calibration.ci.git import Repository
from calibration.ci.image.context import Context
from calibration.ci.services import service_of

KEY_VERSION = 1
"""Version of the hashed format; images of older versions are not found."""
TAG_DIGITS = 24
"""Number of hexadecimal digits of the key in a tag: 96 bits."""
KEY_LABEL = "ci.calibration.key"
SPECIFICATION_LABEL = "ci.calibration.specification"


def content_key(
    context: Context,
    dockerfile: str,
    bases: Mapping[str, str],
    platforms: Sequence[str],
    build_arguments: Mapping[str, str],
    target: str | None,
    labels: Mapping[str, str],
    *,
    attested: bool = False,
) -> str:
    """Return the hash of all input of an image, without times, tags and the commit.

    Args:
        context: files of the build, hashed by path, mode and content, including the Dockerfile.
        dockerfile: path of the Dockerfile in the context.
        bases: current digest or id of each base, by name.
        platforms: platforms to build for.
        build_arguments: values of ARG.
        target: stage to build; None for the last one.
        labels: labels of the user.
        attested: whether it is attested: one that is not is another image.

    Raises:
        InfrastructureError: a file cannot be read.
    """
    parts = {
        "form": KEY_VERSION,
        "dockerfile": dockerfile,
        "bases": dict(bases),
        "platforms": list(platforms),
        "arguments": dict(build_arguments),
        "target": target,
        "labels": dict(labels),
        "files": list(context.digests()),
        **({"attested": True} if attested else {}),
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def key_tag(key: str) -> str:
    """Return the tag that identifies the image of a key."""
    return f"key-{key[:TAG_DIGITS]}"


SOURCE_LABEL = "org.opencontainers.image.source"
REVISION_LABEL = "org.opencontainers.image.revision"


def build_labels(
    key: str, specification: str, user: Mapping[str, str], folder: Path, environment: Mapping[str, str] | None = None
) -> dict[str, str]:
    """Return the labels of an image that is built now: the user's, the keys, and the commit if it is known.

    An image that is found later, unchanged, keeps the commit of its build. There is no date, because
    images have a date of creation.
    """
    variables = os.environ if environment is None else environment
    source, revision = service_of(variables).origin(variables)
    if not (source and revision):
        with suppress(CalibrationError):  # no git, or no checkout
            checkout = Repository.around(folder)
            source = source or checkout.origin() or ""
            revision = revision or checkout.head() or ""
    found = {SOURCE_LABEL: _without_login(source), REVISION_LABEL: revision}
    ours = {KEY_LABEL: key, SPECIFICATION_LABEL: specification}
    return {name: value for name, value in found.items() if value} | dict(user) | ours


def _without_login(url: str) -> str:
    """Remove user and password from a URL."""
    try:
        parts = urlsplit(url)
        if "@" not in parts.netloc:
            return url
        return urlunsplit(parts._replace(netloc=parts.netloc.rpartition("@")[2]))
    except ValueError:
        return ""
