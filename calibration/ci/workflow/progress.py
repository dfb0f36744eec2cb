"""Progress of long work: a bar on a terminal, plain lines in a log."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager

from calibration.base.errors import InputError
from calibration.base.text import one_line
from calibration.ci.workflow.advance import Advance
from calibration.ci.workflow.runner import Runner

LINES = 40
"""Limit of lines in a log: with more steps, only every n-th step and those worth a message get a line."""


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
    with _shown(runner, title, bar) as show:

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


def _shown(runner: Runner, title: str, bar: bool) -> AbstractContextManager[Advance]:
    if not bar or runner.github or not runner.stdout.isatty():
        return _lines(runner)
    from calibration.ci.workflow import progress_bar  # imports rich, which is slow

    return progress_bar.bar(runner, title)


@contextmanager
def _lines(runner: Runner) -> Iterator[Advance]:
    def advance(done: int, total: int, line: str, *, important: bool = False) -> None:
        every = -(-total // LINES)
        if important or done % every == 0 or done == total:
            runner.log(f"[{done:>{len(str(total))}}/{total}] {one_line(line)}")

    yield advance
