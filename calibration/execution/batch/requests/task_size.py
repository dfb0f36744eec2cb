"""How much processor and memory a task gets: as its containers ask, in amounts that AWS Batch takes.

Processors are shares: a container may use all of the task's while nobody else needs them. Memory is a limit: who
exceeds it is killed. Our two containers, which sleep most of the time, get their processors from those of the job,
so that one container of one CPU is a task of one CPU.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from calibration.errors import InputError
from calibration.execution.batch.settings import Platform

TOOLS_MEMORY = 512
"""MiB, of each of our containers."""
_TOOLS = 2
_STEP = {"fargate": 0.25, "ec2": 1.0}
"""The least processor of a container, and what it is a multiple of: EC2 takes whole ones only."""
_FARGATE = {
    0.25: (512, 1024, 2048),
    0.5: (1024, 2048, 3072, 4096),
    1.0: tuple(range(2048, 8193, 1024)),
    2.0: tuple(range(4096, 16385, 1024)),
    4.0: tuple(range(8192, 30721, 1024)),
    8.0: tuple(range(16384, 61441, 4096)),
    16.0: tuple(range(32768, 122881, 8192)),
    32.0: (61440, 122880, 249856),
}
"""The memory (MiB) that a task of so many processors may have; Batch holds the sums over the containers to it."""


@dataclass(frozen=True)
class Resources:
    """What a container or a task has."""

    cpus: float
    memory: int
    """MiB."""


@dataclass(frozen=True)
class TaskSize:
    """What a task has, and each container in it."""

    total: Resources
    containers: tuple[Resources, ...]
    """Those of the job, in its order."""
    prepare: Resources
    watch: Resources


def task_size(asked: Sequence[Resources], platform: Platform) -> TaskSize:
    """The size of the task for a job.

    On Fargate it is the smallest that holds the containers; memory beyond what they ask goes to our own, as theirs
    is a limit.

    Args:
        asked: what each container of the job asks for.
        platform: Fargate has sizes, EC2 whole processors.

    Raises:
        InputError: no task on Fargate is so large; says what was asked for.
    """
    step = _STEP[platform]
    shares = [max(1, math.ceil(resources.cpus / step)) for resources in asked]
    cpus = max(sum(shares), len(shares) + _TOOLS) * step
    memory = sum(resources.memory for resources in asked) + _TOOLS * TOOLS_MEMORY
    total = _fargate_size(cpus, memory) if platform == "fargate" else Resources(cpus, memory)
    rest = round(total.cpus / step) - _TOOLS - sum(shares)
    while rest < 0:  # from whoever has the most, so that nobody is left without any
        shares[shares.index(max(shares))] -= 1
        rest += 1
    shares[shares.index(max(shares))] += rest
    return TaskSize(
        total=total,
        containers=tuple(
            Resources(share * step, resources.memory) for share, resources in zip(shares, asked, strict=True)
        ),
        prepare=Resources(step, TOOLS_MEMORY),
        watch=Resources(step, TOOLS_MEMORY + total.memory - memory),
    )


def _fargate_size(cpus: float, memory: int) -> Resources:
    for size, memories in _FARGATE.items():
        if size >= cpus and memories[-1] >= memory:
            return Resources(size, next(each for each in memories if each >= memory))
    largest, memories = list(_FARGATE.items())[-1]
    raise InputError(
        f"its containers ask for {cpus:g} CPUs and {memory} MiB (ours {_TOOLS * TOOLS_MEMORY} of them), but a task on "
        f"Fargate has at most {largest:g} and {memories[-1]}: ask for less, or use platform ec2"
    )
