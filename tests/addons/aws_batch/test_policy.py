import ast
import fnmatch
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import boto3
import pytest
from botocore import xform_name
from botocore.session import Session
from moto import mock_aws

from calibration.addons.aws_batch import aws_policy as policy_module
from calibration.addons.aws_batch.aws_policy import HOLDERS, Holder, policy, trust
from calibration.addons.aws_batch.definition import definition_name, shape_of
from calibration.addons.aws_batch.settings import BatchSettings
from calibration.addons.aws_batch.wire import Location
from tests.addons.aws_batch.samples import ACCOUNT, SETTINGS, TOKEN_ARN, job

LOCATION = Location(SETTINGS.bucket, SETTINGS.prefix, "ab12", "c07b5b521ae6")
PARAMETER = f"arn:aws:ssm:eu-west-1:{ACCOUNT}:parameter/team/token"


def allowed(holder: Holder, action: str, resource: str, settings: BatchSettings = SETTINGS) -> bool:
    """Return whether a policy allows an action, ignoring its conditions."""
    return any(
        action in statement["Action"]
        and any(fnmatch.fnmatchcase(resource, each) for each in as_list(statement["Resource"]))
        for statement in policy(holder, settings)["Statement"]
    )


def as_list(value: Any) -> list[str]:
    return value if isinstance(value, list) else [value]


def batch(resource: str) -> str:
    return f"arn:aws:batch:eu-west-1:{ACCOUNT}:{resource}"


def s3(key: str) -> str:
    return f"arn:aws:s3:::{SETTINGS.bucket}/{key}"


def test_permissions_of_the_caller() -> None:
    definition = definition_name(shape_of(job(), SETTINGS), SETTINGS)
    for action, resource in [
        ("batch:RegisterJobDefinition", batch(f"job-definition/{definition}")),
        ("batch:DeregisterJobDefinition", batch(f"job-definition/{definition}:7")),
        ("batch:SubmitJob", batch(f"job-definition/{definition}:7")),
        ("batch:SubmitJob", batch("job-queue/robots")),
        ("batch:TagResource", batch(f"job-definition/{definition}")),
        ("batch:TagResource", batch("job/6cf8d4b8-0000-0000-0000-000000000000")),
        ("batch:TerminateJob", batch("job/6cf8d4b8-0000-0000-0000-000000000000")),
        ("batch:DescribeJobs", "*"),
        ("iam:PassRole", SETTINGS.job_role),
        ("iam:PassRole", str(SETTINGS.execution_role)),
        ("s3:ListBucket", f"arn:aws:s3:::{SETTINGS.bucket}"),
        ("s3:PutObject", s3(LOCATION.input_key("a" * 64))),
        ("s3:GetObject", s3(LOCATION.jobs_key(7))),
        ("s3:PutObject", s3(LOCATION.jobs_key(7))),
        ("s3:GetObject", s3(LOCATION.result_key(7, 1, "outcome.json"))),
        ("logs:GetLogEvents", f"arn:aws:logs:eu-west-1:{ACCOUNT}:log-group:/aws/batch/job:log-stream:calibration/a/b"),
        ("ecr:DescribeImages", f"arn:aws:ecr:us-east-1:{ACCOUNT}:repository/robot"),
    ]:
        assert allowed("caller", action, resource), (action, resource)


def test_forbidden_actions_of_the_caller() -> None:
    for action, resource in [
        ("batch:SubmitJob", batch("job-queue/other")),
        ("batch:SubmitJob", batch("job-definition/other:1")),
        ("batch:DeregisterJobDefinition", batch("job-definition/other:1")),
        ("iam:PassRole", f"arn:aws:iam::{ACCOUNT}:role/admin"),
        ("s3:PutObject", s3(LOCATION.result_key(7, 1, "outcome.json"))),  # only tasks write results
        ("s3:GetObject", s3("other/file")),
        ("s3:GetObject", s3(LOCATION.input_key("a" * 64))),
        ("s3:PutObject", "arn:aws:s3:::other/calibration/inputs/x"),
    ]:
        assert not allowed("caller", action, resource), (action, resource)


def test_the_role_of_a_job_reads_inputs_and_writes_results() -> None:
    assert allowed("job", "s3:GetObject", s3(LOCATION.input_key("a" * 64)))
    assert allowed("job", "s3:GetObject", s3(LOCATION.jobs_key(0)))
    assert allowed("job", "s3:PutObject", s3(LOCATION.result_key(7, 2, "files/a.csv")))
    # the team's software has this role too
    assert not allowed("job", "s3:PutObject", s3(LOCATION.jobs_key(0)))
    assert not allowed("job", "s3:PutObject", s3(LOCATION.input_key("a" * 64)))
    assert not allowed("job", "s3:GetObject", s3(LOCATION.result_key(7, 2, "outcome.json")))
    actions = {action for statement in policy("job", SETTINGS)["Statement"] for action in statement["Action"]}
    assert actions == {"s3:GetObject", "s3:PutObject", "s3:AbortMultipartUpload"}


def test_the_execution_role_reads_only_the_secrets_that_are_named() -> None:
    settings = replace(SETTINGS, secrets={"A": f"{TOKEN_ARN}:key:AWSCURRENT:", "B": PARAMETER, "C": TOKEN_ARN})
    found = {statement["Sid"]: statement for statement in policy("execution", settings)["Statement"]}
    assert found["ReadSecrets"]["Resource"] == [TOKEN_ARN]
    assert found["ReadParameters"]["Resource"] == [PARAMETER]
    without = {statement["Sid"] for statement in policy("execution", SETTINGS)["Statement"]}
    assert without == {"EnterRegistry", "PullImages", "WriteLogs"}


def test_only_actions_without_resources_are_allowed_for_everything() -> None:
    unnamed = {
        (holder, action)
        for holder in HOLDERS
        for statement in policy(holder, SETTINGS)["Statement"]
        if "*" in as_list(statement["Resource"])
        for action in statement["Action"]
    }
    assert unnamed == {
        ("caller", "batch:DescribeJobQueues"),
        ("caller", "batch:DescribeComputeEnvironments"),
        ("caller", "batch:DescribeJobDefinitions"),
        ("caller", "batch:DescribeJobs"),
        ("caller", "batch:ListJobs"),
        ("execution", "ecr:GetAuthorizationToken"),
    }


def test_only_our_jobs_can_be_stopped_and_roles_only_be_given_to_tasks() -> None:
    found = {statement["Sid"]: statement.get("Condition") for statement in policy("caller", SETTINGS)["Statement"]}
    assert found["Stop"] == {"Null": {"aws:ResourceTag/ci.calibration.run": "false"}}
    assert set(found["GiveRoles"]["StringEquals"]["iam:PassedToService"]) == {
        "batch.amazonaws.com",
        "ecs-tasks.amazonaws.com",
    }
    assert found["FindFiles"] == {"StringLikeIfExists": {"s3:prefix": "calibration/*"}}


def test_other_partitions_and_queues_by_arn() -> None:
    china = replace(
        SETTINGS,
        queue=f"arn:aws-cn:batch:cn-north-1:{ACCOUNT}:job-queue/q",
        region="cn-north-1",
        platform="ec2",  # Fargate requires an execution role
        job_role=f"arn:aws-cn:iam::{ACCOUNT}:role/j",
        execution_role=None,
    )
    text = json.dumps([policy(holder, china) for holder in HOLDERS])
    assert "arn:aws:" not in text
    assert allowed("caller", "batch:SubmitJob", china.queue, china)
    assert "null" not in text.lower().replace('"null"', "")  # no role that is None


@pytest.mark.parametrize("holder", HOLDERS)
def test_every_action_is_one(holder: Holder) -> None:
    """An action is an operation of its service, except for a few names that exist only in IAM."""
    own = {"s3:ListBucket", "iam:PassRole", "batch:TagResource"}
    for statement in policy(holder, SETTINGS)["Statement"]:
        for action in set(statement["Action"]) - own:
            service, operation = action.split(":")
            assert operation in Session().get_service_model(service).operation_names, action


SERVICES = {
    f"{xform_name(operation)}": f"{service}:{operation}"
    for service in ("batch", "s3", "logs", "ecr")
    for operation in Session().get_service_model(service).operation_names
}
"""Actions of the clients' methods."""
FOLDER = Path(policy_module.__file__).parent
IN_IAM = {"s3:HeadBucket": "s3:ListBucket", "s3:ListObjectsV2": "s3:ListBucket", "s3:HeadObject": "s3:GetObject"}
"""Operations whose action has another name."""


def called(*code: ast.AST) -> set[str]:
    """Return the actions that code needs for its calls."""
    actions = set()
    for tree in code:
        for node in ast.walk(tree):
            if not isinstance(node, ast.Call):
                continue
            name = ast.unparse(node.func).rpartition(".")[2]
            if name == "pages" and isinstance(node.args[1], ast.Constant):
                name = str(node.args[1].value)
            if name == "upload_fileobj":  # in parts if it is large
                actions |= {"s3:PutObject", "s3:AbortMultipartUpload"}
            elif name in SERVICES:
                actions.add(IN_IAM.get(SERVICES[name], SERVICES[name]))
    return actions


def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


def of_the_store(code: ast.AST) -> set[str]:
    """Return the methods of a store that code calls or passes on; inside of the class, of itself."""
    return {
        node.attr
        for node in ast.walk(code)
        if isinstance(node, ast.Attribute) and ast.unparse(node.value).rpartition(".")[2] in ("store", "self")
    }


def actions_of(holder: Holder) -> set[str]:
    return {action for statement in policy(holder, SETTINGS)["Statement"] for action in statement["Action"]}


def test_the_caller_has_the_permissions_of_the_code_and_no_more() -> None:
    apart = ("inside", "ecr.py")  # the task's own policy; the login of an image that is pushed
    modules = [parsed(path) for path in FOLDER.rglob("*.py") if not set(apart) & set(path.parts)]
    # tags and roles are parts of other requests
    assert actions_of("caller") == called(*modules) | {"batch:TagResource", "iam:PassRole"}


def test_the_job_has_the_permissions_of_our_containers_and_no_more() -> None:
    inside = [parsed(path) for path in (FOLDER / "inside").glob("*.py")]
    methods = {node.name: node for node in ast.walk(parsed(FOLDER / "store.py")) if isinstance(node, ast.FunctionDef)}
    used: set[str] = set()
    more = methods.keys() & {name for tree in inside for name in of_the_store(tree)}
    while more:
        used |= more
        more = methods.keys() & {name for method in more for name in of_the_store(methods[method])} - used
    assert {"put", "write", "get", "download"} <= used
    assert actions_of("job") == called(*inside, *(methods[name] for name in used))


@mock_aws
def test_iam_takes_them(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.setenv(name, "x")
    iam = boto3.client("iam", region_name="eu-west-1")
    settings = replace(SETTINGS, secrets={"A": TOKEN_ARN, "B": PARAMETER})
    iam.create_role(RoleName="calibration-job", AssumeRolePolicyDocument=json.dumps(trust()))
    for holder in HOLDERS:
        document = json.dumps(policy(holder, settings))
        assert len(document) < 6144  # size limit of a managed policy
        iam.create_policy(PolicyName=holder, PolicyDocument=document)
        sids = [statement["Sid"] for statement in policy(holder, settings)["Statement"]]
        assert all(sid.isalnum() for sid in sids)
        assert len(set(sids)) == len(sids)
