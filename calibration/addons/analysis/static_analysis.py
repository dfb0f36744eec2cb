"""``static-analysis``: check the files of a repository with analysers."""

import os
from typing import Any

import click

from calibration.addons.analysis.process import Settings, analyse
from calibration.addons.analysis.report import TITLE
from calibration.base.errors import ExitCode
from calibration.ci.workflow import Runner
from calibration.commands.record_options import chosen, record_options


@click.command(TITLE)
@record_options(Settings)
def command(**options: Any) -> ExitCode:
    """Check the repository's code for errors; the verdict is fail if a change adds too many.

    Analysers run on a copy of the files that git tracks; code of the repository is not run.
    """
    return analyse(chosen(Settings, options), Runner.from_environment(os.environ))
