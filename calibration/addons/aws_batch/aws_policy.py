"""``aws-policy``: print the least permissions for jobs on AWS Batch."""

import json
import sys
from pathlib import Path

import click

from calibration.addons.aws_batch.policy import HOLDERS, policy, trust
from calibration.addons.aws_batch.settings import AWS_BATCH
from calibration.base.errors import ExitCode
from calibration.ci.execution.backends import read_sections
from calibration.commands.parameters import path

_POLICY_NAMES = ("caller", "job", "execution", "trust")


@click.command("aws-policy")
@click.option("--config", type=path, default="calibration.yml", show_default=True, help="File with the key aws-batch.")
@click.option(
    "--for",
    "holder",
    type=click.Choice(_POLICY_NAMES),
    default="caller",
    show_default=True,
    help="caller: user of calibration. job, execution: roles of these names. trust: who may assume them.",
)
def command(config: Path, holder: str) -> ExitCode:
    """Print an IAM policy with the least permissions that jobs on AWS Batch need.

    No request is sent to AWS.
    """
    settings = read_sections(AWS_BATCH, config).of(AWS_BATCH)
    found = {each: policy(each, settings) for each in HOLDERS} | {"trust": trust()}
    sys.stdout.write(json.dumps(found[holder], indent=2) + "\n")
    return ExitCode.PASS
