"""Image names: ``host:port/name:tag@digest``, and the short forms of Docker Hub; credentials of registries."""

import base64
import re
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

from calibration.base import InputError, shorten
from calibration.base.records import field as declared
from calibration.base.records import length, matching, needs, record

DOCKER_HUB = "docker.io"
"""Registry of names without one."""
MAX_LENGTH = 255
"""Maximum length of registry and repository together, as in the Docker Engine."""

_PATH_PART = r"[a-z0-9]+(?:(?:\.|__?|-+)[a-z0-9]+)*"
_REPOSITORY_PATH = re.compile(rf"{_PATH_PART}(?:/{_PATH_PART})*")
_HOST_LABEL = r"[A-Za-z0-9](?:[A-Za-z0-9-]*[A-Za-z0-9])?"
_REGISTRY_HOST = re.compile(rf"(?:{_HOST_LABEL}(?:\.{_HOST_LABEL})*|\[[0-9A-Fa-f:.]+\])(?::[0-9]{{1,5}})?")
_TAG_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,127}")
_DIGEST_TEXT = re.compile(r"sha256:[0-9a-f]{64}|sha512:[0-9a-f]{128}")


@dataclass(frozen=True)
class Reference:
    """Name of an image: registry, repository, tag and digest."""

    registry: str
    """``docker.io``, ``ghcr.io``, ``127.0.0.1:5000``."""
    repository: str
    """``library/debian``, ``team/robot``."""
    tag: str | None = None
    digest: str | None = None
    """``sha256:...``; takes precedence over the tag."""

    @property
    def name(self) -> str:
        """Name without tag and digest, in the engine's form: ``debian``, ``ghcr.io/team/robot``."""
        if self.registry != DOCKER_HUB:
            return f"{self.registry}/{self.repository}"
        return self.repository.removeprefix("library/")

    def with_tag(self, tag: str) -> "Reference":
        """Return a reference to the same repository with a tag.

        Raises:
            InputError: the tag is invalid.
        """
        return replace(self, tag=check_tag(tag), digest=None)

    def with_digest(self, digest: str) -> "Reference":
        """Return a reference to the same repository with a digest.

        Raises:
            InputError: the digest is invalid.
        """
        if not is_digest(digest):
            raise InputError(f"found {shorten(digest)!r}, a digest such as sha256:<64 hexadecimal digits> was expected")
        return replace(self, tag=None, digest=digest)

    def __str__(self) -> str:
        tag = f":{self.tag}" if self.tag else ""
        return f"{self.name}{tag}{f'@{self.digest}' if self.digest else ''}"


def parse_reference(text: str) -> Reference:
    """Parse an image name; the part before the first slash is a registry if it looks like a host.

    Raises:
        InputError: the name is invalid; the message names the wrong part.
    """
    rest, at, digest = text.partition("@")
    if at and not _DIGEST_TEXT.fullmatch(digest):
        raise InputError(
            f"image {shorten(text)!r}: {shorten(digest)!r} is no digest (sha256: and 64 hexadecimal digits)"
        )
    host, slash, path = rest.partition("/")
    if not (slash and _looks_like_a_host(host)):
        host, path = DOCKER_HUB, rest
    path, colon, tag = path.partition(":")
    if host in ("index.docker.io", "registry-1.docker.io"):
        host = DOCKER_HUB
    if host == DOCKER_HUB and "/" not in path:
        path = f"library/{path}"
    if not _REGISTRY_HOST.fullmatch(host):
        raise InputError(f"image {shorten(text)!r}: {shorten(host)!r} is no registry (a host, and a port where needed)")
    if not _REPOSITORY_PATH.fullmatch(path):
        expected = "lower-case letters, digits, and single . _ - between them"
        raise InputError(f"image {shorten(text)!r}: {shorten(path)!r} is no repository ({expected})")
    if len(host) + 1 + len(path) > MAX_LENGTH:
        raise InputError(f"image {shorten(text)!r}: the name has more than {MAX_LENGTH} characters")
    return Reference(host, path, check_tag(tag) if colon else None, digest or None)


def check_tag(tag: str) -> str:
    """Return a tag if it is valid.

    Raises:
        InputError: the tag is invalid.
    """
    if not _TAG_NAME.fullmatch(tag):
        expected = "1 to 128 letters, digits, _ . -, the first no . or -"
        raise InputError(f"found the tag {shorten(tag)!r}, expected {expected}")
    return tag


def is_digest(text: str) -> bool:
    """Whether a text is a digest: ``sha256:`` and 64 hexadecimal digits, or the same of sha512."""
    return _DIGEST_TEXT.fullmatch(text) is not None


def _looks_like_a_host(text: str) -> bool:
    return "." in text or ":" in text or text == "localhost" or text != text.lower()


ECR_PUBLIC = "public.ecr.aws"
_ECR_HOST = re.compile(
    r"(?P<account>[0-9]{12})\.dkr[.-]ecr(?P<fips>-fips)?\.(?P<region>[a-z]{2}(?:-[a-z]+)+-[0-9])"
    r"\.(?:amazonaws\.com(?:\.cn)?|on\.aws|on\.amazonwebservices\.com\.cn)"
)


@dataclass(frozen=True)
class EcrHost:
    """Account and region in the host name of a private registry of AWS."""

    account: str
    region: str


def ecr_host(registry: str) -> EcrHost | None:
    """Parse ``<account>.dkr.ecr.<region>.amazonaws.com``, also of China, FIPS and dual stack; None for other hosts."""
    found = _ECR_HOST.fullmatch(registry)
    return None if found is None else EcrHost(found["account"], found["region"])


def is_ecr(registry: str) -> bool:
    """Whether a registry is AWS's ECR, private or public."""
    return registry == ECR_PUBLIC or ecr_host(registry) is not None


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
