"""Log of a build: its steps and their output."""

from collections import deque
from collections.abc import Iterable, Sequence

from calibration.base.redaction import redact
from calibration.base.text import one_line, shorten, without_escapes
from calibration.ci.workflow import Runner
from calibration.ci.workflow.progress import Advance

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
