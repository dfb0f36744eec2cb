"""``aws-policy``: the least permissions for jobs on AWS Batch, as IAM policies."""

import json
import sys
from pathlib import Path
from typing import Any, Literal

import click

from calibration.addons.aws_batch.settings import AWS_BATCH, BatchSettings
from calibration.base import ExitCode
from calibration.ci.execution.backends import read_sections
from calibration.commands.parameters import path

Holder = Literal["caller", "job", "execution"]
"""caller: role that runs the command, such as a workflow's. job: ``job-role``. execution: ``execution-role``."""
HOLDERS: tuple[Holder, ...] = ("caller", "job", "execution")
_OUR_DEFINITIONS = "job-definition/calibration-*"
"""Resource of all our definitions with all revisions."""
_RUN_TAG = "aws:ResourceTag/ci.calibration.run"
_POLICY_NAMES = (*HOLDERS, "trust")


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


def policy(holder: Holder, settings: BatchSettings) -> dict[str, Any]:
    """Return the policy document of a role, ready for IAM."""
    statements = {"caller": _caller_statements, "job": _job_statements, "execution": _execution_statements}[holder](
        settings
    )
    return {"Version": "2012-10-17", "Statement": statements}


def trust() -> dict[str, Any]:
    """Return the trust policy of the two roles of a task: ECS may assume them."""
    statement = {"Effect": "Allow", "Principal": {"Service": "ecs-tasks.amazonaws.com"}, "Action": "sts:AssumeRole"}
    return {"Version": "2012-10-17", "Statement": [statement]}


def _caller_statements(settings: BatchSettings) -> list[dict[str, Any]]:
    roles = [role for role in (settings.job_role, settings.execution_role) if role is not None]
    definitions, jobs = _arn(settings, "batch", _OUR_DEFINITIONS), _arn(settings, "batch", "job/*")
    is_arn = settings.queue.startswith("arn:")
    queue = settings.queue if is_arn else _arn(settings, "batch", f"job-queue/{settings.queue}")
    looks = ("JobQueues", "ComputeEnvironments", "JobDefinitions", "Jobs")
    services = ["batch.amazonaws.com", "ecs-tasks.amazonaws.com"]
    return [
        # these actions have no resources in IAM
        _allow_statement("Look", "*", *(f"batch:Describe{what}" for what in looks), "batch:ListJobs"),
        _allow_statement("Define", definitions, "batch:RegisterJobDefinition", "batch:DeregisterJobDefinition"),
        _allow_statement("Submit", [definitions, queue], "batch:SubmitJob"),
        _allow_statement("Tag", [definitions, jobs], "batch:TagResource"),
        _allow_statement("Stop", jobs, "batch:TerminateJob") | {"Condition": {"Null": {_RUN_TAG: "false"}}},
        _allow_statement("GiveRoles", roles, "iam:PassRole")
        | {"Condition": {"StringEquals": {"iam:PassedToService": services}}},
        _allow_statement("FindFiles", _s3_arn(settings), "s3:ListBucket")
        | {"Condition": {"StringLikeIfExists": {"s3:prefix": f"{settings.prefix}/*"}}},
        _allow_statement("ReadFiles", _s3_arn(settings, "runs/*"), "s3:GetObject"),
        _allow_statement("WriteFiles", _input_arns(settings), "s3:PutObject", "s3:AbortMultipartUpload"),
        _allow_statement("ReadLogs", _log_streams_arn(settings), "logs:GetLogEvents"),
        _allow_statement("FindImages", _arn(settings, "ecr", "repository/*", region="*"), "ecr:DescribeImages"),
    ]


def _job_statements(settings: BatchSettings) -> list[dict[str, Any]]:
    results = _s3_arn(settings, "runs/*/results/*")
    return [
        _allow_statement("ReadInputs", _input_arns(settings), "s3:GetObject"),
        _allow_statement("WriteResults", results, "s3:PutObject", "s3:AbortMultipartUpload"),
    ]


def _execution_statements(settings: BatchSettings) -> list[dict[str, Any]]:
    repositories = _arn(settings, "ecr", "repository/*", region="*")
    pulls = ("ecr:BatchCheckLayerAvailability", "ecr:BatchGetImage", "ecr:GetDownloadUrlForLayer")
    statements = [
        _allow_statement("EnterRegistry", "*", "ecr:GetAuthorizationToken"),
        _allow_statement("PullImages", repositories, *pulls),
        _allow_statement("WriteLogs", _log_streams_arn(settings), "logs:CreateLogStream", "logs:PutLogEvents"),
    ]
    # an ARN may be followed by a key of the secret's JSON, a stage and a version, which are not part of the resource
    arns = sorted({":".join(arn.split(":")[:7]) for arn in settings.secrets.values()})
    for service, name, action in (
        ("secretsmanager", "ReadSecrets", "secretsmanager:GetSecretValue"),
        ("ssm", "ReadParameters", "ssm:GetParameters"),
    ):
        if found := [arn for arn in arns if arn.split(":")[2] == service]:
            statements.append(_allow_statement(name, found, action))
    return statements


def _allow_statement(name: str, resource: str | list[str], *actions: str) -> dict[str, Any]:
    return {"Sid": name, "Effect": "Allow", "Action": list(actions), "Resource": resource}


def _arn(settings: BatchSettings, service: str, resource: str, region: str | None = None) -> str:
    """Return an ARN in the account and partition of the job role; a partition is that of AWS, China or governments."""
    _, partition, _, _, account, _ = settings.job_role.split(":", 5)
    return f"arn:{partition}:{service}:{region or settings.region}:{account}:{resource}"


def _s3_arn(settings: BatchSettings, below: str = "") -> str:
    """Return the ARN of the bucket, or of objects in it."""
    objects = f"/{settings.prefix}/{below}" if below else ""
    return f"arn:{settings.job_role.split(':')[1]}:s3:::{settings.bucket}{objects}"


def _input_arns(settings: BatchSettings) -> list[str]:
    return [_s3_arn(settings, "inputs/*"), _s3_arn(settings, "runs/*/jobs/*")]


def _log_streams_arn(settings: BatchSettings) -> str:
    return _arn(settings, "logs", f"log-group:{settings.log_group}:log-stream:*")
