"""What a build says, as it says it: its steps, and the output of each."""

import re
from collections import deque
from collections.abc import Iterable, Sequence

from calibration.workflow import Runner, redact
from calibration.workflow.progress import Advance
from calibration.workflow.text import one_line, shorten

_COLOURS = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")
LAST_LINES = 20
LONGEST = 500
"""Characters of a line that is shown."""


class BuildLog:
    """Shows a build, without secrets, and remembers the step that it is at."""

    def __init__(self, runner: Runner, advance: Advance, secrets: Sequence[str] = ()) -> None:
        self._runner = runner
        self._advance = advance
        self._secrets = secrets
        self._shows_output = runner.github or not runner.stdout.isatty()  # a terminal has a bar of the steps
        self._part = ""
        self.step_name = ""
        self.last_lines: deque[str] = deque(maxlen=LAST_LINES)

    def step(self, number: int, total: int, instruction: str) -> None:
        """Say that a step begins."""
        self.end_line()
        self.last_lines.clear()
        instruction = " ".join(self.clean(instruction).split())
        self.step_name = f"step {number} of {total}, {instruction}"
        self._advance(number, total, shorten(instruction, 160), important=True)

    def output(self, text: str) -> None:
        """Show what the step says; a line is shown when it is complete."""
        *lines, self._part = (self._part + text).split("\n")
        for line in lines:
            self._line(line)
        if len(self._part) > 100 * LONGEST:  # a line that never ends is not kept for ever
            self.end_line()

    def end_line(self) -> None:
        """Show a line that has no end yet."""
        if self._part:
            self._line(self._part)
        self._part = ""

    def remember(self, lines: Iterable[str]) -> None:
        """Let these be the last lines, where steps run at once and their lines are mixed."""
        self.end_line()
        self.last_lines.clear()
        self.last_lines.extend(shorten(line, LONGEST) for line in map(self.clean, lines) if line)

    def clean(self, text: str) -> str:
        """A text without secrets, on one line."""
        return one_line(redact(_COLOURS.sub("", text), self._secrets))

    def _line(self, text: str) -> None:
        text = text.rstrip("\r").rpartition("\r")[2]  # progress that is drawn over itself: as it ended
        text = shorten(self.clean(text), LONGEST)
        if not text:
            return
        self.last_lines.append(text)
        if self._shows_output:
            self._runner.log(f"    {text}")
