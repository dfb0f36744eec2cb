"""Stand-in of GitHub's REST API: comments on pull requests of one repository, and its errors."""

import json
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, TypeVar
from urllib.parse import parse_qs, urlsplit

REPOSITORY = "me/robot"
TOKEN = "the token of the job"  # noqa: S105
FORBIDDEN = (403, {"message": "Resource not accessible by integration"}, {})


@dataclass
class GitHub:
    """State of the API."""

    url: str
    repository: str = REPOSITORY
    comments: list[dict[str, Any]] = field(default_factory=list)
    pulls: list[dict[str, Any]] = field(default_factory=list)
    user: str | None = None
    """User of the token; None for a workflow's token."""
    asked: list[tuple[str, str]] = field(default_factory=list)
    answers: list[tuple[int, object, dict[str, str]]] = field(default_factory=list)
    """Next answers to requests that change something; without any, they succeed."""
    before_answer: Callable[[str, str], None] | None = None
    lock: threading.RLock = field(default_factory=threading.RLock)
    _next: int = 100

    def add(self, body: str, login: str = "github-actions[bot]", kind: str = "Bot") -> dict[str, Any]:
        """Add a comment of any user."""
        with self.lock:
            self._next += 1
            comment = {"id": self._next, "body": body, "user": {"login": login, "type": kind}}
            self.comments.append(comment)
            return comment

    def bodies(self) -> list[str]:
        return [str(each["body"]) for each in self.comments]

    def answer(self, method: str, path: str, body: Any, token: str | None) -> tuple[int, object, dict[str, str]]:
        self.asked.append((method, path))
        if token != f"Bearer {TOKEN}":
            return 401, {"message": "Bad credentials"}, {}
        if method != "GET" and self.answers:
            return self.answers.pop(0)
        where, query = urlsplit(path), parse_qs(urlsplit(path).query)
        if where.path == "/user":
            return (200, {"login": self.user}, {}) if self.user else FORBIDDEN
        if where.path == f"/repos/{self.repository}/pulls":
            wanted = [each for each in self.pulls if each["head"]["label"] in query["head"]]
            return 200, _page(wanted, query), {}
        if re.fullmatch(rf"/repos/{self.repository}/issues/7/comments", where.path):
            if method == "POST":
                return 201, self.add(body["body"], *([self.user, "User"] if self.user else [])), {}
            return 200, _page(self.comments, query), {}
        one = re.fullmatch(rf"/repos/{self.repository}/issues/comments/(\d+)", where.path)
        found = [each for each in self.comments if one and each["id"] == int(one[1])]
        if not found:
            return 404, {"message": "Not Found"}, {}
        if method == "DELETE":
            self.comments.remove(found[0])
            return 204, None, {}
        found[0]["body"] = body["body"]
        return 200, found[0], {}


Service = TypeVar("Service", bound=GitHub)


def _page(entries: list[dict[str, Any]], query: dict[str, list[str]]) -> list[dict[str, Any]]:
    size, page = int(query["per_page"][0]), int(query["page"][0])
    return entries[size * (page - 1) : size * page]


@contextmanager
def stand_in(kind: type[Service]) -> Iterator[Service]:
    """Run a stand-in on this machine."""

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            content = self.rfile.read(int(self.headers.get("Content-Length", 0)))
            body = json.loads(content) if content else None
            if service.before_answer is not None:
                service.before_answer(self.command, self.path)
            with service.lock:
                status, answer, headers = service.answer(
                    self.command, self.path, body, self.headers.get("Authorization")
                )
            text = b"" if answer is None else json.dumps(answer).encode()
            self.send_response(status)
            for name, value in headers.items():
                self.send_header(name, value)
            self.send_header("Content-Length", str(len(text)))
            self.end_headers()
            self.wfile.write(text)

        do_POST = do_PATCH = do_PUT = do_DELETE = do_GET  # noqa: N815 (their caller's names)

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    service = kind(f"http://127.0.0.1:{server.server_port}")
    thread = threading.Thread(target=server.serve_forever, args=(0.02,))
    thread.start()
    try:
        yield service
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def github() -> AbstractContextManager[GitHub]:
    """Run GitHub's stand-in on this machine."""
    return stand_in(GitHub)
