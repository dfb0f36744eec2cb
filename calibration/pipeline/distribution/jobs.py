"""Results of a workflow's jobs, their durations as reported by themselves, and what they cost."""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field as dataclass_field
from pathlib import Path

from calibration.base import CalibrationError, InputError, number_text, read_bytes
from calibration.base.records import computed, field, result
from calibration.ci.report import Table
from calibration.pipeline.distribution.plan import WorkflowPlan

JOB_SUCCESS = "success"
UNPLANNED_JOBS = ("check", "coverage")
"""Jobs that plan-matrix does not plan, as other inputs of the workflow control them."""
SECONDS_OUTPUT = "seconds"
"""Output with the duration, of a job without a matrix."""
ERROR_OUTPUT = "error"
"""Output with the line of an error (`calibration.ci.workflow`), of a job that leaves no results."""
SECONDS_FILE = "job-seconds.txt"
"""File with the duration, beside the results of a job of the matrix, whose outputs GitHub does not keep one by one."""
_SECONDS_PATTERN = re.compile(r"[0-9]{1,7}")
"""Durations of up to 115 days."""


@dataclass(frozen=True)
class Needs:
    """Results of the previous jobs."""

    results: Mapping[str, str] = dataclass_field(default_factory=dict)
    """Result of each job: success, failure, cancelled or skipped."""
    seconds: Mapping[str, int] = dataclass_field(default_factory=dict)
    """Durations of the jobs that report them by an output."""
    errors: Mapping[str, str] = dataclass_field(default_factory=dict)
    """Error lines of the jobs that leave no results, and report them by an output."""

    @property
    def unplanned(self) -> dict[str, str]:
        """Results of the jobs that are not in the plan."""
        return {job: self.results[job] for job in UNPLANNED_JOBS if job in self.results}


def parse_needs(text: str) -> Needs:
    """Parse the JSON of the previous jobs: an object with the result of each, and with its outputs seconds and error.

    Raises:
        InputError: it is invalid, or has no job plan.
    """
    try:
        jobs = json.loads(text)
        results = {name: str(job["result"]) for name, job in jobs.items()}
        seconds = {
            name: found for name, job in jobs.items() if (found := parse_seconds(job.get(SECONDS_OUTPUT))) is not None
        }
        errors = {name: str(job[ERROR_OUTPUT]) for name, job in jobs.items() if job.get(ERROR_OUTPUT)}
        _ = results["plan"]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise InputError(
            'needs: an object with every job was expected, {"plan": {"result": "success", "seconds": "7"}, ...}'
        ) from None
    return Needs(results, seconds, errors)


def parse_seconds(value: object) -> int | None:
    """Parse the seconds that a job reports; None if invalid, which is not an error."""
    text = value.strip() if isinstance(value, str) else ""
    return int(text) if _SECONDS_PATTERN.fullmatch(text) else None


def read_seconds(folder: Path) -> int | None:
    """Read the duration in a job's folder; None if it is missing or invalid."""
    try:
        return parse_seconds(read_bytes(folder / SECONDS_FILE, 16, "a number of seconds").decode("latin-1"))
    except CalibrationError:
        return None


VERDICT_JOB, PROMOTE_JOB = "verdict", "promote"
"""The last jobs: the one that computes the cost, and the one that runs after it."""
MONEY_DECIMALS = 6
"""Decimals of an amount of money; further ones are rounding errors."""


@result
class JobTime:
    """Time of one job."""

    job: str = field("Its place in the workflow: calibrate.")
    name: str = field("Its cell (robot, 0.5 m, 0 rad); the job's name if there is only one.")
    seconds: int | None = field("Null if unknown: the job was lost or cancelled, or has not run.", default=None)

    @property
    @computed("billed_minutes")
    def minutes(self) -> int | None:
        """Billed time: started minutes, at least one."""
        return None if self.seconds is None else max(1, -(-self.seconds // 60))


@result
class Cost:
    """Times of the jobs of a run, or some of them."""

    times: tuple[JobTime, ...] = field("The jobs.", key="jobs")
    rate: float | None = field("Cost of a minute, in any currency; null if not given.", default=None)

    @property
    @computed()
    def complete(self) -> bool:
        """Whether the time of every job is known, and so in the sum."""
        return len(self.known) == len(self.times)

    @property
    def known(self) -> tuple[JobTime, ...]:
        """The jobs whose time is known."""
        return tuple(time for time in self.times if time.seconds is not None)

    @property
    def seconds(self) -> int:
        """Sum of the known times."""
        return sum(time.seconds or 0 for time in self.times)

    @property
    @computed("billed_minutes")
    def minutes(self) -> int:
        """Billed minutes of the known times."""
        return sum(time.minutes or 0 for time in self.times)

    @property
    @computed("cost")
    def amount(self) -> float | None:
        """Cost of these minutes; None without a rate."""
        return None if self.rate is None else round(self.minutes * self.rate, MONEY_DECIMALS)

    def of(self, job: str) -> "Cost":
        """Return the part of one job of the workflow."""
        return Cost(tuple(time for time in self.times if time.job == job), self.rate)

    @property
    def sentence(self) -> str:
        """The sum in one line."""
        least = "" if self.complete else "at least "
        price = "" if self.rate is None else f": {money(self.amount)} at {number_text(self.rate)} a minute"
        return f"{least}{self.minutes} billed minutes{price}"


def cost_of_run(plan: WorkflowPlan, needs: Needs, folder: Path, seconds: int | None, *, promotes: bool) -> Cost:
    """Return the cost of a run, as far as its jobs have reported their times.

    Args:
        plan: of the run; empty if planning failed.
        needs: results of the jobs before this one.
        folder: their files, each in a folder with its slug.
        seconds: of the current job, until now.
        promotes: whether a job runs after it.
    """
    times = []
    for job in ("plan", *plan.jobs, *needs.unplanned):  # not in the order of needs, whose keys act sorts by name
        if needs.results.get(job, "skipped") == "skipped":
            continue
        cells = plan.cells_of_job.get(job)
        if cells is None:
            times.append(JobTime(job, job, needs.seconds.get(job)))
        else:
            times += [JobTime(job, cell.name, read_seconds(folder / cell.slug)) for cell in cells]
    times.append(JobTime(VERDICT_JOB, VERDICT_JOB, seconds))
    if promotes:
        times.append(JobTime(PROMOTE_JOB, PROMOTE_JOB))
    return Cost(tuple(times), plan.minute_rate)


def jobs_table(results: Mapping[str, str], cost: Cost) -> Table:
    """Return the table of all jobs: result, time and cost of each."""
    results = {**results, VERDICT_JOB: "this job", **({PROMOTE_JOB: "to come"} if cost.of(PROMOTE_JOB).times else {})}
    rows = [(job, result, *_cost_numbers(cost.of(job))) for job, result in results.items()]
    header: tuple[str, ...] = ("Job", "Result", "Jobs", "Seconds", "Billed minutes")
    sums = ("all", "", *_cost_numbers(cost))
    if cost.rate is None:
        return Table(header, tuple(row[:-1] for row in (*rows, sums)), title="Jobs", only="summary")
    header = (*header, f"Cost at {number_text(cost.rate)} a minute")
    return Table(header, (*rows, sums), title="Jobs", only="summary")


def money(amount: float | None) -> str:
    """Format an amount with all its digits; empty if there is none."""
    return "" if amount is None else f"{amount:.{MONEY_DECIMALS}f}".rstrip("0").rstrip(".")


def _cost_numbers(cost: Cost) -> tuple[str, str, str, str]:
    """Format jobs, seconds, minutes and money; with "+ ?" if some are unknown."""
    count = str(len(cost.times))
    if cost.times and not cost.known:
        return (count, "?", "?", "?")
    more = "" if cost.complete else " + ?"
    return (count, f"{cost.seconds}{more}", f"{cost.minutes}{more}", f"{money(cost.amount)}{more}")
