import os
import signal
import sys
import threading
import time

import pytest

from calibration.base.process import Terminated, held_back, terminate_cleanly


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


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_that_a_library_turns_into_an_error_is_still_the_signal(number: signal.Signals) -> None:
    def imported() -> None:
        with terminate_cleanly():
            try:
                os.kill(os.getpid(), number)
            except KeyboardInterrupt:
                raise ImportError("cannot be imported") from None

    with pytest.raises(KeyboardInterrupt) as caught:
        imported()
    assert isinstance(caught.value, Terminated) == (number == signal.SIGTERM)


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


class Dropping:
    """Python drops what is raised where an object is deleted."""

    def __del__(self) -> None:
        os.kill(os.getpid(), signal.SIGTERM)


def test_a_signal_whose_exception_is_dropped_strikes_again() -> None:
    def drop() -> None:
        with terminate_cleanly():
            Dropping()
            time.sleep(5)

    with pytest.raises(Terminated):
        drop()


def test_what_else_is_dropped_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    reported: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", lambda dropped: reported.append(dropped.exc_type))

    class Failing:
        def __del__(self) -> None:
            raise ValueError

    with terminate_cleanly():
        Failing()
    assert reported == [ValueError]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_that_is_held_back_strikes_afterwards(number: signal.Signals) -> None:
    done = []

    def work() -> None:
        with terminate_cleanly():
            with held_back():
                os.kill(os.getpid(), number)
                done.append("inside")
            done.append("after")

    with pytest.raises(KeyboardInterrupt) as caught:
        work()
    assert done == ["inside"]
    assert isinstance(caught.value, Terminated) == (number == signal.SIGTERM)
