"""Parts of the log: folded groups, and output of other programs in which workflow commands are disabled."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

from calibration.base.text import one_line
from calibration.ci.workflow.commands import workflow_command
from calibration.ci.workflow.runner import Runner


@contextmanager
def group(runner: Runner, title: str) -> Iterator[None]:
    """Fold the output of the block under a title; outside of GitHub only the title is printed.

    The runner does not support nested groups. Print the verdict outside.
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
    """Disable workflow commands in the output of the block, for output of other programs.

    The token that enables them again is random, so the output cannot contain it. ``stream`` is the
    stream of the output, by default stdout.
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
