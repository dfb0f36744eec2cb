"""Authentication at a registry: its challenge (``WWW-Authenticate``), and the token to answer it."""

import base64
import json
import re
from dataclasses import dataclass
from urllib.parse import urlencode, urlsplit

from calibration.base.errors import InfrastructureError
from calibration.base.http import Http, is_loopback
from calibration.base.text import one_line, shorten
from calibration.ci.registries.credentials import Credentials

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
