"""Verdict of a job from the ends of its containers."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base import ExitCode, one_line
from calibration.ci.execution.job import Container, Job, Limits, Readiness
from calibration.ci.execution.outcome import End
from calibration.ci.execution.supervision import Judge, failure_of, how_it_ended, signal_of, unmet


@dataclass
class Fake:
    """A container in the form that the judging needs; by default it has exited with success."""

    container: Container
    end: End = End.EXITED
    exit_code: int | None = 0
    signal: str | None = None
    started: float | None = field(default_factory=time.monotonic)
    ended: float | None = 1.0
    ready: bool = True
    last_line: str = ""

    def not_ready_for(self) -> str:
        return "port 1"


def of(name: str = "a", **settings: object) -> Container:
    return Container(name, "i", **settings)  # type: ignore[arg-type]


def judged(*containers: Fake, waiting: Sequence[Fake] = (), **settings: float) -> Judge:
    judge = Judge(Job("j", tuple(each.container for each in containers), **settings), one_line)  # type: ignore[arg-type]
    assert judge.is_over(containers, waiting)
    judge.stop(containers)
    judge.judge(containers)
    return judge


@pytest.mark.parametrize(
    ("memory", "code", "out_of_memory", "ours", "end"),
    [
        (None, 0, False, None, (End.EXITED, None)),
        (None, 7, False, None, (End.EXITED, None)),
        (None, 0, True, None, (End.OUT_OF_MEMORY, None)),
        (1, 137, False, None, (End.OUT_OF_MEMORY, "SIGKILL")),
        (None, 137, False, None, (End.SIGNALLED, "SIGKILL")),
        (1, 139, False, None, (End.SIGNALLED, "SIGSEGV")),
        (1, 137, False, End.STOPPED, (End.STOPPED, "SIGKILL")),
        (1, 137, True, End.STOPPED, (End.OUT_OF_MEMORY, "SIGKILL")),
        (1, 143, False, End.TIMED_OUT, (End.TIMED_OUT, "SIGTERM")),
        (None, 255, False, None, (End.EXITED, None)),
    ],
)
def test_how_a_container_ended(
    memory: int | None, code: int, out_of_memory: bool, ours: End | None, end: tuple[End, str | None]
) -> None:
    assert how_it_ended(of(limits=Limits(memory=memory)), code, out_of_memory, ours) == end


def test_a_code_that_is_a_success_is_no_signal() -> None:
    assert how_it_ended(of(success=(137,)), 137, False, None) == (End.EXITED, None)
    assert (signal_of(128), signal_of(130), signal_of(255)) == (None, "SIGINT", None)


@pytest.mark.parametrize(
    ("fake", "failure"),
    [
        (Fake(of()), None),
        (Fake(of(), End.STOPPED, 143), None),
        (Fake(of(), exit_code=1, last_line="boom"), "container 'a' ended with exit code 1: boom"),
        (Fake(of(), exit_code=127), "container 'a' ended with exit code 127 (its command was not found)"),
        (Fake(of(success=())), "container 'a' ended with exit code 0, before the job was done"),
        (Fake(of(), End.SIGNALLED, 139, "SIGSEGV"), "container 'a' was killed by SIGSEGV"),
        (Fake(of(), End.OUT_OF_MEMORY, 137), "container 'a' ran out of memory: the machine had no free memory"),
        (
            Fake(of(limits=Limits(memory=2**20)), End.OUT_OF_MEMORY, 137),
            "container 'a' ran out of memory: its limit is 1 MiB (memory)",
        ),
        (Fake(of(), End.LOST, None), "container 'a' ended without an exit code: it was killed"),
    ],
)
def test_failure_messages(fake: Fake, failure: str | None) -> None:
    assert failure_of(fake.container, fake, fake.last_line) == failure


def test_unmet_conditions() -> None:
    readiness = Readiness(port=1, log="x+", file="/f", command=("a", "b"))
    assert unmet(readiness, {"port", "command"}, True) == "command a b, port 1"
    assert unmet(readiness, {"file"}, False) == "file /f, a line of its log with 'x+'"


def test_a_job_goes_on_while_nothing_essential_has_ended() -> None:
    helper, main = Fake(of("h", essential=False)), Fake(of("m", limits=Limits(seconds=9)), ended=None)
    judge = Judge(Job("j", (helper.container, main.container), seconds=50), one_line)
    assert not judge.is_over([helper, main], [])
    assert [round(seconds) for seconds in judge.seconds_left([helper, main])] == [50, 9]
    judge.stop([helper, main])
    assert judge.stopped_for == {"m": End.STOPPED}


def test_limits_that_count() -> None:
    ready = Readiness(port=1, seconds=5)
    unready = Fake(of(limits=Limits(seconds=9), readiness=ready), ended=None, ready=False)
    judge = Judge(Job("j", (unready.container,), seconds=None), one_line)
    assert [round(seconds) for seconds in judge.seconds_left([unready])] == [9, 5]
    unready.started, unready.last_line = time.monotonic() - 6, "waiting"
    assert judge.is_over([unready], [])
    assert (judge.reasons, judge.exit_code) == (
        ["container 'a' was not ready within 5 s (port 1): waiting"],
        ExitCode.FAIL,
    )
    late = Fake(of(limits=Limits(seconds=9)), started=time.monotonic() - 10, ended=None, last_line="begun")
    judge = Judge(Job("j", (late.container,), seconds=None), one_line)
    assert judge.is_over([late], [])
    assert (judge.reasons, judge.exit_code) == (
        ["container 'a' ran longer than its 9 s: begun"],
        ExitCode.INFRASTRUCTURE,
    )


def test_one_that_others_wait_for_ended_too_early() -> None:
    server, client = Fake(of("s", essential=False), ready=False), Fake(of("c", after=("s",)), End.NOT_STARTED, None)
    client.started = client.ended = None
    judge = judged(server, client, waiting=[client])
    assert judge.reasons == ["container 's' ended with exit code 0; it was not ready yet (port 1)"]


def test_reasons_are_cleaned() -> None:
    assert judged(Fake(of(), exit_code=1, last_line="a\nb")).reasons == ["container 'a' ended with exit code 1: a b"]


FAKES = st.lists(
    st.builds(
        lambda essential, success, end, code: Fake(
            of(essential=essential, success=success), end, None if end in (End.NOT_STARTED, End.LOST) else code
        ),
        st.booleans(),
        st.sampled_from([(0,), (), (0, 3)]),
        st.sampled_from([End.EXITED, End.SIGNALLED, End.OUT_OF_MEMORY, End.STOPPED, End.NOT_STARTED, End.LOST]),
        st.sampled_from([0, 1, 3, 137]),
    ),
    min_size=1,
    max_size=4,
)


@given(FAKES)
def test_a_pass_is_an_essential_container_that_ended_well_and_none_that_did_not(fakes: list[Fake]) -> None:
    essential = [fake for fake in fakes if fake.container.essential]
    judge = Judge(Job("j", tuple(fake.container for fake in fakes)), one_line)
    if not any(fake.end not in (End.STOPPED, End.NOT_STARTED) for fake in essential):
        return  # the job has not ended
    judge.judge(fakes)
    well = [fake.end == End.EXITED and fake.exit_code in fake.container.success for fake in essential]
    passed = any(well) and all(ok or fake.end == End.STOPPED for ok, fake in zip(well, essential, strict=True))
    assert (judge.exit_code == ExitCode.PASS) == passed == (not judge.reasons)
