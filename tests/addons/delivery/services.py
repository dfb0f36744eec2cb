"""Stand-ins of a registry and of GitHub's releases in one server, which fail as a test asks them to."""

import hashlib
import json
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import parse_qs, urlsplit

from tests.ci.registries.server import Reply, Request, Server, serve

REPOSITORY, IMAGE = "me/robot", "team/robot"


@dataclass
class Services:
    """What the registry and GitHub have."""

    server: Server
    repository: str = REPOSITORY
    blobs: dict[str, bytes] = field(default_factory=dict)
    tags: dict[str, bytes] = field(default_factory=dict)
    releases: list[dict[str, Any]] = field(default_factory=list)
    assets: dict[int, bytes] = field(default_factory=dict)
    git_tags: set[str] = field(default_factory=set)
    fault: Callable[[Request], Reply | None] = lambda _: None
    """Answers in the place of the services, or does something before they answer."""

    @property
    def shown(self) -> tuple[list[str], list[str]]:
        """What anybody sees: the tags of the registry, and of the releases that are published."""
        return sorted(self.tags), sorted(each["tag_name"] for each in self.releases if not each["draft"])

    def changelog(self, tag: str) -> str:
        return next(str(each["body"]) for each in self.releases if each["tag_name"] == tag)

    def answer(self, request: Request) -> Reply:
        if (reply := self.fault(request)) is not None:
            return reply
        where = urlsplit(request.path)
        if where.path.startswith("/v2/"):
            return self._registry(request, where.path.removeprefix(f"/v2/{IMAGE}/"), parse_qs(where.query))
        return self._github(request, where.path.removeprefix(f"/repos/{self.repository}/"), parse_qs(where.query))

    def _registry(self, request: Request, path: str, query: dict[str, list[str]]) -> Reply:
        kind, _, name = path.partition("/")
        digest = f"sha256:{hashlib.sha256(request.body).hexdigest()}"
        if request.method == "POST":
            return Reply(202, headers={"Location": f"/v2/{IMAGE}/blobs/uploads/1?state=a"})
        if request.method == "PUT" and kind == "blobs":
            assert query["digest"] == [digest]
            self.blobs[digest] = request.body
            return Reply(201)
        if request.method == "PUT":
            assert all(each["digest"] in self.blobs for each in json.loads(request.body)["layers"])
            (self.blobs if name.startswith("sha256:") else self.tags)[name] = request.body
            return Reply(201, headers={"Docker-Content-Digest": digest})
        found = self.blobs.get(name, self.tags.get(name))
        return Reply(404) if found is None else Reply(200, found, {"Content-Type": json_type(kind)})

    def _github(self, request: Request, path: str, query: dict[str, list[str]]) -> Reply:
        if path.startswith("git/ref/tags/"):
            return answered({} if path.rpartition("/")[2] in self.git_tags else None)
        if asset := re.fullmatch(r"releases/assets/(\d+)", path):
            return Reply(200, self.assets[int(asset[1])])
        if path == "releases" and request.method == "GET":
            return answered(self.releases if query["page"] == ["1"] else [])
        if path == "releases":
            number = len(self.releases) + 1
            upload_url = f"http://{self.server.address}/repos/{self.repository}/releases/{number}/assets{{?name,label}}"
            made = {**json.loads(request.body), "id": number, "upload_url": upload_url, "assets": []}
            self.releases.append(made)
            return answered(made, 201)
        number = int(path.split("/")[1])
        release = next(each for each in self.releases if each["id"] == number)
        if request.method == "POST":
            self.assets[len(self.assets) + 1] = request.body
            release["assets"].append({"name": query["name"][0], "id": len(self.assets)})
        elif request.method == "DELETE":
            self.releases.remove(release)
            return Reply(204)
        elif any(each["tag_name"] == release["tag_name"] and not each["draft"] for each in self.releases):
            return answered({"message": "Validation Failed"}, 422)
        else:
            release["draft"] = False
            self.git_tags.add(release["tag_name"])
        return answered(release)


def json_type(kind: str) -> str:
    return "application/vnd.oci.image.manifest.v1+json" if kind == "manifests" else "application/octet-stream"


def answered(document: object, status: int = 200) -> Reply:
    return Reply(404, b'{"message": "Not Found"}') if document is None else Reply(status, json.dumps(document).encode())


@contextmanager
def services() -> Iterator[Services]:
    """Serve both on this machine."""
    found: list[Services] = []
    with serve(lambda request: found[0].answer(request)) as server:
        found.append(Services(server))
        yield found[0]
