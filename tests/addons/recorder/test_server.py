import http.client
import socket
import urllib.request
from urllib.parse import urlsplit

import pytest
import viser
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from calibration.addons.recorder import recording as recorder_server
from calibration.addons.recorder.recording import LocalServer, address, is_loopback, serving
from calibration.base import InfrastructureError, InputError

ALL = "0.0.0.0"  # noqa: S104 (compared with, not bound to)


def test_any_free_port_is_one_and_the_page_is_there() -> None:
    with serving("127.0.0.1", 0) as server:
        url = address(server)
        assert url.startswith("http://127.0.0.1:")
        with urllib.request.urlopen(url, timeout=20) as page:  # noqa: S310 (its own address)
            assert b"<html" in page.read(500).lower()
        port = server.get_port()
    with socket.socket() as probe:  # and gone afterwards
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind(("127.0.0.1", port))


def test_a_port_in_use_is_said_and_no_other_one_is_taken() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        expected = f"^port: {port} is in use on 127.0.0.1; give another --port"
        with pytest.raises(InfrastructureError, match=expected), serving("127.0.0.1", port):
            raise AssertionError("it must not start")


@pytest.mark.parametrize("host", ["192.0.2.7", "no such host", "", "::gg"])
def test_an_address_of_another_machine_is_refused(host: str) -> None:
    expected = f"^host: found '{host}', expected an address of this machine"
    with pytest.raises(InputError, match=expected), serving(host, 0):
        raise AssertionError("it must not start")


def test_nobody_gets_a_way_in_from_outside() -> None:
    with serving("127.0.0.1", 0) as server:
        assert server.request_share_url() is None


def test_it_prints_nothing_of_its_own(capfd: pytest.CaptureFixture[str]) -> None:
    with serving("127.0.0.1", 0) as server:
        for sent in (b"", b"nonsense\r\n\r\n"):
            with socket.create_connection(("127.0.0.1", server.get_port())) as connection:
                connection.sendall(sent)
                connection.shutdown(socket.SHUT_WR)
                connection.recv(1000)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("host", "expected"),
    [("127.0.0.1", True), ("localhost", True), ("127.8.8.8", True), ("192.0.2.7", False), ("no such host", False)],
)
def test_which_addresses_are_of_this_machine_only(host: str, expected: bool) -> None:
    assert is_loopback(host) is expected


def answer(server: LocalServer, path: str, *headers: tuple[str, str]) -> int:
    """The status of a request with exactly these headers."""
    connection = http.client.HTTPConnection("127.0.0.1", server.get_port(), timeout=20)
    connection.putrequest("GET", path, skip_host=True)
    for name, value in headers:
        connection.putheader(name, value)
    connection.endheaders()
    try:
        return connection.getresponse().status
    finally:
        connection.close()


def joins(server: LocalServer, path: str, origin: str | None, host: str | None = None) -> bool:
    """Whether a websocket is let in."""
    own = f"127.0.0.1:{server.get_port()}"
    options = {"origin": origin, "subprotocols": [f"viser-v{viser.__version__}"], "max_size": None}
    try:
        with (
            socket.create_connection(("127.0.0.1", server.get_port())) as channel,
            connect(f"ws://{host or own}{path}", sock=channel, **options) as page,  # type: ignore[arg-type]
        ):
            return bool(page.recv(20))
    except InvalidStatus:
        return False


def test_only_who_knows_the_address_opens_the_page() -> None:
    with serving("127.0.0.1", 0) as server:
        own = ("Host", f"127.0.0.1:{server.get_port()}")
        path = urlsplit(address(server)).path
        assert len(server.token) > 20
        assert answer(server, path, own) == 200
        assert answer(server, path.rstrip("/") + "?websocket=ws://x", own) == 200
        assert answer(server, path, ("Host", f"localhost:{server.get_port()}")) == 200
        assert answer(server, path, own, ("Origin", f"http://{own[1]}")) == 200
        for other in (
            "/",
            "",
            "/index.html",
            "/x" + path,
            path[:-2] + "/",
            path.rstrip("/") + "x",
            f"/?{server.token}",
        ):
            assert answer(server, other, own) in (400, 403)
        assert answer(server, f"//{server.token}/", own) == 403
        assert answer(server, f"{path}../../../etc/passwd", own) == 404
        for host in (
            "evil.example",
            f"evil.example:{server.get_port()}",
            "127.0.0.1",
            "127.0.0.1:1",
            "",
            "[",
            "127.0.0.1:x",
        ):
            assert answer(server, path, ("Host", host)) == 403
        assert answer(server, path, ("Host", f"a@{own[1]}")) == 403
        assert answer(server, path) == 403
        assert answer(server, path, own, own) == 403
        for origin in (
            "http://evil.example",
            "null",
            f"https://{own[1]}",
            f"http://{own[1]}.evil.example",
            "http://127.0.0.1",
        ):
            assert answer(server, path, own, ("Origin", origin)) == 403


def test_only_the_page_itself_opens_a_websocket() -> None:
    with serving("127.0.0.1", 0) as server:
        own = f"127.0.0.1:{server.get_port()}"
        path = urlsplit(address(server)).path.rstrip("/")
        assert joins(server, path, f"http://{own}")
        assert not joins(server, "/", f"http://{own}")
        assert not joins(server, path, "http://evil.example")
        assert not joins(server, path, "null")
        assert not joins(server, path, None)
        evil = f"evil.example:{server.get_port()}"
        assert not joins(server, path, f"http://{evil}", evil)


def test_every_server_has_a_token_of_its_own() -> None:
    with serving("127.0.0.1", 0) as one, serving("127.0.0.1", 0) as other:
        assert one.token != other.token


@pytest.mark.parametrize(
    ("name", "host", "expected"),
    [
        ("192.0.2.7:80", ALL, True),
        ("192.0.2.7", ALL, True),
        ("[2001:db8::1]:80", "::", True),
        ("localhost:80", ALL, True),
        ("evil.example:80", ALL, False),
        ("robot.local:80", "robot.local", True),
        ("evil.example:80", "robot.local", False),
        ("192.0.2.7:80", "192.0.2.8", False),
        ("localhost:80", "192.0.2.8", False),
        ("LOCALHOST:80", "127.0.0.1", True),
        ("[::1]:80", "::1", True),
    ],
)
def test_which_names_are_served(name: str, host: str, expected: bool) -> None:
    assert recorder_server._is_served(name, host, 80) is expected


def test_a_server_that_cannot_be_guarded_does_not_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viser.ViserServer, "__init__", lambda *_, **__: None)
    monkeypatch.setattr(LocalServer, "stop", lambda _: None)
    with pytest.raises(InfrastructureError, match="cannot guard viser"):
        LocalServer("127.0.0.1", 0)
