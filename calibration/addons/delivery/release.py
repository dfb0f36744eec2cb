"""Delivery as assets of a GitHub release: a draft that nobody sees, and is then published.

https://docs.github.com/en/rest/releases
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import quote

from calibration.addons.delivery.archive import MAX_BUNDLE_BYTES
from calibration.addons.delivery.attestation import ATTESTATION_ENDING
from calibration.addons.delivery.destinations import Delivery, FetchedBundle, taken_meanwhile
from calibration.addons.delivery.manifest import BUNDLE_ENDING, is_version, version_order
from calibration.base.errors import InfrastructureError, InputError
from calibration.ci.github.api import GitHubApi, MissingError, RefusedRequestError


@dataclass
class GitHubReleases:
    """Releases of a repository for one robot, whose tags are ``ROBOT-VERSION``."""

    api: GitHubApi
    repository: str
    """OWNER/NAME."""
    robot: str
    _draft: int | None = field(default=None, init=False)
    _tag: str = field(default="", init=False)

    @property
    def name(self) -> str:
        """The releases of the repository."""
        return f"releases of {self.repository}"

    def last(self) -> FetchedBundle | None:
        """Return the bundle of the release with the largest version."""
        releases = {version: each for each in self._releases() if (version := self._version_of(each)) is not None}
        version = max(releases, key=version_order, default=None)
        if version is None:
            return None
        where = f"release {self.robot}-{version}"
        assets = {str(each.get("name")): each.get("id") for each in releases[version].get("assets", ())}
        bundle = f"{self.robot}{BUNDLE_ENDING}"
        if bundle not in assets:
            raise InputError(f"{where}: found no file {bundle}, expected the bundle that was delivered")
        attested = assets.get(bundle + ATTESTATION_ENDING)
        attestation = None if attested is None else self._asset(attested)
        return FetchedBundle(where, self._asset(assets[bundle]), attestation)

    def stage(self, delivery: Delivery) -> None:
        """Make a draft with the files."""
        self._tag = f"{self.robot}-{delivery.manifest.version}"
        try:
            self.api.request("GET", self._path(f"git/ref/tags/{self._tag}"))
        except MissingError:  # as it should be
            pass
        else:
            raise InputError(f"{self.repository}: there is a tag {self._tag} without the release, expected none")
        document = {
            "tag_name": self._tag,
            "target_commitish": delivery.manifest.commit,
            "name": f"{delivery.manifest.name} {delivery.manifest.version}",
            "body": delivery.changelog,
            "draft": True,
        }
        draft = self._changed("POST", "releases", document)
        try:
            self._draft, place = int(draft["id"]), str(draft["upload_url"]).partition("{")[0]
        except (LookupError, TypeError, ValueError):
            raise InfrastructureError(f"{self.repository}: GitHub's answer describes no release") from None
        for name, content in delivery.files.items():
            self.api.upload(f"{place}?name={quote(name)}", content)

    def complete(self) -> None:
        """Publish the draft, which makes its tag; GitHub refuses a second release of a tag."""
        try:
            self._changed("PATCH", f"releases/{self._draft}", {"draft": False})
        except RefusedRequestError:
            raise taken_meanwhile(f"{self.repository}: {self._tag}") from None
        self._draft = None

    def withdraw(self) -> None:
        """Delete the draft."""
        if self._draft is not None:
            self._changed("DELETE", f"releases/{self._draft}")

    def _releases(self) -> Iterator[dict[str, Any]]:
        try:
            yield from self.api.pages(self._path("releases?"))
        except MissingError as error:
            raise InputError(f"{error}: the token has no access to {self.repository}, or it does not exist") from None

    def _version_of(self, release: dict[str, Any]) -> str | None:
        tag = str(release.get("tag_name"))
        version = tag.removeprefix(f"{self.robot}-")
        return version if version != tag and is_version(version) and not release.get("draft") else None

    def _asset(self, number: object) -> bytes:
        try:
            content = self.api.download(self._path(f"releases/assets/{number}"))
        except MissingError as error:
            raise InfrastructureError(f"{error}: the release was changed meanwhile: run it again") from None
        if len(content) > MAX_BUNDLE_BYTES:
            raise InputError(f"{self.repository}: found an asset of {len(content)} bytes, expected a bundle")
        return content

    def _changed(self, method: str, path: str, document: object = None) -> Any:
        """Send a request that changes something: to a token that may not, GitHub may say that it is not there."""
        try:
            return self.api.request(method, self._path(path), document)
        except MissingError as error:
            raise InputError(f"{error}: the job needs permissions: {self.api.permission}") from None

    def _path(self, path: str) -> str:
        return f"/repos/{self.repository}/{path}"
