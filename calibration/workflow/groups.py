"""Parts of the log: folded groups, and output of others in which the runner obeys no command."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

from calibration.workflow.commands import workflow_command
from calibration.workflow.runner import Runner
from calibration.workflow.text import one_line


@contextmanager
def group(runner: Runner, title: str) -> Iterator[None]:
    """Fold what is printed inside under a title; off GitHub only the title is printed.

    The runner knows no groups inside groups. Print the verdict outside.
    """
    if not runner.github:
        runner.log(one_line(title))
        yield
        return
    runner.log(workflow_command("group", one_line(title)))
    try:
        yield
    finally:
        runner.log(workflow_command("endgroup"))


@contextmanager
def stop_commands(runner: Runner, stream: TextIO | None = None) -> Iterator[None]:
    """Print the output of others inside: the runner obeys no workflow command in it.

    The token that ends the pause is random, so the output cannot end it. ``stream`` is where the
    output goes, stdout unless told.
    """
    if not runner.github:
        yield
        return
    stream = stream or runner.stdout
    token = os.urandom(16).hex()
    print(workflow_command("stop-commands", token), file=stream, flush=True)
    try:
        yield
    finally:
        print(f"\n::{token}::", file=stream, flush=True)
