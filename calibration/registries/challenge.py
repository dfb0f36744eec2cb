"""How a registry asks who one is (``WWW-Authenticate``), and the token that answers it."""

import base64
import json
import re
from dataclasses import dataclass
from urllib.parse import urlencode, urlsplit

from calibration.errors import InfrastructureError
from calibration.http import Http, is_loopback
from calibration.registries.credentials import Credentials
from calibration.workflow.text import one_line, shorten

_SCHEME = re.compile(r"(?:^|,)\s*(bearer|basic)\b", re.IGNORECASE)
_PARAMETER = re.compile(r'([a-z_]+)\s*=\s*(?:"([^"]*)"|([^\s,"]+))', re.IGNORECASE)


@dataclass(frozen=True)
class Challenge:
    """A registry's question."""

    bearer: bool
    """Whether a token answers it; else user and password themselves."""
    realm: str = ""
    """Where the token is."""
    service: str = ""
    scope: str = ""


def parse_challenge(header: str) -> Challenge | None:
    """Read the header ``WWW-Authenticate``; None where it asks for nothing that we know."""
    found = list(_SCHEME.finditer(header))
    for number, scheme in enumerate(found):
        end = found[number + 1].start() if number + 1 < len(found) else len(header)
        values = {name.lower(): a or b for name, a, b in _PARAMETER.findall(header[scheme.end() : end])}
        if scheme[1].lower() == "basic":
            return Challenge(bearer=False)
        if values.get("realm"):
            return Challenge(True, values["realm"], values.get("service", ""), values.get("scope", ""))
    return None


def basic(credentials: Credentials) -> str:
    """The header ``Authorization`` that says user and password."""
    pair = f"{credentials.username}:{credentials.password}".encode()
    return f"Basic {base64.b64encode(pair).decode('ascii')}"


def fetch_token(
    http: Http, challenge: Challenge, credentials: Credentials | None, scope: str, registry: str
) -> str | None:
    """Get a token where the registry says it is; None where that is denied.

    Args:
        http: the session.
        challenge: the registry's question.
        credentials: None for what anyone may do.
        scope: what is asked for, where the registry does not say it.
        registry: for messages.

    Raises:
        InfrastructureError: the place is not safe, cannot be reached, or answers with something else.
    """
    try:
        realm = urlsplit(challenge.realm)
    except ValueError:
        realm = urlsplit("")
    insecure = is_loopback(realm.netloc) or (credentials is not None and credentials.insecure)
    if realm.scheme != "https" and not (realm.scheme == "http" and insecure):
        shown = shorten(one_line(challenge.realm))
        raise InfrastructureError(
            f"{registry}: wants passwords sent to {shown!r}, which is not safe: https was expected"
        )
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
        raise InfrastructureError(f"{realm.netloc}: answered {answer.status} where a token for {registry} was expected")
    return token
