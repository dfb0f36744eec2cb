"""Functions in processes: each is called once, errors and deaths are reported, no process is left."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Iterable
from functools import partial
from itertools import groupby
from types import SimpleNamespace
from typing import TypeVar

import cv2
import pytest

from calibration.base import InfrastructureError, InputError
from calibration.ci.execution import tasks
from calibration.ci.execution.tasks import Embedded

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_parallel(
    function: Callable[[Item], Result], items: Iterable[Item], workers: int
) -> Generator[tuple[int, Result]]:
    return Embedded().run([partial(function, item) for item in items], workers=workers)


def threads_of_opencv(_: int) -> int:
    return int(cv2.getNumThreads())


def test_workers_are_forked_with_one_thread_of_opencv() -> None:
    """OpenCV 5 waits for ever for the threads that a fork has not inherited."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(2)
    try:
        assert [threads for _, threads in in_parallel(threads_of_opencv, range(4), 2)] == [1] * 4
        assert cv2.getNumThreads() == 2
    finally:
        cv2.setNumThreads(before)


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_every_function_once_whatever_the_number_of_processes(workers: int) -> None:
    offset = 10  # workers inherit the closure
    found = dict(in_parallel(lambda item: item + offset, range(57), workers))
    assert found == {i: i + 10 for i in range(57)}


def test_quick_functions_are_sent_several_at_once() -> None:
    """Those of one batch are called one after the other, so results of one process follow each other."""
    pids = [pid for _, pid in in_parallel(lambda _: os.getpid(), range(400), 2)]
    assert max(len(list(group)) for _, group in groupby(pids)) >= 8


@pytest.mark.parametrize(("finished", "seconds", "batch"), [(0, 1.0, 1), (10, 1.0, 1), (100, 0.2, 7), (900, 0.2, 16)])
def test_the_size_of_a_batch_follows_the_pace(
    monkeypatch: pytest.MonkeyPatch, finished: int, seconds: float, batch: int
) -> None:
    now = iter([5.0, 5.0 + seconds])
    monkeypatch.setattr(tasks, "time", SimpleNamespace(monotonic=lambda: next(now)))
    pace = tasks._Pace(2)
    pace.finished = finished
    assert pace.batch_size() == batch


def test_the_pace_counts_functions_not_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    paces = []

    class Kept(tasks._Pace):
        """Of which we know."""

        def __init__(self, workers: int) -> None:
            super().__init__(workers)
            paces.append(self)

    monkeypatch.setattr(tasks, "_Pace", Kept)
    assert len(list(in_parallel(str, range(400), 2))) == 400
    assert [pace.finished for pace in paces] == [400]


def test_an_error_in_a_batch_reaches_the_caller() -> None:
    def refuse(item: int) -> int:
        if item == 390:
            raise InputError("planted")
        return item

    found = []
    with pytest.raises(InputError, match="planted"):
        found.extend(in_parallel(refuse, range(400), 2))


def test_nothing_to_do() -> None:
    assert list(Embedded().run([])) == []


def test_one_worker_is_this_process() -> None:
    assert {pid for _, pid in in_parallel(lambda _: os.getpid(), range(3), 1)} == {os.getpid()}
    assert os.getpid() not in {pid for _, pid in in_parallel(lambda _: os.getpid(), range(3), 2)}


def test_an_error_reaches_the_caller() -> None:
    def refuse(item: int) -> int:
        if item == 3:
            raise InputError("planted")
        return item

    with pytest.raises(InputError, match="planted"):
        list(in_parallel(refuse, range(8), 2))


def test_the_death_of_a_process_is_reported() -> None:
    with pytest.raises(InfrastructureError, match="worker process died"):
        list(in_parallel(lambda _: os.kill(os.getpid(), signal.SIGKILL), range(2), 2))


def test_who_stops_early_leaves_no_process() -> None:
    results = in_parallel(lambda _: os.getpid(), range(100), 2)
    _, pid = next(results)
    results.close()
    for _ in range(100):
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return
        time.sleep(0.05)
    pytest.fail("a worker is left")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_a_worker_is_forked_is_not_lost(number: signal.Signals) -> None:
    program = f"""
import os, signal
from calibration.ci.execution.tasks import Embedded
from calibration.base.process import terminate_cleanly
asked = []
def ask():
    if not asked:
        asked.append(1)
        os.kill(os.getpid(), {int(number)})
os.register_at_fork(before=ask)
try:
    with terminate_cleanly():
        print(len(list(Embedded().run([str] * 1000, workers=2))))
except KeyboardInterrupt as error:
    print(type(error).__name__)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == ("Terminated" if number == signal.SIGTERM else "KeyboardInterrupt")
    assert done.stderr == ""
