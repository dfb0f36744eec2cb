"""Credentials of a registry, and the settings that refer to them."""

import base64
from dataclasses import dataclass, field
from typing import Annotated, Literal

from calibration.base.records import field as declared
from calibration.base.records import length, matching, needs, record

VariableName = Annotated[str, matching("[A-Za-z_][A-Za-z0-9_]*", "the name of a variable")]
_ONLY_ONE_GIVEN = "username and password-variable go together: found one of them"


@record(
    rules=(
        needs("username", "password-variable", _ONLY_ONE_GIVEN),
        needs("password-variable", "username", _ONLY_ONE_GIVEN),
    )
)
class RegistrySettings:
    """Login to a registry: the user, and the variable with the password, which is never in the settings."""

    username: Annotated[str, length(1)] | None = declared("The user.", default=None)
    password_variable: VariableName | None = declared(
        "Environment variable that contains the password or token.", default=None
    )
    kind: Literal["ecr"] | None = declared(
        "ecr: the password comes from AWS; the default for hosts of AWS's registries.", default=None
    )
    create_repository: bool = declared("Create a missing repository on ECR.", default=False)
    insecure: bool = declared("HTTP without TLS; the default for a registry on this machine.", default=False)


@dataclass(frozen=True)
class Credentials:
    """User and password, or a token, valid for one registry only."""

    registry: str
    username: str = ""
    password: str = field(default="", repr=False)
    identity_token: str = field(default="", repr=False)
    """Token instead of a password, if a credential helper provides one."""
    insecure: bool = False
    """Whether HTTP is used without TLS."""

    @property
    def secrets(self) -> tuple[str, ...]:
        """Strings to redact in messages, including the base64 form of a header."""
        pair = base64.b64encode(f"{self.username}:{self.password}".encode()).decode("ascii") if self.password else ""
        return tuple(filter(None, (self.password, self.identity_token, pair)))

    @property
    def anonymous(self) -> bool:
        """Whether there is no login, only the registry's address."""
        return not self.secrets

    def auth_config(self) -> dict[str, str]:
        """Return the login for docker-py, which is passed with each call, so that it is not written to a file."""
        if self.identity_token:
            return {"identitytoken": self.identity_token, "serveraddress": self.registry}
        if self.anonymous:
            return {}
        return {"username": self.username, "password": self.password, "serveraddress": self.registry}
