import socket
import urllib.request

import pytest

from calibration.errors import InfrastructureError, InputError
from calibration.recorder.server import address, is_loopback, serving


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
    with serving("127.0.0.1", 0):
        pass
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("host", "expected"),
    [("127.0.0.1", True), ("localhost", True), ("127.8.8.8", True), ("192.0.2.7", False), ("no such host", False)],
)
def test_which_addresses_are_of_this_machine_only(host: str, expected: bool) -> None:
    assert is_loopback(host) is expected
