"""The content key: the same for two images exactly if they are made of the same."""

import hashlib
import json
from collections.abc import Mapping, Sequence

from calibration.image.context import Context

FORM = 1
"""Of what is hashed; a new form finds no image of an older one."""
TAG_DIGITS = 24
"""Hexadecimal digits of the key in a tag: 96 bits."""
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
    """Hash all that an image is made of; times, tags and the commit are no part of it.

    Args:
        context: every file of the build, by name, mode and content; the Dockerfile is one of them.
        dockerfile: its name there.
        bases: what each base is just now, a digest or an id, by its name.
        platforms: what it is built for.
        build_arguments: the values of ARG.
        target: the stage that is built; None for the last.
        labels: the user's.

    Raises:
        InfrastructureError: a file cannot be read.
    """
    parts = {
        "form": FORM,
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
    """The tag by which a registry and an engine find the image of a key."""
    return f"key-{key[:TAG_DIGITS]}"
