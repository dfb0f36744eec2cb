"""``static-analysis``: a repository's files to findings to a verdict."""

import os
from typing import Any

import click

from calibration.analysis.process import Settings, analyse
from calibration.analysis.report import TITLE
from calibration.commands.record_options import chosen, record_options
from calibration.errors import ExitCode
from calibration.workflow import Runner


@click.command(TITLE)
@record_options(Settings)
def command(**options: Any) -> ExitCode:
    """Look for errors in the repository's code; the verdict is fail when a change brings in too many.

    Analysers run on a copy of the files that git tracks; nothing of the repository is run.
    """
    return analyse(chosen(Settings, options), Runner.from_environment(os.environ))
