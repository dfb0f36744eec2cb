import threading

import pytest

from calibration.ci.execution.docker.backend import Admission, Need
from calibration.ci.execution.job import Container, Job, Limits

GIB = 1024**3
LONG = 60.0
"""Seconds after which a waiting test fails."""


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
def test_resources_of_a_job(needing: Job, need: Need) -> None:
    assert Need.of(needing) == need


class Asking:
    """A thread that waits for one job."""

    def __init__(self, admission: Admission) -> None:
        self.found: list[int | None] = []
        self._thread = threading.Thread(target=lambda: self.found.append(admission.wait()), daemon=True)
        self._thread.start()

    def answer(self) -> int | None:
        """Wait for the job, and return it."""
        self._thread.join(LONG)
        [found] = self.found
        return found

    @property
    def waits(self) -> bool:
        """Whether it still waits; only a short check, because a bug would admit the job too early."""
        self._thread.join(0.05)
        return not self.found


@pytest.mark.parametrize(
    ("need", "cores", "memory", "workers", "expected"),
    [
        (Need(1, 0), 2, 8 * GIB, None, 2),
        (Need(0.5, 0), 2, 8 * GIB, None, 4),
        (Need(1, 0), 2, 8 * GIB, 5, 5),  # the user decides about cores
        (Need(1, 3 * GIB), 8, 8 * GIB, None, 2),
        (Need(1, 3 * GIB), 8, 8 * GIB, 5, 2),  # memory is always respected
        (Need(1, 3 * GIB), 8, 0, None, 6),  # an engine that does not report its resources
        (Need(4, 9 * GIB), 2, 8 * GIB, None, 1),  # larger than the machine: runs alone
        (Need(1, 0), 2, 8 * GIB, 1, 1),
    ],
)
def test_as_many_at_once_as_fit(need: Need, cores: float, memory: int, workers: int | None, expected: int) -> None:
    admission = Admission([need] * 6, cores, memory, workers)
    assert [Asking(admission).answer() for _ in range(expected)] == list(range(expected))
    for ended in range(6 - expected):  # one more starts for each that ends
        asking = Asking(admission)
        assert asking.waits
        admission.release(ended)
        assert asking.answer() == expected + ended
    assert admission.wait() is None


def test_no_job_overtakes_another() -> None:
    admission = Admission([Need(1, 0), Need(2, 0), Need(1, 0)], 2, 0)
    assert admission.wait() == 0
    asking = Asking(admission)
    assert asking.waits  # job 2 would fit, but is not next
    admission.release(0)
    assert asking.answer() == 1


def test_stopped() -> None:
    admission = Admission([Need(1, 0)] * 3, 1, 0)
    assert admission.wait() == 0
    asking = Asking(admission)
    admission.stop()
    assert asking.answer() is None
    assert admission.wait() is None
