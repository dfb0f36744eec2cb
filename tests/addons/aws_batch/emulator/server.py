"""AWS Batch over HTTP, on this machine."""

import json
import socket
import threading
from collections import Counter
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit

from . import model
from .attempt import Runner
from .calls import Calls, ClientError
from .faults import Faults
from .instant import Function, Instant
from .jobs import Job, Jobs, Queue
from .scheduler import Scheduler

REGION = "eu-west-1"


class Emulator:
    """An AWS Batch with one account and one region; elsewhere there is nothing."""

    def __init__(
        self,
        runner: Runner | Function | None = None,
        hosts: int = 4,
        region: str = REGION,
        time_scale: float = 1.0,
        faults: Faults | None = None,
        calls: "Counter[str] | None" = None,
    ) -> None:
        """Start it; whoever does ends it with `close`.

        Args:
            runner: what runs tasks; a function of the test for instant jobs; None where all end with 0 at once.
            hosts: how many tasks run at once.
            region: where its queues are.
            time_scale: how long one of Batch's seconds is, for timeouts of jobs (60 at least) and of starts.
            faults: shared with others, so that one list has all that goes wrong.
            calls: the same for the calls.
        """
        self.faults = faults or Faults()
        self.calls: Counter[str] = Counter() if calls is None else calls
        """How often each operation was called, whatever came of it."""
        self.requests: list[tuple[str, dict[str, Any]]] = []
        """Each call that was answered, with what it asked for."""
        self.jobs = Jobs(region)
        found: Any = runner
        self.runner: Any = found if hasattr(found, "run") else Instant(found)
        """Has a ``function`` where jobs are instant, which a test may set at any time."""
        self.scheduler = Scheduler(self.jobs, self.faults, self.runner, hosts, time_scale)
        self._calls = Calls(self.jobs, self.scheduler)
        self._nowhere = Calls(Jobs("nowhere"), self.scheduler)
        self._problems: list[str] = []
        self._lock = threading.Lock()
        emulator = self

        class Bound(_Handler):
            service = emulator

        self._server = _Server(("127.0.0.1", 0), Bound)
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True)
        self._thread.start()

    @property
    def endpoint(self) -> str:
        """Its address."""
        return f"http://127.0.0.1:{self._server.server_port}"

    @property
    def problems(self) -> list[str]:
        """Answers of ours that botocore's description has something against, and exceptions: a test fails for them."""
        return self._problems + self.scheduler.errors

    @property
    def unseen(self) -> int:
        """How many times DescribeJobs does not know a job that was just submitted: AWS is consistent eventually."""
        return self._calls.unseen

    @unseen.setter
    def unseen(self, times: int) -> None:
        self._calls.unseen = times

    def add_queue(self, name: str, kind: str = "FARGATE", **more: Any) -> Queue:
        """Add a job queue with a compute environment of its own; more: fields of `Queue`."""
        environment = more.pop("environment", f"{name}-hosts")
        queue = Queue(name, self.jobs.arn("job-queue", name), environment, kind, **more)
        self.jobs.queues[name] = queue
        return queue

    def every_job(self) -> list[Job]:
        """Return all single jobs and children."""
        with self.jobs.lock:
            return list(self.jobs.every())

    def wait(self, seconds: float = 120.0) -> None:
        """Wait until all that was submitted has ended."""
        with self.jobs.lock:
            if not self.jobs.lock.wait_for(lambda: all(job.ended for job in self.jobs.jobs.values()), seconds):
                raise AssertionError(f"not ended: {[job.id for job in self.jobs.jobs.values() if not job.ended]}")

    def close(self) -> None:
        """End all that runs, and the server."""
        self.scheduler.close()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def answer(self, method: str, path: str, query: str, body: bytes, authorization: str) -> tuple[int, str, Any]:
        """Answer a request: the HTTP status, the error's code (empty where there is none), and the answer."""
        found = model.operation(method, path)
        if found is None:
            return 404, "UnknownOperationException", {"message": f"{method} {path}"}
        name = found[0]
        request: dict[str, Any] = {key: unquote(value) for key, value in found[1].items()}
        if not authorization.startswith("AWS4-HMAC-SHA256 Credential="):
            return 403, "MissingAuthenticationTokenException", {"message": "Missing Authentication Token"}
        try:
            request |= json.loads(body or b"{}")
        except ValueError:
            return 400, "SerializationException", {"message": "no JSON"}
        if "tagKeys" in (asked := parse_qs(query)):
            request["tagKeys"] = asked["tagKeys"]
        if problems := model.request_problems(name, request):
            return 400, "ValidationException", {"message": "; ".join(problems)}
        here = f"/{self.jobs.region}/batch/" in authorization
        call = (self._calls if here else self._nowhere).find(name)
        if call is None:
            return 501, "NotImplemented", {"message": f"the emulator does not know {name}"}
        with self._lock:
            self.requests.append((name, request))
        try:
            answer = call(request)
        except ClientError as error:
            return 400, "ClientException", {"message": str(error)}
        if problems := model.answer_problems(name, answer):
            raise AssertionError(f"{name}: {'; '.join(problems)}")
        return 200, "", answer

    def handle(self, method: str, target: str, body: bytes, authorization: str) -> tuple[int, str, Any] | None:
        """Answer a request with the fault that is due, or truly; None where the connection is to break."""
        url = urlsplit(target)
        found = model.operation(method, url.path)
        name = found[0] if found else "unknown"
        with self._lock:
            self.calls[name] += 1
        fault = self.faults.reply(name, target + body.decode(errors="replace"))
        if fault is not None and fault.status:
            return fault.status, fault.code, {"message": fault.message}
        if fault is not None and fault.drop == "before":
            return None
        try:
            answer = self.answer(method, url.path, url.query, body, authorization)
        except Exception as error:  # ours: the test's end tells of it
            self._problems.append(f"{type(error).__name__}: {error}")
            return 500, "ServerException", {"message": f"emulator: {error}"}
        return None if fault is not None and fault.drop == "after" else answer


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    request_queue_size = 64

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of clients that left."""


class _Handler(BaseHTTPRequestHandler):
    service: Emulator
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True
    timeout = 30

    def log_message(self, *_: object) -> None:
        pass

    def _reply(self) -> None:
        length = int(self.headers.get("Content-Length") or 0)
        body = self.rfile.read(length)
        answer = self.service.handle(self.command, self.path, body, self.headers.get("Authorization", ""))
        if answer is None:
            self.close_connection = True
            with suppress(OSError):
                self.connection.shutdown(socket.SHUT_RDWR)
            return
        status, code, content = answer
        text = json.dumps(content).encode()
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(text)))
        self.send_header("x-amzn-RequestId", "00000000-0000-0000-0000-000000000000")
        if code:
            self.send_header("x-amzn-errortype", code)
        self.end_headers()
        self.wfile.write(text)

    do_GET = do_POST = do_DELETE = _reply  # noqa: N815
