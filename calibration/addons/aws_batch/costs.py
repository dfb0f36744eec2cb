"""Estimated costs of jobs before a run, and billed costs after it.

Hours of processors and memory are always reported; money only if the user has given prices, which change and differ
by region. On EC2 the hours are those that the jobs reserve: costs of instances depend on the compute environment.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from calibration.addons.aws_batch.definition import Resources, Shape, task_size
from calibration.addons.aws_batch.settings import BatchSettings, Platform, Prices
from calibration.ci.execution.job import Job

_SECONDS_PER_HOUR = 3600.0
_FARGATE_LEAST = 60
"""Seconds: Fargate bills at least one minute."""


@dataclass(frozen=True)
class Usage:
    """Billed time and reserved resources."""

    seconds: float = 0.0
    """Sum over all tasks."""
    vcpu_hours: float = 0.0
    gb_hours: float = 0.0

    def __add__(self, other: "Usage") -> "Usage":
        return Usage(self.seconds + other.seconds, self.vcpu_hours + other.vcpu_hours, self.gb_hours + other.gb_hours)

    def price(self, prices: Prices) -> float:
        """Return the price."""
        return self.vcpu_hours * prices.vcpu_hour + self.gb_hours * prices.gb_hour

    def text(self, prices: Prices | None) -> str:
        """Format for messages: ``1.2 vCPU-hours and 2.4 GB-hours, 0.06 USD``."""
        hours = f"{self.vcpu_hours:.3g} vCPU-hours and {self.gb_hours:.3g} GB-hours"
        return hours if prices is None else f"{hours}, {self.price(prices):.2f} {prices.currency}"


@dataclass(frozen=True)
class Estimate:
    """Upper bound of the costs of jobs, if each runs once until its time limit."""

    usage: Usage
    unlimited: int = 0
    """Number of jobs without a time limit, which are not included."""

    def text(self, settings: BatchSettings) -> str:
        """Format for messages, including what is not covered."""
        text = f"at most {self.usage.text(settings.prices)}, if no host is lost"
        if settings.platform == "ec2":
            text += " and instances are filled"
        if self.unlimited:
            text += f"; not including {self.unlimited} job{'s' * (self.unlimited != 1)} without a time limit"
        return text


def estimate(jobs: Sequence[tuple[Job, Shape]], settings: BatchSettings) -> Estimate:
    """Return an upper bound of the costs of jobs; most end long before their time limit.

    Args:
        jobs: jobs with their shapes.
        settings: settings of the backend.

    Raises:
        InputError: a job needs more than the largest task.
    """
    sizes = {shape: total_size(shape, settings.platform) for shape in {shape for _, shape in jobs}}
    limited = [(job.seconds, sizes[shape]) for job, shape in jobs if job.seconds is not None]
    usage = [usage_of(seconds, size, settings.platform) for seconds, size in limited]
    return Estimate(_sum_usages(usage), len(jobs) - len(limited))


def billed(attempts: Iterable[tuple[int | None, int | None]], size: Resources, platform: Platform) -> Usage:
    """Return the billed usage of a job's attempts.

    Args:
        attempts: ``startedAt`` and ``stoppedAt`` of each, in milliseconds, from DescribeJobs; attempts without
            a start or end are not counted.
        size: size of the task.
        platform: Fargate bills each attempt for at least one minute.
    """
    return _sum_usages(
        usage_of((stopped - started) / 1000, size, platform)
        for started, stopped in attempts
        if started is not None and stopped is not None and stopped >= started
    )


def usage_of(seconds: float, size: Resources, platform: Platform) -> Usage:
    """Return the billed usage of a task of this duration: whole seconds, on Fargate at least 60."""
    paid = max(math.ceil(seconds), _FARGATE_LEAST if platform == "fargate" else 0)
    return Usage(paid, size.cpus * paid / _SECONDS_PER_HOUR, size.memory / 1024 * paid / _SECONDS_PER_HOUR)


def total_size(shape: Shape, platform: Platform) -> Resources:
    """Return the resources that a task for a job of this shape reserves.

    Raises:
        InputError: it needs more than the largest task.
    """
    return task_size([container.resources for container in shape.containers], platform).total


def _sum_usages(usages: Iterable[Usage]) -> Usage:
    return sum(usages, Usage())
