"""Who one is to a registry, and how the settings say it."""

import base64
from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True)
class RegistrySettings:
    """The key ``registry`` of an image specification: how to log in. A password is never in it."""

    username: str | None = None
    password_variable: str | None = None
    """The environment variable that holds the password or token."""
    kind: Literal["ecr"] | None = None
    """AWS's registry, where boto3 gets the password; recognised by its host too."""
    create_repository: bool = False
    """Whether a repository that ECR does not have is made."""
    insecure: bool = False
    """Whether the registry speaks HTTP without TLS; one on this machine does without being told."""


@dataclass(frozen=True)
class Credentials:
    """A user and a password, or a token, for one registry and no other."""

    registry: str
    username: str = ""
    password: str = field(default="", repr=False)
    identity_token: str = field(default="", repr=False)
    """In the place of a password, where a credential helper has one."""
    insecure: bool = False
    """As in the settings: HTTP without TLS."""

    @property
    def secrets(self) -> tuple[str, ...]:
        """What must be in no message: also the two as a header has them."""
        pair = base64.b64encode(f"{self.username}:{self.password}".encode()).decode("ascii") if self.password else ""
        return tuple(filter(None, (self.password, self.identity_token, pair)))

    @property
    def anonymous(self) -> bool:
        """Whether there is no login: only the registry's address."""
        return not self.secrets

    def auth_config(self) -> dict[str, str]:
        """As docker-py takes it, call by call, so that no login is written to a file."""
        if self.identity_token:
            return {"identitytoken": self.identity_token, "serveraddress": self.registry}
        if self.anonymous:
            return {}
        return {"username": self.username, "password": self.password, "serveraddress": self.registry}
