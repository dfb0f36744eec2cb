"""Server of the page, on exactly one address and port, without connections to the outside, until it is interrupted.

Any page that is open in a browser can send requests to this machine, and so can any program of another user. Each
request therefore has to name the address that is served (against rebinding of a name), a websocket has to come from
the page itself, and both need the token, a secret in the path of the address.
"""

import errno
import functools
import hmac
import http
import logging
import secrets
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from ipaddress import ip_address
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import click
import rich
import viser
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from calibration.addons.recorder.page import Page
from calibration.addons.recorder.preview import preview
from calibration.addons.recorder.record_motion import RecorderSettings
from calibration.addons.recorder.session import Session
from calibration.base import InfrastructureError, InputError, count_of
from calibration.ci.workflow import Runner, stop_commands
from calibration.robot.simulation.motion import read_motion
from calibration.robot.simulation.motion_information import predicted_sigmas
from calibration.robot.simulation.system import read_system

LOOPBACK_ADDRESS = "127.0.0.1"
_LOOPBACK_NAMES = (LOOPBACK_ADDRESS, "::1", "localhost")
_HTTP_PORT = 80  # not named in an address
_ALL_ADDRESSES = ("0.0.0.0", "::", "")  # noqa: S104 (compared with, not bound to)


_Process = Callable[[ServerConnection, Request], Response | None]


class LocalServer(viser.ViserServer):
    """Server for those who know its token, without viser's tunnel for sharing a page."""

    def __init__(self, host: str, port: int) -> None:
        self.token = secrets.token_urlsafe(16)
        self._is_guarded = False
        serve = websockets.asyncio.server.serve
        websockets.asyncio.server.serve = functools.partial(self._serve_checked, serve)  # type: ignore[assignment,misc]
        try:  # viser, which has no option for it, calls it before it returns
            super().__init__(host=host, port=port, label="Motion recorder", verbose=False)
        finally:
            websockets.asyncio.server.serve = serve  # type: ignore[misc]
        if not self._is_guarded:
            self.stop()
            raise InfrastructureError(f"record-motion cannot guard viser {viser.__version__}; install viser 1.1.1")

    def _serve_checked(self, serve: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
        """Call ``serve`` of websockets with a check of each request before viser's own."""
        process: _Process = options.pop("process_request")

        def check_and_process(connection: ServerConnection, request: Request) -> Response | None:
            reason = refusal(request, self.get_host(), connection.local_address[1], self.token)
            if reason is not None:
                return connection.respond(http.HTTPStatus.FORBIDDEN, f"{reason}\n")
            request.path = request.path.partition("?")[0].removeprefix(f"/{self.token}") or "/"
            response = process(connection, request)
            if response is not None:
                response.headers["Referrer-Policy"] = "no-referrer"  # the token is in the address
            return response

        self._is_guarded = True
        quiet = logging.Logger("recorder", logging.CRITICAL)  # else any connection can print a traceback
        return serve(*arguments, process_request=check_and_process, logger=quiet, **options)

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Return None: there is no tunnel."""
        return None


def refusal(request: Request, host: str, port: int, token: str) -> str | None:
    """Return why a request is refused; None if it is not.

    Args:
        request: request for a page, or handshake of a websocket.
        host: address that is served.
        port: its port.
        token: secret with which the path begins.
    """
    headers = request.headers
    hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
    if len(hosts) != 1 or not _is_served(hosts[0], host, port):
        return "Host: this is not the address that is served"
    needs_origin = "Upgrade" in headers  # a websocket; a browser that opens a page sends none
    if (origins or needs_origin) and origins != [f"http://{hosts[0]}"]:
        return "Origin: this is not the page that is served"
    first = request.path.partition("?")[0].split("/")[1:2]
    if not hmac.compare_digest("".join(first).encode(errors="surrogateescape"), token.encode()):
        return "The address lacks its token; open the one that the terminal shows"
    return None


def _is_served(name: str, host: str, port: int) -> bool:
    """Return whether the Host of a request is the address that is served, or any number where all addresses are."""
    try:
        parts = urlsplit(f"//{name}")
        found, found_port = parts.hostname, parts.port or _HTTP_PORT
    except ValueError:
        return False
    if found is None or found_port != port or parts.netloc != name or parts.username is not None:
        return False
    if found == host.lower() or (
        host in _ALL_ADDRESSES and _is_number(found)
    ):  # no other name: it could be another site's
        return True
    return found in _LOOPBACK_NAMES and (host in _ALL_ADDRESSES or is_loopback(host))


def _is_number(host: str) -> bool:
    try:
        ip_address(host)
    except ValueError:
        return False
    return True


@contextmanager
def serving(host: str, port: int) -> Iterator[LocalServer]:
    """Run a server on an address and a port (0: any free one) until the end of the block.

    Raises:
        InputError: the host is not an address of this machine.
        InfrastructureError: the port is in use, or needs other privileges.
    """
    _check_free(host, port)
    console = rich.get_console()
    before, console.quiet = console.quiet, True  # suppresses viser's own panel, which ignores its option
    server = LocalServer(host, port)
    try:
        if port and server.get_port() != port:  # viser takes the next port if another process was faster
            raise _in_use(host, port)
        yield server
    finally:
        server.stop()
        console.quiet = before


def address(server: LocalServer) -> str:
    """URL of the page, with the token."""
    host = server.get_host()
    if host in _ALL_ADDRESSES:
        host = LOOPBACK_ADDRESS
    return f"http://{f'[{host}]' if ':' in host else host}:{server.get_port()}/{server.token}/"


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


def record(settings: RecorderSettings, folder: Path, runner: Runner) -> None:
    """Serve the page; on interruption, unsaved poses are written to a file beside the output.

    Args:
        settings: inputs of the command.
        folder: folder of the system.
        runner: runner that logs the address.

    Raises:
        InputError: an input is missing or malformed.
        InfrastructureError: the port is taken, or a file cannot be written.
    """
    system = read_system(folder, settings.robot, settings.config)
    session = Session(system, read_motion(settings.motion) if settings.motion else None)
    with serving(settings.host, settings.port) as server:
        page = Page(
            server,
            session,
            settings.output,
            look=lambda pose: preview(system, pose),
            rate=lambda sequence: predicted_sigmas(system, sequence),
            overwrite=settings.overwrite,
        )
        try:
            with stop_commands(runner):  # untrusted names from files
                runner.log(f"{system.name}: the motion recorder is at {address(server)} (Ctrl-C ends it)")
                if not is_loopback(settings.host):
                    who = "everyone who has this address, which is not encrypted on its way,"
                    runner.log(f"{who} can use it and write motion files beside {settings.output}")
            if settings.open:
                click.launch(address(server))
            threading.Event().wait()
        finally:
            page.close()
            saved = session.autosave(settings.output)
            if saved is not None:
                with stop_commands(runner):
                    runner.log(f"{count_of(len(session.poses), 'pose')} not exported, now in {saved}")
