"""IAM policies with least privileges: for the caller of ``calibration``, and the two roles of a task.

The team's own software runs with the job's role too, so this role has only the permissions of our two containers.
"""

from typing import Any, Literal

from calibration.addons.aws_batch.settings import BatchSettings

Holder = Literal["caller", "job", "execution"]
"""caller: role that runs the command, such as a workflow's. job: ``job-role``. execution: ``execution-role``."""
HOLDERS: tuple[Holder, ...] = ("caller", "job", "execution")
_DEFINITIONS = "job-definition/calibration-*"
"""Resource of all our definitions with all revisions."""
_RUN_TAG = "aws:ResourceTag/ci.calibration.run"


def policy(holder: Holder, settings: BatchSettings) -> dict[str, Any]:
    """Return the policy document of a role, ready for IAM."""
    statements = {"caller": _caller, "job": _job, "execution": _execution}[holder](settings)
    return {"Version": "2012-10-17", "Statement": statements}


def trust() -> dict[str, Any]:
    """Return the trust policy of the two roles of a task: ECS may assume them."""
    statement = {"Effect": "Allow", "Principal": {"Service": "ecs-tasks.amazonaws.com"}, "Action": "sts:AssumeRole"}
    return {"Version": "2012-10-17", "Statement": [statement]}


def _caller(settings: BatchSettings) -> list[dict[str, Any]]:
    roles = [role for role in (settings.job_role, settings.execution_role) if role is not None]
    definitions, jobs = _batch(settings, _DEFINITIONS), _batch(settings, "job/*")
    return [
        # these actions have no resources in IAM
        _allow(
            "Look",
            "*",
            "batch:DescribeJobQueues",
            "batch:DescribeComputeEnvironments",
            "batch:DescribeJobDefinitions",
            "batch:DescribeJobs",
            "batch:ListJobs",
        ),
        _allow("Define", definitions, "batch:RegisterJobDefinition", "batch:DeregisterJobDefinition"),
        _allow("Submit", [definitions, _queue(settings)], "batch:SubmitJob"),
        _allow("Tag", [definitions, jobs], "batch:TagResource"),
        _allow("Stop", jobs, "batch:TerminateJob") | {"Condition": {"Null": {_RUN_TAG: "false"}}},
        _allow("GiveRoles", roles, "iam:PassRole")
        | {"Condition": {"StringEquals": {"iam:PassedToService": ["batch.amazonaws.com", "ecs-tasks.amazonaws.com"]}}},
        _allow("FindFiles", _bucket(settings), "s3:ListBucket")
        | {"Condition": {"StringLikeIfExists": {"s3:prefix": f"{settings.prefix}/*"}}},
        _allow("ReadFiles", _objects(settings, "runs/*"), "s3:GetObject"),
        _allow(
            "WriteFiles",
            [_objects(settings, "inputs/*"), _objects(settings, "runs/*/jobs/*")],
            "s3:PutObject",
            "s3:AbortMultipartUpload",
        ),
        _allow("ReadLogs", f"{_log_group(settings)}:log-stream:*", "logs:GetLogEvents"),
        _allow(
            "FindImages", f"arn:{_partition(settings)}:ecr:*:{_account(settings)}:repository/*", "ecr:DescribeImages"
        ),
    ]


def _job(settings: BatchSettings) -> list[dict[str, Any]]:
    return [
        _allow("ReadInputs", [_objects(settings, "inputs/*"), _objects(settings, "runs/*/jobs/*")], "s3:GetObject"),
        _allow("WriteResults", _objects(settings, "runs/*/results/*"), "s3:PutObject", "s3:AbortMultipartUpload"),
    ]


def _execution(settings: BatchSettings) -> list[dict[str, Any]]:
    statements = [
        _allow("EnterRegistry", "*", "ecr:GetAuthorizationToken"),
        _allow(
            "PullImages",
            f"arn:{_partition(settings)}:ecr:*:{_account(settings)}:repository/*",
            "ecr:BatchCheckLayerAvailability",
            "ecr:BatchGetImage",
            "ecr:GetDownloadUrlForLayer",
        ),
        _allow("WriteLogs", f"{_log_group(settings)}:log-stream:*", "logs:CreateLogStream", "logs:PutLogEvents"),
    ]
    # an ARN may be followed by a key of the secret's JSON, a stage and a version, which are not part of the resource
    arns = sorted({":".join(arn.split(":")[:7]) for arn in settings.secrets.values()})
    for service, name, action in (
        ("secretsmanager", "ReadSecrets", "secretsmanager:GetSecretValue"),
        ("ssm", "ReadParameters", "ssm:GetParameters"),
    ):
        if found := [arn for arn in arns if arn.split(":")[2] == service]:
            statements.append(_allow(name, found, action))
    return statements


def _allow(name: str, resource: str | list[str], *actions: str) -> dict[str, Any]:
    return {"Sid": name, "Effect": "Allow", "Action": list(actions), "Resource": resource}


def _partition(settings: BatchSettings) -> str:
    """Return ``aws``, or the partition of China or the government."""
    return settings.job_role.split(":")[1]


def _account(settings: BatchSettings) -> str:
    return settings.job_role.split(":")[4]


def _batch(settings: BatchSettings, resource: str) -> str:
    return f"arn:{_partition(settings)}:batch:{settings.region}:{_account(settings)}:{resource}"


def _queue(settings: BatchSettings) -> str:
    return settings.queue if settings.queue.startswith("arn:") else _batch(settings, f"job-queue/{settings.queue}")


def _bucket(settings: BatchSettings) -> str:
    return f"arn:{_partition(settings)}:s3:::{settings.bucket}"


def _objects(settings: BatchSettings, below: str) -> str:
    return f"{_bucket(settings)}/{settings.prefix}/{below}"


def _log_group(settings: BatchSettings) -> str:
    return f"arn:{_partition(settings)}:logs:{settings.region}:{_account(settings)}:log-group:{settings.log_group}"
