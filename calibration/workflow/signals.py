"""The runner's cancel: SIGINT, then SIGTERM, then the end."""

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

ENDING = (signal.SIGINT, signal.SIGTERM)
_SOON = 0.001
"""Seconds until a signal whose exception Python has dropped strikes again."""


class Terminated(KeyboardInterrupt):
    """SIGTERM arrived. A kind of KeyboardInterrupt, so that whoever cleans up after that cleans up after both."""


@contextmanager
def terminate_cleanly() -> Iterator[None]:
    """Turn SIGTERM into :class:`Terminated`, so that context managers and ``finally`` stop what they started.

    Once one of SIGINT and SIGTERM has come, SIGTERM is ignored: GitHub sends it while the cleaning
    after SIGINT is still at work. A second SIGINT (an impatient user) interrupts again. Python drops an
    exception that is raised in a callback (of ``os.fork``, of the garbage collector): then the signal
    strikes again after the callback. Does nothing outside the main thread, where Python takes no signals.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number: int, _frame: FrameType | None) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        raise Terminated if number == signal.SIGTERM else KeyboardInterrupt

    def strike_again(dropped: Any) -> None:
        if not issubclass(dropped.exc_type, KeyboardInterrupt):
            report_dropped(dropped)
            return
        number = signal.SIGTERM if issubclass(dropped.exc_type, Terminated) else signal.SIGINT
        signal.signal(signal.SIGALRM, lambda _number, frame: stop(number, frame))
        signal.setitimer(signal.ITIMER_REAL, _SOON)

    report_dropped, sys.unraisablehook = sys.unraisablehook, strike_again
    before = {number: signal.getsignal(number) for number in (*ENDING, signal.SIGALRM)}
    signal.signal(signal.SIGTERM, stop)
    if before[signal.SIGINT] is not signal.SIG_IGN:  # ignored in a shell's background job: leave it so
        signal.signal(signal.SIGINT, stop)
    try:
        yield
    finally:
        sys.unraisablehook = report_dropped
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def held_back() -> Iterator[None]:
    """Hold SIGINT and SIGTERM back while a process is forked; they strike when the block is left.

    One that struck in the middle would leave a process behind that nobody knows, or be dropped by the
    callbacks of ``os.fork``. By handlers, not by the mask of this thread: a signal that another thread
    receives is handled in the main thread too, and a new process would inherit the mask.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    arrived: list[int] = []
    before = {number: signal.getsignal(number) for number in ENDING}
    for number, handler in before.items():
        if handler is not signal.SIG_IGN:
            signal.signal(number, lambda number, _frame: arrived.append(number))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if arrived:
            signal.raise_signal(arrived[0])
