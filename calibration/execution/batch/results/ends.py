"""How containers ended: what the task has seen, and what Batch knows better, such as that memory ran out."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from calibration.errors import ExitCode
from calibration.execution.batch.documents.outcome_document import TaskOutcome
from calibration.execution.batch.service.following import ContainerEnd
from calibration.execution.job import Container, Job
from calibration.execution.judging import failure_of, how_it_ended
from calibration.execution.outcome import ContainerOutcome, End

_OUT_OF_MEMORY = "OutOfMemory"
_LAST_CODE = 255


@dataclass(frozen=True)
class _Ended:
    """A container that has ended, as a judge sees it."""

    container: Container
    end: End
    exit_code: int | None
    signal: str | None
    last_line: str = ""
    ready: bool = True
    started: float | None = 0.0
    ended: float | None = 0.0

    def not_ready_for(self) -> str:
        raise AssertionError("nobody asks one that has ended")


def with_ends(
    outcome: TaskOutcome, job: Job, ends: Iterable[ContainerEnd], last_lines: Mapping[str, str]
) -> TaskOutcome:
    """Add to an outcome what its task could not see.

    A reason that the task gives for the end of a container has another in its place then, in the same words as
    any backend.

    Args:
        outcome: that the task has written.
        job: with the memory that its containers had.
        ends: what Batch says of the containers of that attempt.
        last_lines: of their logs, by name.
    """
    known = {end.name: end for end in ends}
    asked = {container.name: container for container in job.containers}
    reasons = list(outcome.reasons)
    containers = []
    for before in outcome.containers:
        container = asked[before.name]
        after = _known_better(before, container, known.get(before.name))
        containers.append(after)
        old, new = _failure(before, container), _failure(after, container)
        place = next((i for i, reason in enumerate(reasons) if old is not None and reason.startswith(old)), None)
        if new is not None and place is not None:
            rest = reasons[place].removeprefix(old or "")  # such as why it was not ready
            reasons[place] = f"{new}{rest}" if rest else _failure(after, container, last_lines) or new
        elif new is not None and after.end != before.end and (container.essential or reasons):
            reasons.append(_failure(after, container, last_lines) or new)
    failed = ExitCode.FAIL if reasons else ExitCode.PASS
    exit_code = outcome.exit_code if outcome.exit_code != ExitCode.PASS else failed
    return replace(outcome, exit_code=exit_code, reasons=tuple(reasons), containers=tuple(containers))


def ends_alone(job: Job, ends: Iterable[ContainerEnd]) -> tuple[ContainerOutcome, ...]:
    """How the containers of a job ended of which its task says nothing."""
    known = {end.name: end for end in ends}
    return tuple(
        _known_better(ContainerOutcome(container.name, End.LOST), container, known.get(container.name))
        for container in job.containers
    )


def _known_better(before: ContainerOutcome, container: Container, end: ContainerEnd | None) -> ContainerOutcome:
    if end is None:
        return before
    code = before.exit_code if before.exit_code is not None else _code(end)
    if end.reason.startswith(_OUT_OF_MEMORY):
        _, signal = how_it_ended(container, code or 0, True, None)
        return replace(before, end=End.OUT_OF_MEMORY, exit_code=code, signal=signal)
    if before.end != End.LOST or code is None:
        return before
    how, signal = how_it_ended(container, code, False, None)
    return replace(before, end=how, exit_code=code, signal=signal)


def _code(end: ContainerEnd) -> int | None:
    return end.exit_code if end.exit_code is not None and 0 <= end.exit_code <= _LAST_CODE else None


def _failure(
    outcome: ContainerOutcome, container: Container, last_lines: Mapping[str, str] | None = None
) -> str | None:
    last_line = (last_lines or {}).get(container.name, "")
    return failure_of(_Ended(container, outcome.end, outcome.exit_code, outcome.signal, last_line))
