"""The rest of AWS: moto's S3, CloudWatch Logs, STS, ECR and IAM over HTTP, with faults and a count of the calls."""

import threading
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from io import BytesIO
from typing import Any
from urllib.parse import parse_qs

from .emulator.faults import Faults
from .emulator.jobs import ACCOUNT

Start = Callable[..., Any]
LINE_BYTES = 256 * 1024 - 26


class Services:
    """A server of moto's, whose state is that of this process."""

    def __init__(self, address: str = "127.0.0.1") -> None:
        """Start it.

        Args:
            address: that it listens on; that of the engine's bridge where containers are to reach it.
        """
        from moto.moto_server.werkzeug_app import DomainDispatcherApplication, MotoRequestHandler, create_backend_app
        from werkzeug.serving import make_server

        self.faults = Faults()
        self.calls: Counter[str] = Counter()
        """How often each operation was called: ``GetLogEvents``; those of S3 by their method: ``s3:GET``."""
        self._moto = DomainDispatcherApplication(create_backend_app)

        class Quiet(MotoRequestHandler):
            protocol_version = "HTTP/1.1"

            def log(self, *_: object) -> None:
                pass

        self._server = make_server(address, 0, self._answer, threaded=True, request_handler=Quiet)
        self.endpoint = f"http://{address}:{self._server.server_port}"
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the server."""
        self.reset()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def reset(self) -> None:
        """Forget everything: buckets, logs, faults, counts."""
        from moto.backends import get_backend
        from moto.core.base_backend import BackendDict

        for service in ("s3", "logs", "sts", "ecr", "iam", "secretsmanager", "ssm"):
            backends: BackendDict[Any] = get_backend(service)
            for account in list(backends):
                for backend in list(backends[account].values()):
                    backend.reset()
        self.faults.clear()
        self.faults.had.clear()
        self.calls.clear()

    def make_bucket(self, name: str, region: str) -> None:
        """Make an empty bucket without a request."""
        self._s3().create_bucket(name, region)

    def put(self, bucket: str, key: str, content: bytes) -> None:
        """Store an object without a request."""
        self._s3().put_object(bucket, key, content)

    def get(self, bucket: str, key: str) -> bytes:
        """Return an object without a request; KeyError where there is none."""
        found = self._s3().get_object(bucket, key)
        if found is None:
            raise KeyError(f"s3://{bucket}/{key}")
        content: bytes = found.value
        return content

    def keys(self, bucket: str, prefix: str = "") -> list[str]:
        """Return the keys of all objects whose keys start so."""
        found = self._s3().buckets[bucket].keys.values()
        return sorted(key.name for key in found if key.name.startswith(prefix))

    def log(self, region: str, group: str, stream: str, lines: Sequence[tuple[int, str]]) -> None:
        """Add lines, each with its milliseconds, to a stream; makes it where it is not there."""
        from moto.logs.models import logs_backends

        backend = logs_backends[ACCOUNT][region]
        if group not in backend.groups:
            backend.create_log_group(group, {})
        if stream not in backend.groups[group].streams:
            backend.create_log_stream(group, stream)
        if lines:
            events = [{"timestamp": when, "message": line[:LINE_BYTES]} for when, line in lines]
            backend.put_log_events(group, stream, sorted(events, key=lambda event: event["timestamp"]))

    def _s3(self) -> Any:
        from moto.s3.models import s3_backends

        return s3_backends[ACCOUNT]["aws"]

    def _answer(self, environ: dict[str, Any], start: Start) -> Iterable[bytes]:
        name, environ = _operation(environ)
        self.calls[name] += 1
        fault = self.faults.reply(name, environ.get("PATH_INFO", ""))
        if fault is not None and fault.status:
            return _refusal(name, fault.status, fault.code, fault.message, start)
        if fault is not None and fault.drop == "after":
            for _ in self._moto(environ, lambda *_: lambda _: None):
                pass
        if fault is not None and fault.drop:
            environ["werkzeug.socket"].shutdown(2)
            start("500 dropped", [("Content-Length", "0"), ("Connection", "close")])
            return []
        answer: Iterable[bytes] = self._moto(environ, start)
        return answer


def _operation(environ: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """Return the name of a call; the body, where it had to be read, is still there for whoever is next."""
    target = environ.get("HTTP_X_AMZ_TARGET", "")
    if target:
        return target.rpartition(".")[2], environ
    if "/s3/aws4_request" in environ.get("HTTP_AUTHORIZATION", ""):
        return f"s3:{environ['REQUEST_METHOD']}", environ
    if environ.get("CONTENT_TYPE", "").startswith("application/x-www-form-urlencoded"):
        body = environ["wsgi.input"].read(int(environ.get("CONTENT_LENGTH") or 0))
        environ["wsgi.input"] = BytesIO(body)
        return parse_qs(body.decode(errors="replace")).get("Action", ["unknown"])[0], environ
    return "unknown", environ


def _refusal(name: str, status: int, code: str, message: str, start: Start) -> Iterable[bytes]:
    kind = "application/xml"
    if name.startswith("s3:"):
        body = f"<Error><Code>{code}</Code><Message>{message}</Message></Error>"
    elif name in ("unknown", "GetCallerIdentity", "AssumeRole", "AssumeRoleWithWebIdentity"):
        body = f"<ErrorResponse><Error><Code>{code}</Code><Message>{message}</Message></Error></ErrorResponse>"
    else:
        kind, body = "application/x-amz-json-1.1", f'{{"__type": "{code}", "message": "{message}"}}'
    start(f"{status} refused", [("Content-Type", kind), ("Content-Length", str(len(body.encode())))])
    return [body.encode()]
