"""What jobs may cost, before they run, and what was billed, after.

Hours of processors and memory are told always; money only where the user has given prices, which change and differ by
region. On EC2 the hours are those that the jobs reserve: what an instance costs is the compute environment's doing.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from calibration.execution.batch.definition import Resources, Shape, task_size
from calibration.execution.batch.settings import BatchSettings, Platform, Prices
from calibration.execution.job import Job

_HOUR = 3600.0
_FARGATE_LEAST = 60
"""Seconds: Fargate bills a minute at least."""


@dataclass(frozen=True)
class Usage:
    """Time that is paid for, and what was reserved in it."""

    seconds: float = 0.0
    """Of all tasks together."""
    vcpu_hours: float = 0.0
    gb_hours: float = 0.0

    def __add__(self, other: "Usage") -> "Usage":
        return Usage(self.seconds + other.seconds, self.vcpu_hours + other.vcpu_hours, self.gb_hours + other.gb_hours)

    def price(self, prices: Prices) -> float:
        """What it costs."""
        return self.vcpu_hours * prices.vcpu_hour + self.gb_hours * prices.gb_hour

    def text(self, prices: Prices | None) -> str:
        """For a message: ``1.2 vCPU-hours and 2.4 GB-hours, 0.06 USD``."""
        hours = f"{self.vcpu_hours:.3g} vCPU-hours and {self.gb_hours:.3g} GB-hours"
        return hours if prices is None else f"{hours}, {self.price(prices):.2f} {prices.currency}"


@dataclass(frozen=True)
class Estimate:
    """What jobs cost at most, if each runs once and for all the time that it has."""

    usage: Usage
    unlimited: int = 0
    """Jobs without a limit in time, which are not in it."""

    def text(self, settings: BatchSettings) -> str:
        """For a message, with all that it leaves out."""
        said = f"at most {self.usage.text(settings.prices)}, if no host is lost"
        if settings.platform == "ec2":
            said += " and instances are filled"
        if self.unlimited:
            said += f"; without {self.unlimited} job{'s' * (self.unlimited != 1)} that may run for ever"
        return said


def estimate(jobs: Sequence[tuple[Job, Shape]], settings: BatchSettings) -> Estimate:
    """What jobs cost at most: an upper bound, as most end long before their time is up.

    Args:
        jobs: with the shape of each.
        settings: of the platform.

    Raises:
        InputError: no task is as large as one of them needs.
    """
    sizes = {shape: total_size(shape, settings.platform) for shape in {shape for _, shape in jobs}}
    limited = [(job.seconds, sizes[shape]) for job, shape in jobs if job.seconds is not None]
    usage = [usage_of(seconds, size, settings.platform) for seconds, size in limited]
    return Estimate(_sum(usage), len(jobs) - len(limited))


def billed(attempts: Iterable[tuple[int | None, int | None]], size: Resources, platform: Platform) -> Usage:
    """What the attempts of a job are billed for.

    Args:
        attempts: ``startedAt`` and ``stoppedAt`` of each, in milliseconds, as DescribeJobs has them; one that never
            started, or whose end nobody knows, counts nothing.
        size: of the task.
        platform: Fargate bills each attempt for a minute at least.
    """
    return _sum(
        usage_of((stopped - started) / 1000, size, platform)
        for started, stopped in attempts
        if started is not None and stopped is not None and stopped >= started
    )


def usage_of(seconds: float, size: Resources, platform: Platform) -> Usage:
    """What a task that runs so long is billed for: whole seconds, on Fargate at least 60."""
    paid = max(math.ceil(seconds), _FARGATE_LEAST if platform == "fargate" else 0)
    return Usage(paid, size.cpus * paid / _HOUR, size.memory / 1024 * paid / _HOUR)


def total_size(shape: Shape, platform: Platform) -> Resources:
    """What a task for a job of that shape reserves.

    Raises:
        InputError: no task is so large.
    """
    return task_size([container.resources for container in shape.containers], platform).total


def _sum(usages: Iterable[Usage]) -> Usage:
    return sum(usages, Usage())
