"""Progress of long work: a bar on a terminal, plain lines in a log."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol

from calibration.base.errors import InputError
from calibration.base.text import one_line
from calibration.ci.workflow.runner import Runner

MAX_LOG_LINES = 40
"""Limit of lines in a log: with more steps, only every n-th step and those worth a message get a line."""


class Advance(Protocol):
    """Call by which work reports its progress, after each step."""

    def __call__(self, done: int, total: int, line: str, *, important: bool = False) -> None:
        """Report the number of finished steps, and a message about the last one, which may contain untrusted text."""


@contextmanager
def progress(runner: Runner, title: str, bar: bool = True, kept: str = "") -> Iterator[Advance]:
    """Show the progress of steps during the block.

    Args:
        runner: runner whose log shows it.
        title: title of the bar.
        bar: whether a bar may be shown on a terminal; False if other lines are printed in between.
        kept: plural of the steps ("poses") if an interruption preserves them: then their number is printed, but not
            after bad input, which the same command would find again.
    """
    finished = 0
    with _show_progress(runner, title, bar) as show:

        def advance(done: int, total: int, line: str, *, important: bool = False) -> None:
            nonlocal finished
            finished = done
            show(done, total, line, important=important)

        try:
            yield advance
        except InputError:
            raise
        except BaseException:
            if kept and finished:
                runner.log(f"{finished} {kept} are done: the same command goes on from there")
            raise


def _show_progress(runner: Runner, title: str, bar: bool) -> AbstractContextManager[Advance]:
    return _show_bar(runner, title) if bar and runner.on_terminal else _show_lines(runner)


@contextmanager
def _show_lines(runner: Runner) -> Iterator[Advance]:
    def advance(done: int, total: int, line: str, *, important: bool = False) -> None:
        every = -(-total // MAX_LOG_LINES)
        if important or done % every == 0 or done == total:
            runner.log(f"[{done:>{len(str(total))}}/{total}] {one_line(line)}")

    yield advance


@contextmanager
def _show_bar(runner: Runner, title: str) -> Iterator[Advance]:
    """Show a bar during the block, and important messages above it."""
    # Here, as rich is slow to import, and a log needs none of it.
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(file=runner.stdout)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    # no monitor thread, so that the steps may fork
    with Progress(*columns, console=console, transient=True, auto_refresh=False) as shown:
        task = shown.add_task(title, total=None)

        def advance(done: int, total: int, line: str, *, important: bool = False) -> None:
            shown.update(task, completed=done, total=total, refresh=True)
            if important:
                console.print(one_line(line), markup=False, highlight=False)

        yield advance
