"""``calibration version``: print the versions needed for a bug report."""

import platform
from importlib.metadata import PackageNotFoundError, version

import click

from calibration import __version__
from calibration.base import ExitCode
from calibration.ci.workflow import Runner

SHOWN_DISTRIBUTIONS = ("click", "pyyaml", "numpy", "defusedxml", "rich", "opencv-python-headless", "docker", "boto3")
"""Distributions that the suite uses, required or optional."""


@click.command("version")
def command() -> ExitCode:
    """Print the versions of Calibration CI, of Python and of the packages in use."""
    runner = Runner()
    runner.log(f"calibration-ci {__version__}")
    runner.log(f"python {platform.python_version()} on {platform.system()} {platform.machine()}")
    for package in SHOWN_DISTRIBUTIONS:
        try:
            runner.log(f"{package} {version(package)}")
        except PackageNotFoundError:
            runner.log(f"{package} not installed")
    return ExitCode.PASS
