"""``cleanup``: what runs left on the Docker Engine because they were killed."""

import os
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import click

from calibration.commands.parameters import boolean_option, text
from calibration.errors import ExitCode, InputError
from calibration.workflow import Runner, stop_commands
from calibration.workflow.text import aligned

if TYPE_CHECKING:
    from calibration.execution.docker.leftovers import Leftover

_HEADER = ("what", "name", "run", "job", "state")


@click.command("cleanup")
@click.option("--run", type=text, help="Everything of this run, whether it still goes on or not.")
@boolean_option("--all", help="Everything of every run, also of those that still go on.")
@boolean_option("--dry-run", help="Only say what would be removed.")
def command(**options: Any) -> ExitCode:
    """Remove containers, networks and volumes that killed runs have left on the Docker Engine.

    Unless told otherwise: those of processes that ran on this machine and are dead.
    """
    return clean_up(options["run"], options["all"], options["dry_run"], Runner.from_environment(os.environ))


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
    if run is not None and everything:
        raise InputError("run and all exclude each other: name one run, or remove everything")
    if run == "":
        raise InputError("run is empty: expected the name of a run, as calibration cleanup --all --dry-run shows it")
    from calibration.execution.docker.engine import connect
    from calibration.execution.docker.leftovers import find_leftovers, remove

    client = connect()
    try:
        found = find_leftovers(client.api, run)
        chosen = found if everything or run is not None else [each for each in found if _is_abandoned(each)]
        if not dry_run:
            remove(client.api, chosen)
    finally:
        client.close()
    with stop_commands(runner):  # names that others chose
        if chosen:
            runner.log(aligned(_HEADER, map(_row, chosen)))
    runner.log(f"{_count(chosen)} {'would be removed' if dry_run else 'removed'}")
    if others := len(found) - len(chosen):
        runner.log(f"{others} left alone: their run goes on, or may go on elsewhere (--all removes them too)")
    return ExitCode.PASS


def _is_abandoned(leftover: "Leftover") -> bool:
    return leftover.owner is not None and leftover.owner.is_dead


def _row(leftover: "Leftover") -> tuple[str, ...]:
    return (leftover.kind, leftover.name, leftover.run, leftover.job, leftover.state)


def _count(leftovers: Iterable["Leftover"]) -> str:
    kinds = [leftover.kind for leftover in leftovers]
    counts = [f"{kinds.count(kind)} {kind}{'s' * (kinds.count(kind) != 1)}" for kind in dict.fromkeys(kinds)]
    return ", ".join(counts) or "nothing"
