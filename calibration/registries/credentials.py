"""Who one is to a registry, and how the settings say it."""

import base64
from dataclasses import dataclass, field
from typing import Annotated, Literal

from calibration.records import field as declared
from calibration.records import length, matching, needs, record

VariableName = Annotated[str, matching("[A-Za-z_][A-Za-z0-9_]*", "the name of a variable")]
_TOGETHER = "username and password-variable go together: found one of them"


@record(rules=(needs("username", "password-variable", _TOGETHER), needs("password-variable", "username", _TOGETHER)))
class RegistrySettings:
    """How to log in to a registry. A password is never in it."""

    username: Annotated[str, length(1)] | None = declared("The user.", default=None)
    password_variable: VariableName | None = declared(
        "The environment variable that holds the password or token.", default=None
    )
    kind: Literal["ecr"] | None = declared(
        "ecr: AWS gives the password; recognised by the registry's host too.", default=None
    )
    create_repository: bool = declared("Make a repository that ECR does not have.", default=False)
    insecure: bool = declared("HTTP without TLS; one on this machine does so without being told.", default=False)


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
