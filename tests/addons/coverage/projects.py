"""A project of a team, and a fake Codacy server."""

import ssl
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from tests.repositories import commit

TOKEN = "planted-t0ken/with+signs="  # noqa: S105 (of nobody)
NAMING = """def joined(*names):
    if not names:
        return ""
    return "_".join(names)


def split(name):
    return name.split("_")
"""
"""Six lines that can be run, and two branches."""
NAMING_TEST = """import unittest

from robot.naming import joined


class NamingTest(unittest.TestCase):
    def test_joined(self):
        self.assertEqual(joined("left", "camera"), "left_camera")
"""
"""Runs four of the six lines, and one of the two branches."""


def robot(folder: Path) -> Path:
    """A project with a module and a test of it."""
    commit(
        folder,
        {
            "robot/__init__.py": "",
            "robot/naming.py": NAMING,
            "tests/test_naming.py": NAMING_TEST,
            ".gitignore": "out\n__pycache__\n",
        },
    )
    return folder


@dataclass(frozen=True)
class Asked:
    """A received request."""

    method: str
    path: str
    headers: Mapping[str, str]
    body: bytes = field(repr=False)


@dataclass
class Codacy:
    """A server with scripted answers."""

    url: str
    asked: list[Asked] = field(default_factory=list)
    answers: list[tuple[int, str | bytes, Mapping[str, str]]] = field(default_factory=list)
    """Next answers; success when none is left."""
    fault: Callable[[BaseHTTPRequestHandler], None] | None = None
    """In the place of an answer."""

    def answer(self, status: int, body: str | bytes, **headers: str) -> None:
        """Add an answer."""
        self.answers.append((status, body, {name.replace("_", "-"): value for name, value in headers.items()}))


@contextmanager
def codacy(tls: ssl.SSLContext | None = None, host: str = "127.0.0.1") -> Iterator[Codacy]:
    """Fake Codacy server on this machine."""

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
            service.asked.append(Asked(self.command, self.path, dict(self.headers.items()), body))
            if service.fault is not None:
                service.fault(self)
                self.close_connection = True
                return
            status, answer, headers = service.answers.pop(0) if service.answers else (200, '{"success": "ok"}', {})
            content = answer.encode() if isinstance(answer, str) else answer
            self.send_response(status)
            for name, value in {"Content-Type": "application/json", **headers}.items():
                self.send_header(name, value)
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        do_GET = do_POST  # noqa: N815 (its caller's name)

        def log_message(self, *_: object) -> None:
            pass

    class Server(ThreadingHTTPServer):
        daemon_threads = True

        def handle_error(self, *_: object) -> None:  # a client that hangs up is what some tests want
            pass

    server = Server((host, 0), Handler)
    if tls is not None:
        server.socket = tls.wrap_socket(server.socket, server_side=True)
    service = Codacy(f"http{'s' if tls else ''}://{host}:{server.server_port}")
    thread = threading.Thread(target=server.serve_forever, args=(0.02,))
    thread.start()
    try:
        yield service
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def reset(handler: BaseHTTPRequestHandler) -> None:
    """Close the connection."""
    import socket
    import struct

    handler.connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    handler.connection.close()


def hang(handler: BaseHTTPRequestHandler) -> None:
    """Send nothing until after every timeout of the tests."""
    time.sleep(1.5)


def drip(handler: BaseHTTPRequestHandler) -> None:
    """Send single bytes repeatedly."""
    try:
        handler.wfile.write(b"HTTP/1.1 200 OK\r\nContent-Length: 100000\r\n\r\n")
        for _ in range(60):
            handler.wfile.write(b" ")
            handler.wfile.flush()
            time.sleep(0.05)
    except OSError:
        pass


def cut(handler: BaseHTTPRequestHandler) -> None:
    """Announce a longer body than is sent."""
    handler.wfile.write(b"HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\n{")
