"""Builders of images: BuildKit, and the classic builder through the engine's API.

BuildKit runs through a ``docker`` command that supports it: secrets stay out of layers, several platforms are built.

The classic builder is for machines without such a command. The engine uses BuildKit only for clients that keep a
session open beside the request (context, secrets, SSH), which the Docker SDK for Python does not support (docker-py
issue 2230). The ``docker`` command does with its plugin buildx, or without it in versions 18.09 to 22. It is missing in
a job container with nothing but the engine's socket, and the plugin is missing in some installations; every engine
since 18.09 has this builder.
"""

import base64
import json
import os
import re
import secrets
import shutil
import subprocess
import tempfile
from collections import defaultdict, deque
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import IO, Any

import docker
import requests
import urllib3
from docker import DockerClient

from calibration.base import CalibrationError, InfrastructureError, InputError, temporary_folder
from calibration.base.process import has_ended, started
from calibration.ci.image.build_request import MAX_LAST_LINES, BuildLog, BuildRequest, build_problem, secret_files
from calibration.ci.registries.reference import DOCKER_HUB, Credentials

_STEP_LINE = re.compile(r"^Step (\d+)/(\d+) : (.*)", re.DOTALL)
_LAYER_GONE = "unknown parent image ID"
"""The engine's message if another process has removed a cached layer during the build."""
_MAX_ATTEMPTS = 3
_ENGINE_LINE = re.compile(r"^ ---> |^Removing intermediate container|^Successfully (built|tagged) ")
LONGEST_LINE = 64 * 1024


class _LayerGoneError(Exception):
    """A cached layer was removed: a retry may succeed."""


def build_by_engine(client: DockerClient, request: BuildRequest, log: BuildLog) -> str:
    """Build an image and return its id; a failed or stopped build leaves nothing behind.

    Raises:
        BuildFailedError: a step failed, or the Dockerfile is wrong.
        InfrastructureError: the engine, its disk or the network failed.
    """
    for _ in range(_MAX_ATTEMPTS):
        with suppress(_LayerGoneError):
            return _build_once(client, request, log)
    raise InfrastructureError(
        f"image {request.name}: layers of this build were removed by another process: run it again"
    )


def _build_once(client: DockerClient, request: BuildRequest, log: BuildLog) -> str:
    """Build once; see `build_by_engine`."""
    with tempfile.TemporaryFile() as archive, _closing_answers(client):
        request.context.write_tar(archive)
        archive.seek(0)
        image = ""
        try:
            events = client.api.build(
                fileobj=archive,
                custom_context=True,
                dockerfile=request.dockerfile,
                buildargs=dict(request.build_arguments),
                labels=dict(request.labels),
                target=request.target,
                platform=next(iter(request.platforms), None),
                nocache=request.no_cache,
                rm=True,
                forcerm=True,  # also remove the container of a failed step
                decode=True,
                use_config_proxy=True,
            )
            for event in events:
                image = _show_event(event, request, log) or image
        except docker.errors.APIError as error:
            raise build_problem(request.name, "", str(error.explanation or error), log) from None
        except (requests.RequestException, urllib3.exceptions.HTTPError, OSError, ValueError):
            raise InfrastructureError(f"image {request.name}: the engine broke off the build") from None
    if not image:
        raise InfrastructureError(f"image {request.name}: the engine ended without an image")
    return image


@contextmanager
def _closing_answers(client: DockerClient) -> Iterator[None]:
    """Close the engine's responses at the end of the block, which stops a running build."""
    answers: list[requests.Response] = []

    def remember(answer: "requests.Response", **_: object) -> None:
        answers.append(answer)

    hooks = client.api.hooks["response"]
    hooks.append(remember)
    try:
        yield
    finally:
        hooks.remove(remember)
        for answer in answers:
            answer.close()


def _show_event(event: Mapping[str, Any], request: BuildRequest, log: BuildLog) -> str | None:
    """Show an event; return the image's id if the event contains it."""
    if "error" in event or "errorDetail" in event:
        raise _error_of_event(event, request, log)
    text = str(event.get("stream", ""))
    if found := _STEP_LINE.match(text):
        log.step(int(found[1]), int(found[2]), found[3])
    elif text and not _ENGINE_LINE.match(text):
        log.output(text)
    elif event.get("status") and not event.get("progressDetail"):
        log.output(f"{event.get('id', '')} {event['status']}\n")
    aux = event.get("aux")
    return str(aux["ID"]) if isinstance(aux, Mapping) and "ID" in aux else None


def _error_of_event(event: Mapping[str, Any], request: BuildRequest, log: BuildLog) -> CalibrationError:
    detail = event.get("errorDetail")
    detail = detail if isinstance(detail, Mapping) else {}
    code = detail.get("code")
    message = f"exit code {code}" if code else str(detail.get("message") or event.get("error"))
    if message.startswith(_LAYER_GONE):
        raise _LayerGoneError
    return build_problem(request.name, log.step_name, message, log)


def lines_of(command: Sequence[str], stdin: IO[bytes], environment: Mapping[str, str]) -> Generator[str | int]:
    """Run a program; yield the lines of its output and errors, then its exit code.

    Closing the generator, or an exception while it waits, stops the program.

    Raises:
        InfrastructureError: the program cannot be started.
    """
    with ExitStack() as stack:
        try:
            process = stack.enter_context(started(command, environment, stdin=stdin))
        except OSError as error:
            raise InfrastructureError(f"{command[0]}: cannot be started: {error.strerror}") from error
        if process.stdout is None:
            raise AssertionError("its output is a pipe")
        while line := process.stdout.readline(LONGEST_LINE):
            yield line.decode("utf-8", "replace").rstrip("\r\n")
        has_ended(process, wait=True)
    yield process.returncode


VERSION_SECONDS = 20
"""Timeout of the commands that print a version."""
_VERSION_TEXT = re.compile(r"Docker version (\d+)\.(\d+)")


@dataclass(frozen=True)
class Program:
    """A ``docker`` command that supports BuildKit."""

    path: str
    buildx: bool
    """Whether BuildKit is available by the plugin buildx; otherwise it is built in (versions 18.09 to 22)."""


@cache
def find_buildkit(search_path: str) -> Program | None:
    """Find the first program on a PATH that supports BuildKit, preferably with buildx."""
    found = None
    for path in _find_programs(search_path):
        if _run_quietly(path, "buildx", "version") is not None:
            return Program(path, buildx=True)
        version = _VERSION_TEXT.search(_run_quietly(path, "--version") or "")
        if found is None and version and (18, 9) <= (int(version[1]), int(version[2])) < (23, 0):
            found = Program(path, buildx=False)
    return found


def docker_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the variables for a ``docker`` that builds only the image, without attestations and colours."""
    return {**environment, "DOCKER_BUILDKIT": "1", "BUILDX_NO_DEFAULT_ATTESTATIONS": "1", "NO_COLOR": "1"}


def _find_programs(search_path: str) -> Iterator[str]:
    folders = dict.fromkeys(filter(None, search_path.split(os.pathsep)))
    paths = (shutil.which("docker", path=folder) for folder in folders)
    return filter(None, paths)


def _run_quietly(*command: str) -> str | None:
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=VERSION_SECONDS,
            check=False,
            stdin=subprocess.DEVNULL,
            env=docker_environment(os.environ),
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout if done.returncode == 0 else None


def write_login(credentials: Credentials, folder: Path) -> dict[str, str]:
    """Write docker's configuration with a login into a folder, readable only for this user.

    Args:
        credentials: credentials for one registry; if anonymous, the user's own configuration is used.
        folder: private folder, which the caller removes.

    Returns:
        Environment variables that make ``docker`` use it, with its plugins.
    """
    if credentials.anonymous:
        return {}
    registry = "https://index.docker.io/v1/" if credentials.registry == DOCKER_HUB else credentials.registry
    if credentials.identity_token:
        login = {"identitytoken": credentials.identity_token}
    else:
        pair = f"{credentials.username}:{credentials.password}"
        login = {"auth": base64.b64encode(pair.encode()).decode("ascii")}
    home = folder / "docker"
    home.mkdir(mode=0o700)
    with os.fdopen(os.open(home / "config.json", os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
        json.dump({"auths": {registry: login}}, file)
    plugins = Path(os.environ.get("DOCKER_CONFIG") or Path("~/.docker").expanduser()) / "cli-plugins"
    if plugins.is_dir():
        (home / "cli-plugins").symlink_to(plugins)
    return {"DOCKER_CONFIG": str(home)}


_VERTEX_LINE = re.compile(r"^#(\d+) (.*)$")
_STEP_NAME = re.compile(r"^\[(?:\S+ +)?(\d+)/(\d+)\] (.*)$")
_OUTPUT_LINE = re.compile(r"^\d+\.\d+ ?(.*)$")
_EXIT_CODE = re.compile(r"exit code: (\d+)")


def build_by_buildkit(program: Program, request: BuildRequest, reference: str, log: BuildLog) -> None:
    """Build an image on the engine, with a name. A stopped build leaves only BuildKit's cache.

    Raises:
        BuildFailedError: a step failed, or the Dockerfile is wrong.
        InputError: SSH is requested and no agent runs.
        InfrastructureError: the engine, its disk or the network failed.
    """
    start = ["buildx", "build", "--builder", "default", "--load"] if program.buildx else ["build"]
    _run_build(program, [*start, "--tag", reference], docker_environment(os.environ), request, log)


def build_and_push(
    program: Program, request: BuildRequest, references: Sequence[str], credentials: Credentials, log: BuildLog
) -> str:
    """Build and push what the engine cannot store, several platforms or attestations, and return its digest.

    Raises:
        BuildFailedError, InputError, InfrastructureError: as :func:`build_by_buildkit`.
    """
    with ExitStack() as stack:
        folder = stack.enter_context(temporary_folder())
        environment = docker_environment(os.environ) | write_login(credentials, folder)
        name = stack.enter_context(_temporary_builder(program, environment, request.name))
        metadata = folder / "metadata.json"
        tags = [word for reference in references for word in ("--tag", reference)]
        start = ["buildx", "build", "--builder", name, "--push", "--metadata-file", str(metadata), *tags]
        _run_build(program, start, environment, request, log)
        text = metadata.read_text() if metadata.exists() else ""
    digest = re.search(r'"containerimage\.digest"\s*:\s*"(sha256:[0-9a-f]{64})"', text)
    if digest is None:
        raise InfrastructureError(f"image {request.name}: BuildKit ended without a digest")
    return digest[1]


def _run_build(
    program: Program, start: Sequence[str], environment: Mapping[str, str], request: BuildRequest, log: BuildLog
) -> None:
    with ExitStack() as stack:
        archive = stack.enter_context(tempfile.TemporaryFile())
        request.context.write_tar(archive)
        archive.seek(0)
        files = stack.enter_context(secret_files(request.secrets))
        command = [program.path, *start, "--progress", "plain", "--file", request.dockerfile]
        command += [word for item in request.build_arguments.items() for word in ("--build-arg", "=".join(item))]
        command += [word for item in request.labels.items() for word in ("--label", "=".join(item))]
        command += ["--target", request.target] if request.target else []
        command += ["--platform", ",".join(request.platforms)] if request.platforms else []
        command += [word for name, path in files.items() for word in ("--secret", f"id={name},src={path}")]
        command += ["--no-cache"] if request.no_cache else []
        command += ["--sbom=true", "--provenance=mode=max"] if request.attest else []
        if request.ssh:
            if not os.environ.get("SSH_AUTH_SOCK"):
                raise InputError("ssh: no SSH agent runs here (SSH_AUTH_SOCK): start one and add the key to it")
            command += ["--ssh", "default"]
        _follow_build([*command, "-"], archive, environment, request, log)


def _follow_build(
    command: Sequence[str],
    context: IO[bytes],
    environment: Mapping[str, str],
    request: BuildRequest,
    log: BuildLog,
) -> None:
    """Run the program until it ends.

    Raises:
        BuildFailedError, InputError, InfrastructureError: the build failed.
    """
    reader = BuildKitOutput(log)
    status = None
    with closing(lines_of(command, context, environment)) as lines:
        for line in lines:
            if isinstance(line, int):
                status = line
            else:
                reader.read(line)
    if status:
        raise build_problem(request.name, reader.failed_step, reader.problem or f"exit code {status}", log)


class BuildKitOutput:
    """Parser of BuildKit's output: ``#7 [2/4] RUN make``, ``#7 0.31 output``, ``#7 ERROR: ...``."""

    def __init__(self, log: BuildLog) -> None:
        self.failed_step = ""
        self.problem = ""
        self._log = log
        self._steps: dict[str, str] = {}
        self._lines: defaultdict[str, deque[str]] = defaultdict(lambda: deque(maxlen=MAX_LAST_LINES))
        self._ended = False

    def read(self, line: str) -> None:
        """Parse a line."""
        found = _VERTEX_LINE.match(line)
        if found is None:
            self._parse_message(line)
            return
        vertex, text = found.groups()
        if step := _STEP_NAME.match(text):
            if vertex not in self._steps:
                self._log.step(int(step[1]), int(step[2]), step[3])
                self._steps[vertex] = self._log.step_name
        elif text.startswith("ERROR: ") and not self._ended:
            self._ended = True
            self.failed_step = self._steps.get(vertex, "")
            self.problem = _step_problem(text.removeprefix("ERROR: "))
            self._log.remember(self._lines[vertex])
        elif (output := _OUTPUT_LINE.match(text)) and not self._ended:
            self._lines[vertex].append(output[1])
            self._log.output(output[1] + "\n")

    def _parse_message(self, line: str) -> None:
        """Parse a line outside of the steps: at the end, the reason of a failure."""
        line = line.strip()
        if not self._ended and line:
            self._log.output(line + "\n")
        if not self.problem and re.match(r"error|failed to solve|unknown flag", line, re.IGNORECASE):
            self.problem = _step_problem(line)


def _step_problem(text: str) -> str:
    code = _EXIT_CODE.search(text)
    return f"exit code {code[1]}" if code else text


@contextmanager
def _temporary_builder(program: Program, environment: Mapping[str, str], image: str) -> Iterator[str]:
    """Create a temporary builder that supports several platforms and attestations."""
    name = f"calibration-{secrets.token_hex(6)}"
    try:
        _run_buildx(program, environment, image, "create", "--name", name, "--driver", "docker-container")
        yield name
    finally:
        _run_buildx(program, environment, image, "rm", "--force", name)


def _run_buildx(program: Program, environment: Mapping[str, str], image: str, *arguments: str) -> None:
    command = [program.path, "buildx", *arguments]
    try:
        subprocess.run(
            command,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            timeout=120,
            check=True,
        )
    except subprocess.CalledProcessError as error:
        stderr = " ".join(error.stderr.decode(errors="replace").split())[-200:]
        raise InfrastructureError(f"image {image}: `docker buildx {arguments[0]}` failed: {stderr}") from None
    except (OSError, subprocess.TimeoutExpired) as error:
        raise InfrastructureError(f"image {image}: `docker buildx {arguments[0]}` failed: {error}") from None
