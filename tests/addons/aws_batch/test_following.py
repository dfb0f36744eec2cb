"""Every end of a job is reported once, with few requests."""

import random
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.addons.aws_batch import following
from calibration.addons.aws_batch.following import JOBS_PER_CALL, Following, Submitted, batches
from tests.addons.aws_batch.client import wait_for
from tests.properties import at_most


class Batch:
    """Answers DescribeJobs for arrays whose children a test ends."""

    def __init__(self) -> None:
        self.states: dict[str, list[str]] = {}
        self.parents: dict[str, str] = {}
        self.calls = 0
        self.unknown: set[str] = set()
        self.late: set[str] = set()
        """Children that are reported with an outdated state."""

    def add(self, identifier: str, count: int) -> Submitted:
        self.states[identifier] = ["RUNNABLE"] * count
        return Submitted(identifier, 10, count, f"group-{identifier}")

    def describe_jobs(self, jobs: list[str]) -> dict[str, Any]:
        self.calls += 1
        assert 0 < len(jobs) <= JOBS_PER_CALL
        assert len(set(jobs)) == len(jobs)
        return {"jobs": [self._record(job) for job in jobs if job not in self.unknown]}

    def _record(self, job: str) -> dict[str, Any]:
        parent, colon, child = job.partition(":")
        states = self.states[parent]
        if colon:
            state = "RUNNING" if job in self.late else states[int(child)]
            return {"jobId": job, "status": state, "arrayProperties": {"index": int(child)}}
        if len(states) == 1:
            return {"jobId": job, "status": states[0]}
        summary = {state: states.count(state) for state in set(states)}
        ended = all(state in ("SUCCEEDED", "FAILED") for state in states)
        status = ("FAILED" if "FAILED" in states else "SUCCEEDED") if ended else "PENDING"
        return {"jobId": job, "status": status, "arrayProperties": {"statusSummary": summary, "size": len(states)}}


class FakeAws:
    def __init__(self) -> None:
        self.batch = Batch()


def setup(*counts: int) -> tuple[Following, Batch]:
    aws: Any = FakeAws()
    found = Following(aws)
    for number, count in enumerate(counts):
        found.add(aws.batch.add(f"job{number}", count))
    return found, aws.batch


@at_most(40)
@given(st.lists(st.integers(1, 350), min_size=1, max_size=3), st.integers(0, 2**32), st.integers(1, 300))
def test_each_end_is_reported_once_in_any_order(counts: list[int], seed: int, most: int) -> None:
    chance = random.Random(seed)
    found, batch = setup(*counts)
    waiting = [(job, child) for job, states in batch.states.items() for child in range(len(states))]
    chance.shuffle(waiting)
    total, told = len(waiting), []
    for _ in range(100_000):
        for _ in range(min(len(waiting), chance.randrange(0, 200))):
            job, child = waiting.pop()
            batch.states[job][child] = chance.choice(["SUCCEEDED", "FAILED"])
        poll = found.poll(most)
        told += [(end.group, end.index) for end in poll.ended]
        assert poll.queued_count + poll.running_count + len(told) <= total
        if not found.ids:
            break
    assert sorted(told) == sorted(
        (f"group-{job}", 10 + n) for job, states in batch.states.items() for n in range(len(states))
    )
    assert not list(found.left)


@pytest.mark.parametrize("in_order", [True, False])
def test_calls_are_bounded_whatever_the_order(in_order: bool) -> None:
    count = 4000
    found, batch = setup(count)
    order = list(range(count))
    if not in_order:
        random.Random(1).shuffle(order)
    polls = 0
    for some in batches(order, 50):
        for child in some:
            batch.states["job0"][child] = "SUCCEEDED"
        found.poll(1000)
        polls += 1
    while found.ids:
        found.poll(1000)
        polls += 1
    assert batch.calls <= (3 * polls + 2 * count / JOBS_PER_CALL if in_order else count)


def test_running_jobs_are_reported_if_there_are_few() -> None:
    found, batch = setup(3, 1)
    poll = found.poll()
    assert (poll.queued_count, poll.running_count, poll.running, poll.ended) == (4, 0, (), ())
    assert batch.calls == 1
    assert found.oldest == ("job0:0", "job0:1", "job0:2", "job1")
    batch.states["job0"][1] = batch.states["job1"][0] = "RUNNING"
    poll = found.poll()
    assert {(end.group, end.index) for end in poll.running} == {("group-job0", 11), ("group-job1", 10)}
    assert (poll.queued_count, poll.running_count) == (2, 2)


def test_jobs_that_batch_does_not_know_yet() -> None:
    found, batch = setup(2, 1)
    batch.unknown = {"job0", "job1"}
    assert found.poll().ended == ()
    batch.unknown = set()
    batch.states = {"job0": ["SUCCEEDED", "FAILED"], "job1": ["SUCCEEDED"]}
    assert len(found.poll().ended) == 3


def test_jobs_that_batch_has_forgotten_are_lost_after_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    found, batch = setup(3, 1)
    batch.states["job0"] = ["SUCCEEDED", "SUCCEEDED", "SUCCEEDED"]
    batch.unknown, batch.late = {"job0:1", "job1"}, {"job0:2"}
    assert [end.index for end in found.poll().ended] == [10]
    now = following.time.monotonic()
    monkeypatch.setattr(following.time, "monotonic", lambda: now + following._SETTLING_SECONDS - 1)
    assert found.poll().ended == ()
    monkeypatch.setattr(following.time, "monotonic", lambda: now + following._SETTLING_SECONDS + 1)
    ended = found.poll().ended
    assert [(end.group, end.index) for end in ended] == [("group-job0", 11), ("group-job0", 12), ("group-job1", 10)]
    assert {end.description.status_reason for end in ended} == {"AWS Batch does not know what became of it"}
    assert found.ids == ()
    assert not found.may_run("job0")


def test_jobs_beyond_the_limit_of_a_poll_are_not_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    found, batch = setup(500)
    batch.states["job0"] = ["SUCCEEDED"] * 500
    now = following.time.monotonic()
    told = 0
    for minute in range(20):
        monkeypatch.setattr(following.time, "monotonic", lambda minute=minute: now + 70 * minute)
        poll = found.poll(0 if minute % 2 else 50)
        assert all(end.description.status == "SUCCEEDED" for end in poll.ended)
        told += len(poll.ended)
    assert told == 500


def test_looks_are_rarer_the_longer_a_run_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    found, _ = setup(1)
    now = following.time.monotonic()
    delays = []
    for age in (0, 100, 1000, 100_000):
        monkeypatch.setattr(following.time, "monotonic", lambda age=age: now + age)
        delays.append(round(found.delay, 1))
    assert delays == [1.0, 2.0, 20.0, 30.0]


def test_workers() -> None:
    from calibration.addons.aws_batch.store import Workers, in_threads

    def numbers() -> Iterator[Callable[[], int]]:
        for number in range(50):
            yield lambda number=number: number * number

    assert sorted(in_threads(3, numbers(), ahead=5)) == [number * number for number in range(50)]
    crew: Workers[int] = Workers(3)
    assert crew.take(0.01) == []
    gate = threading.Event()
    crew.give(lambda: int(gate.wait(20)))
    assert crew.take(0.01) == []
    crew.give(lambda: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        crew.take(None)
    gate.set()
    assert crew.take(None) == [1]
    crew.stop()
    crew.join(5)
    wait_for(lambda: not any(thread.is_alive() for thread in crew._threads))


def test_patience(monkeypatch: pytest.MonkeyPatch) -> None:
    from calibration.addons.aws_batch import session
    from calibration.addons.aws_batch.session import AwsLostError

    monkeypatch.setattr(session, "_FIRST_DELAY", 0.0)
    answers = [AwsLostError("away"), AwsLostError("away"), 7]

    def ask() -> object:
        answer = answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    assert session.with_retries(ask) == 7
    answers[:] = [AwsLostError("away")]
    with pytest.raises(AwsLostError, match="away"):
        session.with_retries(ask, lambda: False)
    waited = session.Backoff(0.0)
    with pytest.raises(AwsLostError, match="gone"):
        waited.failed(AwsLostError("gone"))
    waited = session.Backoff(100.0)
    first = waited.failed(AwsLostError("away"))
    waited.answered()
    assert first == waited.failed(AwsLostError("away")) == 0.0
