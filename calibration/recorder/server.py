"""Web server of the page, on exactly one address and port, without connections to the outside."""

import errno
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from ipaddress import ip_address

import rich
import viser

from calibration.errors import InfrastructureError, InputError

LOOPBACK = "127.0.0.1"


class LocalServer(viser.ViserServer):
    """Server without viser's tunnel for sharing a page, so that it cannot be reached from outside."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Return None: there is no tunnel."""
        return None


@contextmanager
def serving(host: str, port: int) -> Iterator[viser.ViserServer]:
    """Run a server on an address and a port (0: any free one) until the end of the block.

    Raises:
        InputError: the host is not an address of this machine.
        InfrastructureError: the port is in use, or needs other privileges.
    """
    _check_free(host, port)
    console = rich.get_console()
    before, console.quiet = console.quiet, True  # suppresses viser's own panel, which ignores its option
    server = LocalServer(host=host, port=port, label="Motion recorder", verbose=False)
    try:
        if port and server.get_port() != port:  # viser takes the next port if another process was faster
            raise _in_use(host, port)
        yield server
    finally:
        server.stop()
        console.quiet = before


def address(server: viser.ViserServer) -> str:
    """URL of the page."""
    host = server.get_host()
    if host in ("0.0.0.0", "::", ""):  # noqa: S104 (compared with, not bound to)
        host = LOOPBACK
    return f"http://{f'[{host}]' if ':' in host else host}:{server.get_port()}/"


def is_loopback(host: str) -> bool:
    """Return whether the address is reachable only from this machine."""
    try:
        return all(ip_address(str(info[4][0])).is_loopback for info in socket.getaddrinfo(host, 0))
    except OSError:
        return False


def _check_free(host: str, port: int) -> None:
    """Bind the port briefly, since viser tries the next ones, or waits forever, if it cannot."""
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
        raise InfrastructureError(
            f"port: {port} may not be used by this user; give --port 0 for any that is free"
        ) from None
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise _in_use(host, port) from None
        raise InputError(f"host: found '{host}', expected an address of this machine ({error.strerror})") from None


def _in_use(host: str, port: int) -> InfrastructureError:
    return InfrastructureError(f"port: {port} is in use on {host}; give another --port, or 0 for any that is free")
