"""Progress bar on a terminal; imported by `calibration.ci.workflow.progress` when needed, as rich is slow to import."""

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from calibration.base.text import one_line
from calibration.ci.workflow.advance import Advance
from calibration.ci.workflow.runner import Runner


@contextmanager
def bar(runner: Runner, title: str) -> Iterator[Advance]:
    """Show a bar during the block, and important messages above it."""
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
