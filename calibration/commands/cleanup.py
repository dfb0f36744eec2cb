"""``cleanup``: what runs left on the Docker Engine, or in the cloud, because they were killed."""

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import click

from calibration.commands.parameters import boolean_option, path, text
from calibration.docker.engine import connect
from calibration.errors import ExitCode, InputError
from calibration.execution.batch.session import Aws
from calibration.execution.batch.settings import read_section
from calibration.execution.batch.submitting import CloudLeftover, deregister, find_in_queue, find_old, terminate
from calibration.execution.docker.leftovers import Leftover, find_leftovers, remove
from calibration.workflow import Runner, stop_commands
from calibration.workflow.text import aligned

_HEADER = ("what", "name", "run", "job", "state")
_CLOUD_HEADER = ("job", "name", "run", "jobs", "state")
_DEFAULT_FILE = Path("calibration.yml")

Found = TypeVar("Found", "Leftover", "CloudLeftover")


@click.command("cleanup")
@click.option("--run", type=text, help="Everything of this run, whether it still goes on or not.")
@boolean_option("--all", help="Everything of every run, also of those that still go on.")
@boolean_option("--dry-run", help="Only say what would be removed.")
@boolean_option("--cloud", help="In AWS Batch: jobs that still wait or run are ended.")
@boolean_option("--definitions", help="With cloud: deregister old revisions of job definitions, and do nothing else.")
@click.option("--config", type=path, help="With cloud: the file with the key aws-batch (calibration.yml).")
@click.option("--queue", type=text, help="With cloud: the job queue, in the place of config's.")
@click.option("--region", type=text, help="With cloud: where the queue is, in the place of config's.")
def command(**options: Any) -> ExitCode:
    """Remove what killed runs have left: containers, networks and volumes on the Docker Engine, or jobs in AWS Batch.

    Unless told otherwise: those of processes that ran on this machine and are dead.
    """
    runner = Runner.from_environment(os.environ)
    chosen = options["run"], options["all"], options["dry_run"]
    for name in ("config", "queue", "region", "definitions"):
        if options[name] and not options["cloud"]:
            raise InputError(f"{name} is of use with --cloud only")
    if options["definitions"]:
        cloud = _cloud(options["config"], options["queue"] or "any", options["region"])
        return clean_up_definitions(cloud, options["dry_run"], runner)
    if options["cloud"]:
        return clean_up_cloud(_cloud(options["config"], options["queue"], options["region"]), *chosen, runner)
    return clean_up(*chosen, runner)


@dataclass(frozen=True)
class Cloud:
    """Where jobs are in the cloud."""

    region: str
    queue: str


def _cloud(config: Path | None, queue: str | None, region: str | None) -> Cloud:
    if queue and region:
        return Cloud(region, queue)

    settings = read_section(config or _DEFAULT_FILE)
    return Cloud(region or settings.region, queue or settings.queue)


def clean_up(run: str | None, everything: bool, dry_run: bool, runner: Runner) -> ExitCode:
    """Remove leftovers, and print them.

    Args:
        run: only those of this run, dead or alive; None for those of dead processes.
        everything: those of all runs.
        dry_run: only print them.
        runner: where to print.

    Raises:
        InputError: ``run`` and ``everything`` are given both.
        WorldError: the engine does not answer, or something cannot be removed.
    """
    _check(run, everything)

    client = connect()
    try:
        found = find_leftovers(client.api, run)
        chosen = _choose(found, run, everything)
        if not dry_run:
            remove(client.api, chosen)
    finally:
        client.close()
    with stop_commands(runner):  # names that others chose
        if chosen:
            runner.log(aligned(_HEADER, map(_row, chosen)))
    runner.log(f"{_count(chosen)} {'would be removed' if dry_run else 'removed'}")
    _say_others(len(found) - len(chosen), runner)
    return ExitCode.PASS


def clean_up_cloud(cloud: Cloud, run: str | None, everything: bool, dry_run: bool, runner: Runner) -> ExitCode:
    """End jobs in AWS Batch that runs have left, and print them.

    Args:
        cloud: where they are.
        run: only those of this run, dead or alive; None for those of dead processes.
        everything: those of all runs.
        dry_run: only print them.
        runner: where to print.

    Raises:
        InputError: ``run`` and ``everything`` are given both, there is no such queue, or it is not allowed.
        WorldError: AWS does not answer, or a job does not end.
    """
    _check(run, everything)

    aws = Aws(cloud.region)
    try:
        found = find_in_queue(aws, cloud.queue, run)
        chosen = _choose(found, run, everything)
        if not dry_run:
            terminate(aws, [each.id for each in chosen], "calibration cleanup")
    finally:
        aws.close()
    with stop_commands(runner):  # names that others chose
        if chosen:
            rows = ((each.id, each.name, each.run, str(each.jobs), each.status) for each in chosen)
            runner.log(aligned(_CLOUD_HEADER, rows))
    count = f"{len(chosen)} job{'s' * (len(chosen) != 1)} or array{'s' * (len(chosen) != 1)}" if chosen else "nothing"
    runner.log(f"{count} in AWS Batch {'would be ended' if dry_run else 'ended'}")
    _say_others(len(found) - len(chosen), runner)
    return ExitCode.PASS


def clean_up_definitions(cloud: Cloud, dry_run: bool, runner: Runner) -> ExitCode:
    """Deregister all revisions of our job definitions but the newest of each, and print them.

    Raises:
        InputError: it is not allowed.
        WorldError: AWS does not answer.
    """
    aws = Aws(cloud.region)
    try:
        old = find_old(aws)
        if not dry_run:
            deregister(aws, old)
    finally:
        aws.close()
    with stop_commands(runner):
        for arn in old:
            runner.log(arn)
    count = f"{len(old)} old revision{'s' * (len(old) != 1)}" if old else "nothing"
    runner.log(f"{count} {'would be deregistered' if dry_run else 'deregistered'}")
    return ExitCode.PASS


def _check(run: str | None, everything: bool) -> None:
    if run is not None and everything:
        raise InputError("run and all exclude each other: name one run, or remove everything")
    if run == "":
        raise InputError("run is empty: expected the name of a run, as calibration cleanup --all --dry-run shows it")


def _choose(found: Sequence[Found], run: str | None, everything: bool) -> Sequence[Found]:
    return found if everything or run is not None else [each for each in found if _is_abandoned(each)]


def _say_others(others: int, runner: Runner) -> None:
    if others:
        runner.log(f"{others} left alone: their run goes on, or may go on elsewhere (--all removes them too)")


def _is_abandoned(leftover: Leftover | CloudLeftover) -> bool:
    return leftover.owner is not None and leftover.owner.is_dead


def _row(leftover: Leftover) -> tuple[str, ...]:
    return (leftover.kind, leftover.name, leftover.run, leftover.job, leftover.state)


def _count(leftovers: Iterable[Leftover]) -> str:
    kinds = [leftover.kind for leftover in leftovers]
    counts = [f"{kinds.count(kind)} {kind}{'s' * (kinds.count(kind) != 1)}" for kind in dict.fromkeys(kinds)]
    return ", ".join(counts) or "nothing"
