"""Request for a build, independent of the builder."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from calibration.ci.image.context import Context
from calibration.ci.image.secret_values import SecretValue


@dataclass(frozen=True)
class BuildRequest:
    """Parameters of a build."""

    name: str
    """Name of the image, for messages."""
    context: Context
    dockerfile: str
    """Path of the Dockerfile in the context."""
    labels: Mapping[str, str] = field(default_factory=dict)
    build_arguments: Mapping[str, str] = field(default_factory=dict)
    target: str | None = None
    platforms: Sequence[str] = ()
    secrets: Sequence[SecretValue] = ()
    ssh: bool = False
    no_cache: bool = False
