import threading
import time

import pytest

from calibration.execution.admission import Admission, Need
from calibration.execution.job import Container, Job, Limits

GIB = 1024**3


def job(*limits: Limits) -> Job:
    return Job("j", tuple(Container(str(i), "i", limits=limit) for i, limit in enumerate(limits)))


@pytest.mark.parametrize(
    ("needing", "need"),
    [
        (job(Limits()), Need(1, 0)),
        (job(Limits(), Limits()), Need(1, 0)),
        (job(Limits(cpus=0.5, memory=GIB), Limits(cpus=1.5), Limits()), Need(2, GIB)),
    ],
)
def test_what_a_job_takes(needing: Job, need: Need) -> None:
    assert Need.of(needing) == need


def most_at_once(needs: list[Need], cores: float, memory: int, workers: int | None) -> tuple[list[int], int]:
    """Run jobs of no time in threads; return the order in which they began, and how many there were at once."""
    admission = Admission(needs, cores, memory, workers)
    lock = threading.Lock()
    order: list[int] = []
    at_once: list[int] = []
    running = 0

    def work() -> None:
        nonlocal running
        while (index := admission.wait()) is not None:
            with lock:
                running += 1
                order.append(index)
                at_once.append(running)
            time.sleep(0.02)
            with lock:
                running -= 1
            admission.release(index)

    threads = [threading.Thread(target=work) for _ in needs]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(20)
    return order, max(at_once)


@pytest.mark.parametrize(
    ("need", "cores", "memory", "workers", "expected"),
    [
        (Need(1, 0), 2, 8 * GIB, None, 2),
        (Need(0.5, 0), 2, 8 * GIB, None, 4),
        (Need(1, 0), 2, 8 * GIB, 5, 5),  # asked for: the cores are the user's own business
        (Need(1, 3 * GIB), 8, 8 * GIB, None, 2),
        (Need(1, 3 * GIB), 8, 8 * GIB, 5, 2),  # memory is nobody's to overrule
        (Need(1, 3 * GIB), 8, 0, None, 6),  # an engine that does not say what it has
        (Need(4, 9 * GIB), 2, 8 * GIB, None, 1),  # larger than the machine: alone
        (Need(1, 0), 2, 8 * GIB, 1, 1),
    ],
)
def test_as_many_at_once_as_fit(need: Need, cores: float, memory: int, workers: int | None, expected: int) -> None:
    order, most = most_at_once([need] * 6, cores, memory, workers)
    assert sorted(order) == list(range(6))
    assert most == expected


def test_no_job_overtakes_another() -> None:
    admission = Admission([Need(1, 0), Need(2, 0), Need(1, 0)], 2, 0)
    assert admission.wait() == 0
    begun: list[int | None] = []
    waiting = threading.Thread(target=lambda: begun.append(admission.wait()))
    waiting.start()
    time.sleep(0.05)
    assert begun == []  # job 2 would fit, but is not next
    admission.release(0)
    waiting.join(5)
    assert begun == [1]


def test_stopped() -> None:
    admission = Admission([Need(1, 0)] * 3, 1, 0)
    assert admission.wait() == 0
    begun: list[int | None] = []
    waiting = threading.Thread(target=lambda: begun.append(admission.wait()))
    waiting.start()
    admission.stop()
    waiting.join(5)
    assert begun == [None]
    assert admission.wait() is None
