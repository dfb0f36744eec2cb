"""Progress of long work: a bar on a terminal, plain lines in a log."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from calibration.workflow.runner import Runner
from calibration.workflow.text import one_line

LINES = 40
"""Limit of lines in a log: with more steps, only every n-th step and those worth a message get a line."""


class Advance(Protocol):
    """Called after each step."""

    def __call__(self, done: int, total: int, line: str, *, important: bool = False) -> None:
        """Report the number of finished steps, and a message about the last one, which may contain untrusted text."""


@contextmanager
def progress(runner: Runner, title: str, bar: bool = True, kept: str = "") -> Iterator[Advance]:
    """Show the progress of steps during the block.

    Args:
        runner: runner whose log shows it.
        title: title of the bar.
        bar: whether a bar may be shown on a terminal; False if other lines are printed in between.
        kept: plural of the steps ("poses") if an interruption preserves them: then their number is printed.
    """
    finished = 0
    with _bar(runner, title) if bar and not runner.github and runner.stdout.isatty() else _lines(runner) as show:

        def advance(done: int, total: int, line: str, *, important: bool = False) -> None:
            nonlocal finished
            finished = done
            show(done, total, line, important=important)

        try:
            yield advance
        except BaseException:
            if kept and finished:
                runner.log(f"{finished} {kept} are done: the same command goes on from there")
            raise


@contextmanager
def _lines(runner: Runner) -> Iterator[Advance]:
    def advance(done: int, total: int, line: str, *, important: bool = False) -> None:
        every = -(-total // LINES)
        if important or done % every == 0 or done == total:
            runner.log(f"[{done:>{len(str(total))}}/{total}] {one_line(line)}")

    yield advance


@contextmanager
def _bar(runner: Runner, title: str) -> Iterator[Advance]:
    from rich import console as consoles  # slow to import
    from rich import progress as bars

    console = consoles.Console(file=runner.stdout)
    text = bars.TextColumn("{task.description}")
    columns = (text, bars.BarColumn(), bars.MofNCompleteColumn(), bars.TimeRemainingColumn())
    # no monitor thread, so that the steps may fork
    with bars.Progress(*columns, console=console, transient=True, auto_refresh=False) as bar:
        task = bar.add_task(title, total=None)

        def advance(done: int, total: int, line: str, *, important: bool = False) -> None:
            bar.update(task, completed=done, total=total, refresh=True)
            if important:
                console.print(one_line(line), markup=False, highlight=False)

        yield advance
