"""Leftovers of runs in AWS Batch: unfinished jobs, and old revisions of job definitions."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from calibration.addons.aws_batch.session import Aws
from calibration.addons.aws_batch.settings import AWS_BATCH
from calibration.addons.aws_batch.submitting import CloudLeftover, deregister, find_in_queue, find_old, terminate
from calibration.ci.execution.backends import Left, Leftovers, read_sections
from calibration.ci.execution.docker.labels import Owner


class _InAws(Leftovers[Left]):
    def __init__(self, region: str, queue: str) -> None:
        self._aws = Aws(region)
        self._queue = queue

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._aws.close()


class QueuedJobs(_InAws[CloudLeftover]):
    """Unfinished jobs and arrays in a queue, to be terminated."""

    header = ("job", "name", "run", "jobs", "state")

    def find(self, run: str | None) -> Sequence[CloudLeftover]:
        """Find those of a run, or of all runs."""
        return find_in_queue(self._aws, self._queue, run)

    def remove(self, chosen: Sequence[CloudLeftover]) -> None:
        """Terminate them."""
        terminate(self._aws, [each.id for each in chosen], "calibration cleanup")

    def summary(self, chosen: Sequence[CloudLeftover], dry_run: bool) -> str:
        """Return the number of terminated jobs, as a sentence."""
        many = "s" * (len(chosen) != 1)
        count = f"{len(chosen)} job{many} or array{many}" if chosen else "nothing"
        return f"{count} in AWS Batch {'would be ended' if dry_run else 'ended'}"


@dataclass(frozen=True)
class OldRevision:
    """A revision of a job definition other than the latest, which no run uses."""

    arn: str
    owner: Owner | None = None

    @property
    def row(self) -> tuple[str, ...]:
        """Cells of its row in the table: its ARN."""
        return (self.arn,)


class OldRevisions(_InAws[OldRevision]):
    """Old revisions of our job definitions, to be deregistered."""

    header = ("job definition",)

    def find(self, run: str | None) -> Sequence[OldRevision]:
        """Find old revisions; all runs share job definitions, so ``run`` is ignored."""
        return [OldRevision(arn) for arn in find_old(self._aws)]

    def remove(self, chosen: Sequence[OldRevision]) -> None:
        """Deregister them."""
        deregister(self._aws, [each.arn for each in chosen])

    def summary(self, chosen: Sequence[OldRevision], dry_run: bool) -> str:
        """Return the number of deregistered revisions, as a sentence."""
        count = f"{len(chosen)} old revision{'s' * (len(chosen) != 1)}" if chosen else "nothing"
        return f"{count} {'would be deregistered' if dry_run else 'deregistered'}"


def open_leftovers(config: Path, queue: str | None, region: str | None, definitions: bool) -> QueuedJobs | OldRevisions:
    """Return the leftovers in a queue, or the old job definitions of a region.

    Args:
        config: file with the section of AWS Batch, for missing arguments.
        queue: job queue.
        region: region of the queue.
        definitions: whether to return job definitions instead of jobs.

    Raises:
        InputError: the file or its section is missing or wrong.
    """
    if not region or not (queue or definitions):
        settings = read_sections(AWS_BATCH, config).of(AWS_BATCH)
        region, queue = region or settings.region, queue or settings.queue
    return OldRevisions(region, "") if definitions else QueuedJobs(region, str(queue))
