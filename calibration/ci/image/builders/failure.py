"""Failures of builds: because of the Dockerfile, a missing base, or the infrastructure."""

import re
from collections.abc import Sequence

from calibration.base.errors import CalibrationError, ExitCode, InfrastructureError, InputError
from calibration.base.text import one_line, shorten
from calibration.ci.image.builders.build_log import BuildLog


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
