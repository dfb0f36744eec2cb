import os
import signal
import threading

import pytest

from calibration.workflow.signals import Terminated, terminate_cleanly


def be_stopped(first: signal.Signals, second: signal.Signals, cleaned: list[bool]) -> None:
    """Send a signal to this process, and another to it while it cleans up."""
    with terminate_cleanly():
        try:
            os.kill(os.getpid(), first)
        finally:
            os.kill(os.getpid(), second)
            cleaned.append(True)


def test_sigterm_lets_finally_run_and_later_ones_do_not_disturb_it() -> None:
    before = signal.getsignal(signal.SIGTERM)
    cleaned: list[bool] = []
    with pytest.raises(Terminated):
        be_stopped(signal.SIGTERM, signal.SIGTERM, cleaned)
    assert cleaned
    assert signal.getsignal(signal.SIGTERM) is before


def test_sigterm_does_not_disturb_the_cleaning_after_sigint() -> None:
    cleaned: list[bool] = []
    with pytest.raises(KeyboardInterrupt) as caught:
        be_stopped(signal.SIGINT, signal.SIGTERM, cleaned)
    assert cleaned
    assert not isinstance(caught.value, Terminated)


def test_a_second_sigint_interrupts_again() -> None:
    cleaned: list[bool] = []
    with pytest.raises(KeyboardInterrupt):
        be_stopped(signal.SIGINT, signal.SIGINT, cleaned)
    assert not cleaned


def test_an_ignored_sigint_stays_ignored() -> None:
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with terminate_cleanly():
            os.kill(os.getpid(), signal.SIGINT)
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def test_in_another_thread_nothing_is_done() -> None:
    done = []

    def work() -> None:
        with terminate_cleanly():
            done.append(True)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert done == [True]
