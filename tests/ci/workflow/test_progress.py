"""Progress: lines in a log, a bar on a terminal."""

import io
from contextlib import suppress

import pytest

from calibration.base import InfrastructureError, InputError
from calibration.ci.github.service import GITHUB
from calibration.ci.workflow import Runner
from calibration.ci.workflow.streams import MAX_LOG_LINES, progress
from tests.ci.workflow.conftest import printed


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_log_gets_a_line_for_each_step(laptop: Runner) -> None:
    with progress(laptop, "calibrating") as advance:
        for done in (1, 2, 3):
            advance(done, 3, f"step {done}")

    assert printed(laptop).splitlines() == ["[1/3] step 1", "[2/3] step 2", "[3/3] step 3"]


def test_a_line_commands_neither_a_runner_nor_a_terminal(laptop: Runner) -> None:
    with progress(laptop, "calibrating") as advance:
        advance(1, 1, "a\n::error::pwned ##[error]no \x1b[31mred")

    assert printed(laptop) == "[1/1] a ::error::pwned ## [error]no \\x1b[31mred\n"


def test_a_long_run_gets_few_lines_and_what_is_important(laptop: Runner) -> None:
    with progress(laptop, "calibrating") as advance:
        for done in range(1, 1001):
            advance(done, 1000, f"step {done}", important=done == 7)

    lines = printed(laptop).splitlines()
    assert len(lines) == MAX_LOG_LINES + 1
    assert lines[0] == "[   7/1000] step 7"
    assert lines[-1] == "[1000/1000] step 1000"


def test_a_terminal_gets_a_bar_that_goes_away_and_what_is_important() -> None:
    terminal = Terminal()

    with progress(Runner(stdout=terminal), "calibrating") as advance:
        advance(1, 2, "fine")
        advance(2, 2, "[bold]failed[/bold]", important=True)

    shown = terminal.getvalue()
    assert "calibrating" in shown
    assert "[bold]failed[/bold]" in shown
    assert "fine" not in shown


def test_no_bar_on_a_runner_s_terminal() -> None:
    terminal = Terminal()

    with progress(Runner(GITHUB, stdout=terminal), "calibrating") as advance:
        advance(1, 1, "fine")

    assert terminal.getvalue() == "[1/1] fine\n"


def test_what_is_important_commands_no_terminal() -> None:
    terminal = Terminal()
    with progress(Runner(stdout=terminal), "calibrating") as advance:
        advance(1, 2, "a\n\x1b]0;title\x07b", important=True)

    assert "\\x1b]0;title\\x07b" in terminal.getvalue()
    assert "\x1b]0;" not in terminal.getvalue()


@pytest.mark.parametrize(
    "error", [InfrastructureError("the disk is full"), KeyboardInterrupt(), InputError("no board")]
)
def test_what_is_kept_of_stopped_work_is_counted_unless_its_input_is_wrong(
    laptop: Runner, error: BaseException
) -> None:
    with suppress(type(error)), progress(laptop, "calibrating", kept="poses") as advance:
        advance(2, 3, "fine")
        raise error

    said = "2 poses are done: the same command goes on from there" in printed(laptop)
    assert said is not isinstance(error, InputError)
