"""The web server of the page: on one address and port, or not at all; nothing leaves the machine by itself."""

import errno
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from ipaddress import ip_address

import rich
import viser

from calibration.errors import InputError, WorldError

LOOPBACK = "127.0.0.1"


class LocalServer(viser.ViserServer):
    """A server that nobody can ask for a way in from outside: viser's own has a tunnel for sharing a page."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Answer that there is none."""
        return None


@contextmanager
def serving(host: str, port: int) -> Iterator[viser.ViserServer]:
    """A server on an address and a port (0: any that is free), until the end of the block.

    Raises:
        InputError: the host is no address of this machine.
        WorldError: the port is in use, or not for this user.
    """
    _check_free(host, port)
    console = rich.get_console()
    before, console.quiet = console.quiet, True  # it prints a panel of its own, whatever it is told
    server = LocalServer(host=host, port=port, label="Motion recorder", verbose=False)
    try:
        if port and server.get_port() != port:  # it takes the next one where somebody was faster
            raise _in_use(host, port)
        yield server
    finally:
        server.stop()
        console.quiet = before


def address(server: viser.ViserServer) -> str:
    """What to open in a browser."""
    host = server.get_host()
    if host in ("0.0.0.0", "::", ""):  # noqa: S104 (compared with, not bound to)
        host = LOOPBACK
    return f"http://{f'[{host}]' if ':' in host else host}:{server.get_port()}/"


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches the address."""
    try:
        return all(ip_address(str(info[4][0])).is_loopback for info in socket.getaddrinfo(host, 0))
    except OSError:
        return False


def _check_free(host: str, port: int) -> None:
    """Bind the port for a moment, since viser tries the next ones, or waits for ever, where it cannot."""
    try:
        family, kind, protocol, _, where = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(where)
    except socket.gaierror as error:
        raise InputError(f"host: found '{host}', expected an address of this machine ({error.strerror})") from None
    except PermissionError:
        raise WorldError(f"port: {port} may not be used by this user; give --port 0 for any that is free") from None
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise _in_use(host, port) from None
        raise InputError(f"host: found '{host}', expected an address of this machine ({error.strerror})") from None


def _in_use(host: str, port: int) -> WorldError:
    return WorldError(f"port: {port} is in use on {host}; give another --port, or 0 for any that is free")
