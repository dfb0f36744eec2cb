"""A build: its request, independent of the builder, its secrets, its log, and its failure.

A failure is because of the Dockerfile, a missing base, or the infrastructure.
"""

import os
import re
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from calibration.base import (
    CalibrationError,
    ExitCode,
    InfrastructureError,
    InputError,
    one_line,
    read_bytes,
    shorten,
    temporary_folder,
    without_escapes,
)
from calibration.base.text import redact
from calibration.ci.image.context import Context
from calibration.ci.image.specification import Secret
from calibration.ci.workflow import Runner, add_mask
from calibration.ci.workflow.streams import Advance

MAX_BYTES = 500 * 1024
"""BuildKit's limit."""
MIN_SEARCHED_CHARACTERS = 6
"""Minimum length in characters to search for; a shorter secret may occur in a text by chance."""


@dataclass(frozen=True)
class SecretValue:
    """A secret with its value."""

    id: str
    value: bytes = field(repr=False)

    @property
    def text(self) -> str:
        """The value as text."""
        return self.value.decode("utf-8", "surrogateescape")


def read_secrets(
    secrets: Iterable[Secret], runner: Runner, environment: Mapping[str, str] | None = None
) -> tuple[SecretValue, ...]:
    """Read the secrets, and mask them before any other output.

    Raises:
        InputError: a variable is unset or empty, or a file cannot be read; the message names it.
    """
    variables = os.environ if environment is None else environment
    values = []
    for secret in secrets:
        if secret.file is not None:
            value = read_bytes(secret.file, MAX_BYTES, f"the secret {secret.id}")
        else:
            value = os.fsencode(variables.get(secret.variable or "", ""))
        if not value.strip():
            source = secret.file or f"the environment variable {secret.variable}"
            raise InputError(f"secrets: {secret.id}: {source} is not set or empty, where the secret was expected")
        values.append(SecretValue(secret.id, value))
        add_mask(runner, values[-1].text)
    return tuple(values)


def refuse_secrets_in(secrets: Iterable[SecretValue], places: Mapping[str, str]) -> None:
    """Check that no secret occurs in texts that become part of the image.

    Raises:
        InputError: one does; the message names the secret and the place, not the value.
    """
    for secret in secrets:
        text = secret.text.strip()
        for place, content in places.items():
            if len(text) >= MIN_SEARCHED_CHARACTERS and text in content:
                raise InputError(
                    f"secrets: {secret.id}: its value occurs in {place}, which everyone with the image can read: "
                    f"remove it, and let the command read /run/secrets/{secret.id}"
                )


@contextmanager
def secret_files(secrets: Iterable[SecretValue]) -> Iterator[dict[str, Path]]:
    """Write each secret to a file that only this user can read, removed at the end of the block."""
    with temporary_folder() as folder:  # mode 0700
        files = {}
        for number, secret in enumerate(secrets):
            files[secret.id] = folder / str(number)
            with os.fdopen(os.open(files[secret.id], os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
                file.write(secret.value)
        yield files


MAX_LAST_LINES = 20
MAX_LINE_CHARACTERS = 500
"""Limit of characters of a line."""


class BuildLog:
    """Shows a build without secrets, and keeps the current step and its last lines."""

    def __init__(self, runner: Runner, advance: Advance, secrets: Sequence[str] = ()) -> None:
        self._runner = runner
        self._advance = advance
        self._secrets = secrets
        self._shows_output = not runner.on_terminal  # a terminal has a progress bar
        self._part = ""
        self.step_name = ""
        self.last_lines: deque[str] = deque(maxlen=MAX_LAST_LINES)

    def step(self, number: int, total: int, instruction: str) -> None:
        """Report the start of a step."""
        self.end_line()
        self.last_lines.clear()
        instruction = " ".join(self.clean(instruction).split())
        self.step_name = f"step {number} of {total}, {instruction}"
        self._advance(number, total, shorten(instruction, 160), important=True)

    def output(self, text: str) -> None:
        """Add output of the step; a line is shown when it is complete."""
        *lines, self._part = (self._part + text).split("\n")
        for line in lines:
            self._show_line(line)
        if len(self._part) > 100 * MAX_LINE_CHARACTERS:  # limits the memory for a line without an end
            self.end_line()

    def end_line(self) -> None:
        """Show an incomplete line."""
        if self._part:
            self._show_line(self._part)
        self._part = ""

    def remember(self, lines: Iterable[str]) -> None:
        """Replace the last lines, for concurrent steps, whose lines are mixed."""
        self.end_line()
        self.last_lines.clear()
        self.last_lines.extend(shorten(line, MAX_LINE_CHARACTERS) for line in map(self.clean, lines) if line)

    def clean(self, text: str) -> str:
        """Return a text on one line with secrets redacted."""
        return one_line(redact(without_escapes(text), self._secrets))

    def _show_line(self, text: str) -> None:
        text = text.rstrip("\r").rpartition("\r")[2]  # of a progress bar that overwrites its line, keep the last state
        text = shorten(self.clean(text), MAX_LINE_CHARACTERS)
        if not text:
            return
        self.last_lines.append(text)
        if self._shows_output:
            self._runner.log(f"    {text}")


class BuildFailedError(CalibrationError):
    """A step of the Dockerfile failed: the verdict is fail (exit code 1)."""

    exit_code = ExitCode.FAIL

    def __init__(self, name: str, step: str, problem: str, lines: Sequence[str] = ()) -> None:
        """Create the error.

        Args:
            name: name of the image.
            step: ``step 3 of 7, RUN make``; empty before the first step.
            problem: ``exit code 2``, or the builder's message.
            lines: last lines of the step's output.
        """
        self.headline = f"image {name}: {shorten(one_line(step), 200)}{': ' if step else ''}{one_line(problem)}"
        self.lines = tuple(lines)
        super().__init__(one_line(self.headline + _quote_errors(self.lines)))


_ERROR_LINE = re.compile(r"(^|[\s:(])(error|fatal|e|err!)[:! ]|error: |^traceback ", re.IGNORECASE)
"""A line that states an error, of compilers, CMake, make, pip, apt, npm and Python."""


def _quote_errors(lines: Sequence[str]) -> str:
    """Quote the last line of a step, and the first one that states an error: what follows it is often a consequence."""
    if not lines:
        return ""
    error = next((line for line in lines if _ERROR_LINE.search(line)), lines[-1])
    first = "" if error == lines[-1] else f"; its first error: {shorten(error, 200)}"
    return f"{first}; its last line: {shorten(lines[-1], 200)}"


_INFRASTRUCTURE = re.compile(
    r"no space left on device|failed to create endpoint|connection refused|connection reset|i/o timeout|no such host"
    r"|tls handshake|too ?many ?requests|context deadline|temporary failure|unreachable|bad gateway"
    r"|cannot connect to the docker daemon|error during connect|shutting down|service unavailable|unexpected eof",
    re.IGNORECASE,
)
_MISSING_BASE = re.compile(
    r"manifest unknown|pull access denied|repository does not exist|manifest for \S+ not found"
    r"|failed to resolve source metadata .*(not found|denied|authorization failed)",
    re.IGNORECASE,
)
_EXIT_CODE_ONLY = re.compile(r"^exit code \d+$")


def build_problem(name: str, step: str, message: str, log: BuildLog) -> CalibrationError:
    """Return the error of a failed build.

    Args:
        name: name of the image.
        step: current step; empty before the first one.
        message: ``exit code 3``, or the builder's message.
        log: has the last lines of the step.

    Returns:
        InputError for a missing base, InfrastructureError for a failed infrastructure, else BuildFailedError.
    """
    log.end_line()
    message = shorten(log.clean(message), 400)
    if not _EXIT_CODE_ONLY.match(message):
        if _MISSING_BASE.search(message):
            return InputError(f"image {name}: a base image is missing: {message}: check its name, or log in")
        if _INFRASTRUCTURE.search(message):
            return InfrastructureError(f"image {name}: the build broke off: {message}")
    return BuildFailedError(name, step, message, tuple(log.last_lines))


@dataclass(frozen=True)
class BuildRequest:
    """Parameters of a build."""

    name: str
    """Name of the image, for messages."""
    context: Context
    dockerfile: str
    """Path of the Dockerfile in the context."""
    labels: Mapping[str, str] = field(default_factory=dict)
    build_arguments: Mapping[str, str] = field(default_factory=dict)
    target: str | None = None
    platforms: Sequence[str] = ()
    secrets: Sequence[SecretValue] = ()
    ssh: bool = False
    no_cache: bool = False
    attest: bool = False
    """Whether BuildKit makes an SBOM and a provenance."""
