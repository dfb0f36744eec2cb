"""Backend that runs jobs as tasks of AWS Batch: submitted as arrays, polled, downloaded, and always ended.

Leftovers of killed runs are unfinished jobs, and old revisions of job definitions.
"""

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Self

from calibration.addons.aws_batch.checks import check_for_batch, check_queue, with_digests
from calibration.addons.aws_batch.definition import Usage, group_by_shape, shape_of, total_size
from calibration.addons.aws_batch.run import BatchRun
from calibration.addons.aws_batch.session import Aws
from calibration.addons.aws_batch.settings import AWS_BATCH, BatchSettings
from calibration.addons.aws_batch.store import CloudRun, Store
from calibration.addons.aws_batch.submitting import CloudLeftover, deregister, find_in_queue, find_old, terminate
from calibration.base import InputError, count_of
from calibration.ci.execution.backends import ExecutionTarget, Left, Leftovers, read_sections
from calibration.ci.execution.docker.labels import Owner, check_run_name, new_run
from calibration.ci.execution.job import Job
from calibration.ci.execution.job_check import check_jobs
from calibration.ci.execution.outcome import JobOutcome
from calibration.ci.execution.ros import on_one_address
from calibration.ci.workflow.streams import LogDisplay


class BatchBackend:
    """A queue of AWS Batch as a backend; a context manager, which ends all jobs of the run."""

    def __init__(
        self, settings: BatchSettings, run: str | None = None, show: LogDisplay | None = None, resume: bool = False
    ) -> None:
        """Choose a queue, without a request to AWS.

        Args:
            settings: settings of the backend, with the queue.
            run: name of the run, used in tags of everything that is started; None for a new one.
            show: display for the containers' logs, and the progress of the run.
            resume: whether results of an earlier run of this name are reused, and only missing jobs run.

        Raises:
            InputError: the name of the run is invalid, or missing with resume.
        """
        if resume and run is None:
            raise InputError("resume: give the name of the run to resume (run)")
        self.run_name = run if run is not None else new_run()
        check_run_name(self.run_name)
        self.usage = Usage()
        """Billed resources, as far as they are known."""
        self.aws = Aws(settings.region)
        self._settings = settings
        self._show = show
        self._resume = resume
        self._runs: list[BatchRun] = []

    def __enter__(self) -> Self:
        """Return the backend; requests are sent to AWS when there are jobs."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """End remaining jobs, if an interruption has prevented that before.

        Raises:
            CalibrationError: jobs cannot be ended; the message includes the previous error.
        """
        try:
            for run in self._runs:
                run.end(error)
        finally:
            self.aws.close()

    def run(self, jobs: Sequence[Job], folder: Path, workers: int | None = None) -> Generator[tuple[int, JobOutcome]]:
        """Run jobs; yield index and outcome of each, in the order of completion.

        Invalid jobs raise an error in this call; nothing is started before the first outcome is requested.
        Closing the iterator, or any exception, ends all jobs.

        Args:
            jobs: submitted by shape, in order.
            folder: each job has a subfolder with its name: ``artifacts/``, ``logs/`` and ``manifest.json``;
                those of an earlier run are removed.
            workers: ignored: the compute environments limit the number of concurrent jobs.

        Raises:
            InputError: a job is invalid or cannot run on Batch, or an image, the queue or the bucket is missing
                or not accessible.
            InfrastructureError: AWS cannot be reached.
        """
        check_jobs(jobs, workers)
        check_for_batch(jobs, self._settings)
        store = Store(self.aws, self._settings.bucket)
        needs = {total_size(shape_of(job, self._settings), self._settings.platform) for job in jobs}
        check_queue(self.aws, self._settings, sorted(needs, key=lambda need: need.cpus))
        store.check()
        wanted = [self._settings.tools_image, *(c.image for job in jobs for c in job.containers)]
        images = with_digests(self.aws, wanted)
        settings = replace(self._settings, tools_image=images[self._settings.tools_image])
        jobs = [_with_images(on_one_address(job), images) for job in jobs]
        cloud_run = CloudRun(self.run_name, self.aws, settings, store, folder)
        run = BatchRun(cloud_run, jobs, group_by_shape(jobs, settings), self._show)
        self._runs.append(run)
        return self._run_jobs(run)

    def _run_jobs(self, run: BatchRun) -> Generator[tuple[int, JobOutcome]]:
        try:
            if self._resume:
                self._end_earlier()
            yield from run.outcomes(self._resume)
        except BaseException as error:
            run.end(error)
            raise
        else:
            run.end(None)
        finally:
            self.usage += run.usage

    def _end_earlier(self) -> None:
        """End jobs of an earlier run of this name in the queue, whose client is gone."""
        found = find_in_queue(self.aws, self._settings.queue, self.run_name)
        if found:
            terminate(self.aws, [each.id for each in found], "the run is resumed")


def open_batch(target: ExecutionTarget) -> BatchBackend:
    """Create the backend of an execution target.

    Raises:
        InputError: the name of the run is missing or invalid.
    """
    return BatchBackend(target.settings, target.run, target.show, target.resume)


def _with_images(job: Job, images: dict[str, str]) -> Job:
    return replace(job, containers=tuple(replace(c, image=images[c.image]) for c in job.containers))


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
        count = count_of(len(chosen), "old revision") if chosen else "nothing"
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
