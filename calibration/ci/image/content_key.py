"""Content key: a hash of all input of a build, equal exactly for images with the same content."""

import hashlib
import json
from collections.abc import Mapping, Sequence

from calibration.ci.image.context import Context

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
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def key_tag(key: str) -> str:
    """Return the tag that identifies the image of a key."""
    return f"key-{key[:TAG_DIGITS]}"
