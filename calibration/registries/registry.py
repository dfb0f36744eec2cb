"""Client of a registry (OCI distribution): which manifest a name stands for, and other tags for it.

Why it is our own. oras-py 0.2.43 returns a manifest parsed, so that its bytes, of which the digest is, are lost; it
compares no digest, reads any number of bytes, has no time limit, does not repeat after 429 or 503, and sends the
password to whatever realm the registry names. ``docker buildx imagetools`` does not come with every Docker Engine that
we support, has no structured errors, and takes passwords from a file alone.
"""

import hashlib
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self
from urllib.parse import quote

from calibration.errors import InfrastructureError, InputError
from calibration.http import Answer, Http, Limits, is_loopback
from calibration.registries.challenge import basic, fetch_token, parse_challenge
from calibration.registries.credentials import Credentials
from calibration.registries.reference import DOCKER_HUB, Reference, is_digest, parse_reference
from calibration.workflow.text import one_line, shorten

MEDIA_TYPES = (
    "application/vnd.oci.image.index.v1+json",
    "application/vnd.docker.distribution.manifest.list.v2+json",
    "application/vnd.oci.image.manifest.v1+json",
    "application/vnd.docker.distribution.manifest.v2+json",
)
"""Manifests of one image, and of the images for several platforms."""
MAX_TAGS = 10_000
_DENIED = (401, 403)


@dataclass(frozen=True)
class Manifest:
    """What a registry keeps of an image: the list of its parts."""

    digest: str
    media_type: str
    content: bytes
    """Byte for byte: the digest is of these."""


class RegistryClient:
    """A session with registries; a context manager.

    Whoever asks says who he is to the one registry that his credentials are for; to every other he is nobody.
    """

    def __init__(
        self,
        credentials: Credentials | None = None,
        *,
        pause: Callable[[float], None] = time.sleep,
        limits: Limits | None = None,
    ) -> None:
        """Open a session; ``pause`` and ``limits`` are those of `Http`."""
        secrets = credentials.secrets if credentials else ()
        self._http = Http(secrets, address="the image's name", explain=_errors, pause=pause, limits=limits)
        self._credentials = credentials
        self._authorizations: dict[tuple[str, str, bool], str] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._http.close()

    def find_manifest(self, reference: Reference | str) -> str | None:
        """The digest of an image; None where there is none of that name.

        None too where nobody is logged in and the registry denies it: it does not tell the one from the other.

        Raises:
            InputError: whoever is logged in may not see it.
            InfrastructureError: the registry cannot be reached, or answers with something else.
        """
        reference = _parsed(reference)
        answer = self._request(
            "HEAD", reference, f"manifests/{_version(reference)}", {"Accept": ", ".join(MEDIA_TYPES)}
        )
        if self._is_missing(answer, reference):
            return None
        digest = answer.headers.get("Docker-Content-Digest", "").strip()
        if not is_digest(digest):  # a registry need not say it
            manifest = self.read_manifest(reference)
            return None if manifest is None else manifest.digest
        if reference.digest not in (None, digest):
            raise InfrastructureError(f"{reference}: the registry answers with another image, {digest}")
        return digest

    def read_manifest(self, reference: Reference | str) -> Manifest | None:
        """The manifest of an image; None as :meth:`find_manifest` has it.

        Raises:
            InputError: whoever is logged in may not see it, or it is of a kind that is no longer used.
            InfrastructureError: the registry cannot be reached, or what it sends is not what its digest says.
        """
        reference = _parsed(reference)
        answer = self._request("GET", reference, f"manifests/{_version(reference)}", {"Accept": ", ".join(MEDIA_TYPES)})
        if self._is_missing(answer, reference):
            return None
        media_type = answer.content_type
        if media_type not in MEDIA_TYPES:
            found = shorten(one_line(media_type)) or "nothing"
            raise InputError(f"{reference}: the registry answers with {found}, an image's manifest was expected")
        digest = f"sha256:{hashlib.sha256(answer.body).hexdigest()}"
        said = [reference.digest, answer.headers.get("Docker-Content-Digest")]
        for other in said:
            if other is not None and other.startswith("sha256:") and other.strip() != digest:
                raise InfrastructureError(
                    f"{reference}: what the registry sends has the digest {digest}, not {one_line(other)}"
                )
        return Manifest(reference.digest or digest, media_type, answer.body)

    def put_manifest(self, reference: Reference | str, manifest: Manifest) -> None:
        """Give an image that the repository has the tag of the reference.

        Raises:
            InputError: that is denied, or the registry does not take it.
            InfrastructureError: the registry cannot be reached, or keeps something else.
        """
        reference = _parsed(reference)
        headers = {"Content-Type": manifest.media_type}
        answer = self._request("PUT", reference, f"manifests/{_version(reference)}", headers, manifest.content)
        if answer.status in _DENIED:
            raise self._denied(answer, reference)
        if answer.status not in (200, 201):
            message = f"{reference}: the registry does not take it: {answer.status}{self._http.quote(answer.body)}"
            raise InputError(message) if 400 <= answer.status < 500 else InfrastructureError(message)
        kept = answer.headers.get("Docker-Content-Digest", manifest.digest).strip()
        if kept != manifest.digest:
            raise InfrastructureError(f"{reference}: the registry keeps {one_line(kept)}, not {manifest.digest}")

    def tags(self, reference: Reference | str) -> list[str]:
        """The tags of a repository, in the registry's order; none where there is no repository.

        Raises:
            InputError: whoever is logged in may not see it, or there are more than :data:`MAX_TAGS`.
            InfrastructureError: the registry cannot be reached, or answers with something else.
        """
        reference = replace(_parsed(reference), tag=None, digest=None)
        found: list[str] = []
        while len(found) <= MAX_TAGS:
            last = f"&last={quote(found[-1], safe='')}" if found else ""
            answer = self._request("GET", reference, f"tags/list?n=1000{last}", {"Accept": "application/json"})
            if self._is_missing(answer, reference):
                return found
            try:
                page = json.loads(answer.body)["tags"] or []
            except (ValueError, TypeError, KeyError, RecursionError):
                page = None
            if not isinstance(page, list) or not all(isinstance(tag, str) for tag in page):
                raise InfrastructureError(f"{reference}: the registry answers with something else than a list of tags")
            found += page
            if not page or 'rel="next"' not in answer.headers.get("Link", ""):
                return found
        raise InputError(f"{reference}: there are more than {MAX_TAGS} tags")

    def _request(
        self, method: str, reference: Reference, path: str, headers: dict[str, str], body: bytes | None = None
    ) -> Answer:
        """Send a request, and answer the registry's question who one is."""
        host = "registry-1.docker.io" if reference.registry == DOCKER_HUB else reference.registry
        own = self._credentials if self._credentials and self._credentials.registry == reference.registry else None
        insecure = is_loopback(host) or (own is not None and own.insecure)
        url = f"{'http' if insecure else 'https'}://{host}/v2/{reference.repository}/{path}"
        credentials = None if own is None or own.anonymous else own
        key = (reference.registry, reference.repository, method == "PUT")
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
            scope = f"repository:{reference.repository}:pull{',push' if method == 'PUT' else ''}"
            token = fetch_token(self._http, challenge, credentials, scope, reference.registry)
            authorization = None if token is None else f"Bearer {token}"
        if authorization is None:
            return answer
        self._authorizations[key] = authorization
        return self._http.send(method, url, headers | {"Authorization": authorization}, body)

    def _is_missing(self, answer: Answer, reference: Reference) -> bool:
        """Whether there is no such image.

        Raises:
            InputError: it is denied to whoever is logged in.
            InfrastructureError: the answer says neither.
        """
        if answer.status == 200:
            return False
        if answer.status == 404:
            return True
        if answer.status in _DENIED:
            if self._is_nobody(reference):
                return True
            raise self._denied(answer, reference)
        raise InfrastructureError(f"{reference}: the registry answers {answer.status}{self._http.quote(answer.body)}")

    def _is_nobody(self, reference: Reference) -> bool:
        own = self._credentials
        return own is None or own.anonymous or own.registry != reference.registry

    def _denied(self, answer: Answer, reference: Reference) -> InputError:
        return denied(reference, self._credentials, f"{answer.status}{self._http.quote(answer.body)}")


def denied(reference: Reference, credentials: Credentials | None, said: str) -> InputError:
    """The error of a registry that denies something; ``said`` is its own word, without secrets."""
    if credentials is None or credentials.anonymous or credentials.registry != reference.registry:
        who = "nobody is logged in: give registry.username and registry.password-variable, or log in with docker"
    else:
        who = f"check the password of {credentials.username or 'the token'}, and what it may do to this name"
    return InputError(f"{reference}: {reference.registry} denies access ({said}); {who}")


def _errors(body: bytes) -> str:
    """What a registry says went wrong; empty where it says it in no known form."""
    try:
        return "; ".join(f"{error['code']}: {error.get('message') or ''}" for error in json.loads(body)["errors"][:3])
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return ""


def _parsed(reference: Reference | str) -> Reference:
    return parse_reference(reference) if isinstance(reference, str) else reference


def _version(reference: Reference) -> str:
    return reference.digest or reference.tag or "latest"
