"""What a builder is asked."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from calibration.image.context import Context
from calibration.image.secret_values import SecretValue


@dataclass(frozen=True)
class BuildRequest:
    """An image to build."""

    name: str
    """Of the image, for messages."""
    context: Context
    dockerfile: str
    """Its name in the context."""
    labels: Mapping[str, str] = field(default_factory=dict)
    build_arguments: Mapping[str, str] = field(default_factory=dict)
    target: str | None = None
    platforms: Sequence[str] = ()
    secrets: Sequence[SecretValue] = ()
    ssh: bool = False
    no_cache: bool = False
