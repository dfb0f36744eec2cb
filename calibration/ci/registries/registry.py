"""Client of a registry: its challenge (``WWW-Authenticate``), the token to answer it, manifests and blobs; and logins.

Credentials are those of the settings, of docker's configuration, or of the cloud that the registry is of.
"""

import base64
import hashlib
import json
import os
import re
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Self
from urllib.parse import urlencode, urljoin, urlsplit

from calibration.base import InfrastructureError, InputError, one_line, shorten
from calibration.base.addons import import_attribute, of_addons
from calibration.base.http import MAX_BYTES, Answer, Http, Timeouts, is_loopback
from calibration.ci.registries.reference import (
    DOCKER_HUB,
    Credentials,
    Reference,
    RegistrySettings,
    is_digest,
    is_ecr,
    parse_reference,
)
from calibration.ci.workflow import Runner, add_mask

_SCHEME_NAME = re.compile(r"(?:^|,)\s*(bearer|basic)\b", re.IGNORECASE)
_PARAMETER_TEXT = re.compile(r'([a-z_]+)\s*=\s*(?:"([^"]*)"|([^\s,"]+))', re.IGNORECASE)


@dataclass(frozen=True)
class Challenge:
    """Authentication that a registry requests."""

    bearer: bool
    """Whether it requests a bearer token; otherwise basic authentication."""
    realm: str = ""
    """URL that issues the token."""
    service: str = ""
    scope: str = ""


def parse_challenge(header: str) -> Challenge | None:
    """Parse the header ``WWW-Authenticate``; None if it names no supported scheme."""
    found = list(_SCHEME_NAME.finditer(header))
    for number, scheme in enumerate(found):
        end = found[number + 1].start() if number + 1 < len(found) else len(header)
        values = {name.lower(): a or b for name, a, b in _PARAMETER_TEXT.findall(header[scheme.end() : end])}
        if scheme[1].lower() == "basic":
            return Challenge(bearer=False)
        if values.get("realm"):
            return Challenge(True, values["realm"], values.get("service", ""), values.get("scope", ""))
    return None


def basic(credentials: Credentials) -> str:
    """Return the header ``Authorization`` for basic authentication."""
    pair = f"{credentials.username}:{credentials.password}".encode()
    return f"Basic {base64.b64encode(pair).decode('ascii')}"


def fetch_token(
    http: Http, challenge: Challenge, credentials: Credentials | None, scope: str, registry: str
) -> str | None:
    """Request a token from the registry's realm; None if it is denied.

    Args:
        http: session.
        challenge: challenge of the registry.
        credentials: None for anonymous access.
        scope: scope of the token if the challenge contains none.
        registry: name of the registry, for messages.

    Raises:
        InfrastructureError: the realm is not encrypted, cannot be reached, or gives an invalid answer.
    """
    try:
        realm = urlsplit(challenge.realm)
    except ValueError:
        realm = urlsplit("")
    insecure = is_loopback(realm.netloc) or (credentials is not None and credentials.insecure)
    if realm.scheme != "https" and not (realm.scheme == "http" and insecure):
        shown = shorten(one_line(challenge.realm))
        raise InfrastructureError(f"{registry}: wants passwords sent unencrypted to {shown!r}, expected https")
    asked = {"service": challenge.service, "scope": challenge.scope or scope}
    query = urlencode({name: value for name, value in asked.items() if value})
    url = challenge.realm + ("&" if realm.query else "?") + query
    if credentials is not None and credentials.identity_token:
        form = {"grant_type": "refresh_token", "client_id": "calibration-ci", **asked}
        body = urlencode({**form, "refresh_token": credentials.identity_token}).encode()
        headers = {"Content-Type": "application/x-www-form-urlencoded"}
        answer = http.send("POST", challenge.realm, headers, body)
    else:
        headers = {} if credentials is None else {"Authorization": basic(credentials)}
        answer = http.send("GET", url, headers)
    if answer.status in (400, 401, 403):
        return None
    try:
        document = json.loads(answer.body)
        token = document.get("token") or document.get("access_token")
    except (ValueError, AttributeError, RecursionError):
        token = None
    if answer.status != 200 or not isinstance(token, str) or not (token.isascii() and token.isprintable()):
        raise InfrastructureError(f"{realm.netloc}: answered {answer.status} instead of a token for {registry}")
    return token


MEDIA_TYPES = (
    "application/vnd.oci.image.index.v1+json",
    "application/vnd.docker.distribution.manifest.list.v2+json",
    "application/vnd.oci.image.manifest.v1+json",
    "application/vnd.docker.distribution.manifest.v2+json",
)
"""Manifests of images for one platform, and indexes of images for several platforms."""
_DENIED_STATUSES = (401, 403)


@dataclass(frozen=True)
class Manifest:
    """Manifest of an image: the list of its layers, or of its platforms."""

    digest: str
    media_type: str
    content: bytes
    """Original bytes, to which the digest applies."""


class RegistryClient:
    """Session with registries, as a context manager.

    Credentials are sent only to the registry they belong to; other requests are anonymous.
    """

    def __init__(
        self,
        credentials: Credentials | None = None,
        *,
        pause: Callable[[float], None] = time.sleep,
        timeouts: Timeouts | None = None,
        most_bytes: int = MAX_BYTES,
    ) -> None:
        """Open a session; ``pause``, ``timeouts`` and ``most_bytes`` are those of `Http`."""
        secrets = credentials.secrets if credentials else ()
        self._http = Http(
            secrets,
            address="the image's name",
            explain=_error_messages,
            pause=pause,
            timeouts=timeouts,
            most_bytes=most_bytes,
        )
        self._credentials = credentials
        self._authorizations: dict[tuple[str, str, bool], str] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._http.close()

    def find_manifest(self, reference: Reference | str) -> str | None:
        """Return the digest of an image; None if it does not exist.

        None also if the registry denies anonymous access, because it does not distinguish this from a missing image.

        Raises:
            InputError: the user has no access.
            InfrastructureError: the registry cannot be reached, or gives an invalid answer.
        """
        reference = _as_reference(reference)
        answer = self._request_with_login(
            "HEAD", reference, f"manifests/{_tag_or_digest(reference)}", {"Accept": ", ".join(MEDIA_TYPES)}
        )
        if self._is_missing(answer, reference):
            return None
        digest = answer.headers.get("Docker-Content-Digest", "").strip()
        if not is_digest(digest):  # the header is optional
            manifest = self.read_manifest(reference)
            return None if manifest is None else manifest.digest
        if reference.digest not in (None, digest):
            raise InfrastructureError(f"{reference}: the registry answers with another image, {digest}")
        return digest

    def read_manifest(self, reference: Reference | str) -> Manifest | None:
        """Return the manifest of an image; None as in :meth:`find_manifest`.

        Raises:
            InputError: the user has no access, or the manifest has an obsolete format.
            InfrastructureError: the registry cannot be reached, or the manifest does not match its digest.
        """
        reference = _as_reference(reference)
        answer = self._request_with_login(
            "GET", reference, f"manifests/{_tag_or_digest(reference)}", {"Accept": ", ".join(MEDIA_TYPES)}
        )
        if self._is_missing(answer, reference):
            return None
        media_type = answer.content_type
        if media_type not in MEDIA_TYPES:
            found = shorten(one_line(media_type)) or "nothing"
            raise InputError(f"{reference}: the registry answers with {found}, an image's manifest was expected")
        digest = f"sha256:{hashlib.sha256(answer.body).hexdigest()}"
        for other in (reference.digest, answer.headers.get("Docker-Content-Digest")):
            if other is not None and other.startswith("sha256:") and other.strip() != digest:
                raise InfrastructureError(
                    f"{reference}: the registry's answer has the digest {digest}, not {one_line(other)}"
                )
        return Manifest(reference.digest or digest, media_type, answer.body)

    def read_blob(self, reference: Reference | str, digest: str) -> bytes:
        """Return a layer of the repository of a reference.

        Raises:
            InputError: the digest is none, the user has no access, or there is no such layer.
            InfrastructureError: the registry cannot be reached, or its answer does not match the digest.
        """
        reference = _as_reference(reference).with_digest(digest)
        answer = self._request_with_login("GET", reference, f"blobs/{digest}", {})
        if self._is_missing(answer, reference):
            raise InputError(f"{reference}: the registry has no such layer")
        algorithm, _, expected = digest.partition(":")
        if hashlib.new(algorithm, answer.body).hexdigest() != expected:
            raise InfrastructureError(f"{reference}: the registry's answer has another digest")
        return answer.body

    def put_manifest(self, reference: Reference | str, manifest: Manifest) -> None:
        """Upload a manifest of the repository under the tag of the reference.

        Raises:
            InputError: access is denied, or the registry refuses the manifest.
            InfrastructureError: the registry cannot be reached, or stores another digest.
        """
        reference = _as_reference(reference)
        headers = {"Content-Type": manifest.media_type}
        answer = self._write("PUT", reference, f"manifests/{_tag_or_digest(reference)}", headers, manifest.content)
        kept = answer.headers.get("Docker-Content-Digest", manifest.digest).strip()
        if kept != manifest.digest:
            raise InfrastructureError(f"{reference}: the registry keeps {one_line(kept)}, not {manifest.digest}")

    def put_blob(self, reference: Reference | str, content: bytes) -> str:
        """Upload a layer to the repository of a reference unless it is there, and return its digest.

        Raises:
            InputError: access is denied, or the registry refuses it.
            InfrastructureError: the registry cannot be reached, or gives an invalid answer.
        """
        reference = _as_reference(reference)
        digest = f"sha256:{hashlib.sha256(content).hexdigest()}"
        if self._request_with_login("HEAD", reference, f"blobs/{digest}", {}).status == 200:
            return digest
        location = self._write("POST", reference, "blobs/uploads/", {}).headers.get("Location", "")
        if not location:
            raise InfrastructureError(f"{reference}: the registry does not say where it takes a layer")
        place = f"{location}{'&' if '?' in location else '?'}{urlencode({'digest': digest})}"
        self._write("PUT", reference, place, {"Content-Type": "application/octet-stream"}, content)
        return digest

    def _write(
        self, method: str, reference: Reference, path: str, headers: dict[str, str], body: bytes | None = None
    ) -> Answer:
        """Send a request that changes something, and return its answer of success."""
        answer = self._request_with_login(method, reference, path, headers, body)
        if answer.status in _DENIED_STATUSES:
            raise self._denied_error(answer, reference)
        if answer.status not in (200, 201, 202):
            message = f"{reference}: the registry refuses it: {answer.status}{self._http.quote(answer.body)}"
            raise InputError(message) if 400 <= answer.status < 500 else InfrastructureError(message)
        return answer

    def _request_with_login(
        self, method: str, reference: Reference, path: str, headers: dict[str, str], body: bytes | None = None
    ) -> Answer:
        """Send a request, and repeat it with credentials if the registry asks for them.

        The path is relative to the repository, or an address on the same server.
        """
        host = "registry-1.docker.io" if reference.registry == DOCKER_HUB else reference.registry
        own = self._credentials if self._credentials and self._credentials.registry == reference.registry else None
        insecure = is_loopback(host) or (own is not None and own.insecure)
        base = f"{'http' if insecure else 'https'}://{host}/v2/{reference.repository}/"
        url = urljoin(base, path)
        if urlsplit(url)[:2] != urlsplit(base)[:2]:
            named = shorten(one_line(url.partition("?")[0]), 200)
            raise InfrastructureError(f"{reference}: the registry names {named} for a layer, not itself")
        credentials = None if own is None or own.anonymous else own
        writes = method in ("PUT", "POST")
        key = (reference.registry, reference.repository, writes)
        known = self._authorizations.get(key)
        answer = self._http.send(method, url, headers | ({"Authorization": known} if known else {}), body)
        if answer.status != 401:
            return answer
        challenge = parse_challenge(answer.headers.get("WWW-Authenticate", ""))
        if challenge is None:
            return answer
        if not challenge.bearer:
            authorization = None if credentials is None else basic(credentials)
        else:
            scope = f"repository:{reference.repository}:pull{',push' if writes else ''}"
            token = fetch_token(self._http, challenge, credentials, scope, reference.registry)
            authorization = None if token is None else f"Bearer {token}"
        if authorization is None:
            return answer
        self._authorizations[key] = authorization
        return self._http.send(method, url, headers | {"Authorization": authorization}, body)

    def _is_missing(self, answer: Answer, reference: Reference) -> bool:
        """Return whether the image does not exist.

        Raises:
            InputError: the user has no access.
            InfrastructureError: the status is unexpected.
        """
        if answer.status == 200:
            return False
        if answer.status == 404:
            return True
        if answer.status in _DENIED_STATUSES:
            if self._is_nobody(reference):
                return True
            raise self._denied_error(answer, reference)
        raise InfrastructureError(f"{reference}: the registry answers {answer.status}{self._http.quote(answer.body)}")

    def _is_nobody(self, reference: Reference) -> bool:
        own = self._credentials
        return own is None or own.anonymous or own.registry != reference.registry

    def _denied_error(self, answer: Answer, reference: Reference) -> InputError:
        return denied(reference, self._credentials, f"{answer.status}{self._http.quote(answer.body)}")


def denied(reference: Reference, credentials: Credentials | None, message: str) -> InputError:
    """Return the error for denied access; ``message`` is the registry's message, without secrets."""
    if credentials is None or credentials.anonymous or credentials.registry != reference.registry:
        who = "not logged in: set registry.username and registry.password-variable, or run docker login"
    else:
        who = f"check the password of {credentials.username or 'the token'}, and what it may do to this name"
    return InputError(f"{reference}: {reference.registry} denies access ({message}); {who}")


def _error_messages(body: bytes) -> str:
    """Return the error messages in a registry's answer; empty if it has another form."""
    try:
        return "; ".join(f"{error['code']}: {error.get('message') or ''}" for error in json.loads(body)["errors"][:3])
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return ""


def _as_reference(reference: Reference | str) -> Reference:
    return parse_reference(reference) if isinstance(reference, str) else reference


def _tag_or_digest(reference: Reference) -> str:
    return reference.digest or reference.tag or "latest"


def registry_login(
    settings: RegistrySettings | None, name: str, runner: Runner, environment: Mapping[str, str] | None = None
) -> Credentials:
    """Find the credentials of an image's registry, and mask their secrets.

    Sources, in this order: user and variable in the settings; AWS, if the settings name it;
    docker's configuration (``docker login`` and credential helpers); AWS, if the registry is one of AWS's; none.
    The credentials are passed with each call, never written to a file.

    Args:
        settings: settings of the registry; None for the defaults.
        name: name of the image, with or without tag.
        runner: runner that masks the secrets.
        environment: environment variables; by default those of the process.

    Raises:
        InputError: the settings are not complete, the variable is not set, or AWS denies it.
        InfrastructureError: AWS cannot be reached, or docker's credential helper fails.
    """
    settings = settings or RegistrySettings()
    registry = parse_reference(name).registry
    credentials = _find_credentials(
        settings, name, registry, runner, os.environ if environment is None else environment
    )
    for secret in credentials.secrets:
        add_mask(runner, secret)
    return credentials


def _find_credentials(
    settings: RegistrySettings, name: str, registry: str, runner: Runner, environment: Mapping[str, str]
) -> Credentials:
    if settings.username or settings.password_variable:
        return _from_settings(settings, registry, environment)
    if settings.kind is None and (known := _from_docker(registry, settings.insecure)) is not None:
        return known
    if (kind := settings.kind or ("ecr" if is_ecr(registry) else None)) is not None:
        logins = of_addons(lambda addon: addon.registry_logins)
        if kind not in logins:
            raise InputError(
                f"{registry}: no add-on for registries of kind {kind} is installed: log in with docker login, or give "
                "username and password-variable"
            )
        found: Credentials = import_attribute(logins[kind])(name, runner, settings.create_repository, settings.insecure)
        return found
    return Credentials(registry, insecure=settings.insecure)


def _from_settings(settings: RegistrySettings, registry: str, environment: Mapping[str, str]) -> Credentials:
    variable = settings.password_variable
    if not settings.username or not variable:
        missing = "password-variable" if settings.username else "username"
        raise InputError(f"registry: {missing} is not given: username and password-variable belong together")
    password = environment.get(variable, "").strip()
    if not password:
        raise InputError(
            f"registry: the environment variable {variable} is not set or empty, "
            f"where the password of {settings.username} at {registry} was expected"
        )
    return Credentials(registry, settings.username, password, insecure=settings.insecure)


def _from_docker(registry: str, insecure: bool) -> Credentials | None:
    """Return the credentials for a registry in docker's configuration; None if it has none."""
    from docker import auth, errors  # a robot that reads a bundle from a file has no docker

    try:
        found = auth.load_config().resolve_authconfig(None if registry == DOCKER_HUB else registry)
    except errors.DockerException as error:
        raise InfrastructureError(
            f"{registry}: docker's own login cannot be read: {shorten(one_line(str(error)), 200)}"
        ) from None
    except (ValueError, TypeError, AttributeError, UnicodeError):
        raise InputError(
            f"{registry}: docker's config.json cannot be read: log in again with docker login, or mend the file"
        ) from None
    values = {name.lower(): value for name, value in (found or {}).items()}
    if values.get("identitytoken"):
        return Credentials(registry, identity_token=values["identitytoken"], insecure=insecure)
    if values.get("username") and values.get("password"):
        return Credentials(registry, values["username"], values["password"], insecure=insecure)
    return None
