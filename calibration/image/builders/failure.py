"""A build that failed because of what was to be built."""

from collections.abc import Sequence

from calibration.errors import CalibrationError, ExitCode
from calibration.workflow.text import one_line, shorten


class BuildFailedError(CalibrationError):
    """A step of the Dockerfile failed: the verdict on it is fail (exit code 1)."""

    exit_code = ExitCode.FAIL

    def __init__(self, name: str, step: str, problem: str, lines: Sequence[str] = ()) -> None:
        """Make the error.

        Args:
            name: of the image.
            step: ``step 3 of 7, RUN make``, or where there is none, nothing.
            problem: ``exit code 2``, or the builder's own words.
            lines: the last of the step's output.
        """
        self.headline = f"image {name}: {shorten(one_line(step), 200)}{': ' if step else ''}{one_line(problem)}"
        self.lines = tuple(lines)
        last = f"; its last line: {shorten(self.lines[-1], 200)}" if self.lines else ""
        super().__init__(one_line(self.headline + last))
