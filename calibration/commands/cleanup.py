"""``cleanup``: remove objects of killed runs from the Docker Engine or the cloud."""

from typing import Any

import click

from calibration.base import ExitCode, InputError, aligned
from calibration.base.addons import import_attribute
from calibration.ci.execution.backends import BACKEND_KINDS, CLOUDS, DOCKER, Leftovers
from calibration.ci.workflow import Runner, stop_commands
from calibration.commands.parameters import boolean_option, path, text
from calibration.commands.target import DEFAULT_FILE

KEPT_SHOWN = 50
"""Limit of shown leftovers that are kept."""


@click.command("cleanup")
@click.option("--run", type=text, help="Remove everything of this run, even if it is still running.")
@boolean_option("--all", help="Remove everything of all runs, even of those still running.")
@boolean_option("--dry-run", help="Only print what would be removed.")
@boolean_option("--cloud", help="In AWS Batch: end waiting and running jobs.")
@boolean_option("--definitions", help="With cloud: deregister old revisions of job definitions, and do nothing else.")
@click.option("--config", type=path, help="With cloud: the file with the key aws-batch (calibration.yml).")
@click.option("--queue", type=text, help="With cloud: job queue, instead of config's.")
@click.option("--region", type=text, help="With cloud: region of the queue, instead of config's.")
def command(**options: Any) -> ExitCode:
    """Remove objects of killed runs: containers, networks and volumes on the Docker Engine, or jobs in AWS Batch.

    By default those of processes that ran on this machine and are dead.
    """
    runner = Runner.from_environment()
    for name in ("config", "queue", "region", "definitions"):
        if options[name] and not options["cloud"]:
            raise InputError(f"{name} is of use with --cloud only")
    run, everything = options["run"], options["all"]
    if run is not None and everything:
        raise InputError("run and all exclude each other: name one run, or remove everything")
    if run == "":
        raise InputError("run is empty: expected the name of a run, as calibration cleanup --all --dry-run shows it")
    if not options["cloud"]:
        leftovers = import_attribute(BACKEND_KINDS[DOCKER].leftovers)()
    else:
        where = (options["config"] or DEFAULT_FILE, options["queue"], options["region"], options["definitions"])
        if not CLOUDS:
            raise InputError("cloud: no backend in a cloud is installed; without --cloud it is this machine's engine")
        leftovers = import_attribute(BACKEND_KINDS[CLOUDS[0]].leftovers)(*where)
        everything |= options["definitions"]  # definitions belong to no run
    return clean_up(leftovers, run, everything, options["dry_run"], runner)


def clean_up(leftovers: Leftovers[Any], run: str | None, everything: bool, dry_run: bool, runner: Runner) -> ExitCode:
    """Remove leftovers, and print them.

    Args:
        leftovers: leftovers of a backend.
        run: name of a run, dead or alive, to restrict the search; None for those of dead processes.
        everything: include all runs.
        dry_run: only print them.
        runner: runner whose log shows them.

    Raises:
        InputError: the search is refused.
        InfrastructureError: the backend does not answer, or something cannot be removed.
    """
    with leftovers as backend:
        found = backend.find(run)
        dead = [each for each in found if each.owner is not None and each.owner.is_dead]
        chosen = found if everything or run is not None else dead
        if not dry_run:
            backend.remove(chosen)
    with stop_commands(runner):  # names are untrusted
        if chosen:
            runner.log(aligned(leftovers.header, [each.row for each in chosen]))
    runner.log(leftovers.summary(chosen, dry_run))
    if kept := [] if everything or run is not None else [each for each in found if each not in dead]:
        rows = [(*each.row, each.owner.where if each.owner else "by an unknown process") for each in kept[:KEPT_SHOWN]]
        with stop_commands(runner):
            runner.log(aligned((*leftovers.header, "its run"), rows))
        more = f", {len(kept) - len(rows)} of them not shown" if len(kept) > len(rows) else ""
        runner.log(f"{len(kept)} kept{more}: their run is active, or may be (--run removes one, --all removes all)")
    return ExitCode.PASS
