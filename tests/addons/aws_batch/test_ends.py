"""Ends of containers as seen by the task, corrected by Batch's information."""

import pytest

from calibration.addons.aws_batch.following import Attempt, ContainerEnd, Description
from calibration.addons.aws_batch.results import ends_alone, why_no_outcome, with_ends
from calibration.addons.aws_batch.wire import PREPARE_CONTAINER, WATCH_CONTAINER, TaskOutcome
from calibration.base import ExitCode
from calibration.ci.execution.job import Job, Limits
from calibration.ci.execution.outcome import ContainerOutcome, End
from tests.addons.aws_batch.client import container

GONE = "container 'robot' ended without an exit code: it was killed"
OUT = "OutOfMemoryError: Container killed due to memory usage"
JOB = Job("one", (container(limits=Limits(memory=2**30)), container("sim", essential=False)))
NO_LIMIT = Job("one", (container(),))


def outcome(end: End, code: int | None, *reasons: str, sim: End = End.STOPPED) -> TaskOutcome:
    ends = (ContainerOutcome("robot", end, code), ContainerOutcome("sim", sim, None))
    return TaskOutcome("one", 1, ExitCode.FAIL if reasons else ExitCode.PASS, reasons, containers=ends)


def batch(name: str = "robot", code: int | None = None, reason: str = "") -> ContainerEnd:
    return ContainerEnd(name, code, reason, None)


OF_MEMORY = "container 'robot' ran out of memory: its limit is 1 GiB (memory)"


@pytest.mark.parametrize(
    ("found", "end", "lines", "reasons", "ended"),
    [
        (outcome(End.EXITED, 0), batch(code=0), {}, (), End.EXITED),
        (outcome(End.EXITED, 0), batch(code=0, reason=OUT), {}, (OF_MEMORY,), End.OUT_OF_MEMORY),
        (outcome(End.LOST, None, GONE), batch(code=137, reason=OUT), {}, (OF_MEMORY,), End.OUT_OF_MEMORY),
        (outcome(End.LOST, None, GONE), batch(code=137), {}, (OF_MEMORY,), End.OUT_OF_MEMORY),
        (outcome(End.LOST, None, GONE), batch(), {}, (GONE,), End.LOST),
        (outcome(End.LOST, None, GONE), batch(code=999), {}, (GONE,), End.LOST),
        (
            outcome(End.LOST, None, GONE),
            batch(code=139),
            {"robot": "last words"},
            ("container 'robot' was killed by SIGSEGV: last words",),
            End.SIGNALLED,
        ),
        (
            outcome(End.LOST, None, f"{GONE}; it was not ready yet (port 1 is closed)"),
            batch(code=3),
            {"robot": "last words"},
            ("container 'robot' ended with exit code 3; it was not ready yet (port 1 is closed)",),
            End.EXITED,
        ),
        (
            outcome(End.EXITED, 4, "container 'robot' ended with exit code 4"),
            batch(code=4),
            {"robot": "last words"},
            ("container 'robot' ended with exit code 4: last words",),
            End.EXITED,
        ),
        (
            outcome(End.EXITED, 4, "container 'robot' ended with exit code 4: its words"),
            batch("other", 1),
            {"robot": "last words"},
            ("container 'robot' ended with exit code 4: its words",),
            End.EXITED,
        ),
        (
            outcome(End.TIMED_OUT, 143, "the job ran longer"),
            batch(code=143),
            {},
            ("the job ran longer",),
            End.TIMED_OUT,
        ),
        (outcome(End.EXITED, 0), batch("sim", 137, OUT), {}, (), End.EXITED),
    ],
)
def test_reasons_are_those_of_any_backend(
    found: TaskOutcome, end: ContainerEnd, lines: dict[str, str], reasons: tuple[str, ...], ended: End
) -> None:
    merged = with_ends(found, JOB, [end], lines)
    assert merged.reasons == reasons
    assert merged.exit_code == (ExitCode.FAIL if reasons else ExitCode.PASS)
    assert merged.containers[0].end == ended


def test_failures_of_other_containers_are_added() -> None:
    found = outcome(End.EXITED, 4, "container 'robot' ended with exit code 4", sim=End.LOST)
    merged = with_ends(found, JOB, [batch("sim", 137, OUT)], {})
    assert merged.reasons == (
        "container 'robot' ended with exit code 4",
        "container 'sim' ran out of memory: the machine had no free memory",
    )


def test_ends_without_an_outcome_of_the_task() -> None:
    ends = ends_alone(JOB, [batch(code=3)])
    assert [(each.name, each.end, each.exit_code) for each in ends] == [
        ("robot", End.EXITED, 3),
        ("sim", End.LOST, None),
    ]


UNSET_UP = "ResourceInitializationError: no secret"
LOST = "Host EC2 (instance i-0abc) terminated."


def attempt(*ends: ContainerEnd, reason: str = "Essential container in task exited") -> Attempt:
    return Attempt(reason, 1, 2, ends)


def described(
    *attempts: Attempt, status: str = "FAILED", reason: str = "it ended", terminated: bool = False
) -> Description:
    return Description("x", status, reason, attempts, (), terminated)


@pytest.mark.parametrize(
    ("description", "given_up", "lines", "reason", "code"),
    [
        (described(terminated=True), "too late", {}, "too late", 3),
        (described(), "too late", {}, "too late", 3),
        (described(attempt(reason="x"), reason="too late"), "too late", {}, "too late", 3),
        (described(attempt(reason=LOST)), "too late", {}, f"its host was lost once, in 1 attempts: {LOST}", 3),
        (described(terminated=True), "", {}, "it was terminated by another process: it ended", 3),
        (
            described(attempt(reason=LOST), attempt(reason=LOST)),
            "",
            {},
            f"its host was lost 2 times, in 2 attempts: {LOST}",
            3,
        ),
        (described(attempt(), reason=""), "", {}, "AWS Batch reports a failure: it gives no reason", 3),
        (
            described(attempt(batch(code=1), batch(WATCH_CONTAINER, 137, OUT))),
            "",
            {},
            f"its results could not be uploaded: {OUT}",
            3,
        ),
        (
            described(attempt(batch(PREPARE_CONTAINER, 3))),
            "",
            {PREPARE_CONTAINER: "no bucket"},
            f"its inputs could not be downloaded: {PREPARE_CONTAINER} ended with exit code 3: no bucket",
            3,
        ),
        (
            described(attempt(batch(code=1), batch("sim", None, "odd"))),
            "",
            {},
            "AWS Batch reports a failure: it ended; robot: exit code 1; sim: odd",
            3,
        ),
        (
            described(reason="CannotPullContainerError: manifest unknown"),
            "",
            {},
            "an image cannot be pulled: CannotPullContainerError: manifest unknown",
            2,
        ),
        (
            described(attempt(batch(WATCH_CONTAINER, None, "CannotPullContainerError: denied"))),
            "",
            {},
            f"container '{WATCH_CONTAINER}': the image cannot be pulled: CannotPullContainerError: denied",
            3,
        ),
        (
            described(reason=UNSET_UP),
            "",
            {},
            f"its task could not be set up: check roles, secrets and network: {UNSET_UP}",
            3,
        ),
        (
            described(attempt(), reason="Job attempt duration exceeded timeout"),
            "",
            {},
            "AWS Batch has terminated it before our own limit of 3600 s did: Job attempt duration exceeded timeout",
            3,
        ),
        (
            described(attempt(), status="SUCCEEDED"),
            "",
            {},
            "AWS Batch reports success, but its task has left no outcome in S3",
            3,
        ),
    ],
)
def test_why_there_is_no_outcome(
    description: Description, given_up: str, lines: dict[str, str], reason: str, code: int
) -> None:
    why = why_no_outcome(NO_LIMIT, description, given_up, lines)
    assert (why.reason, why.exit_code) == (reason, code)
