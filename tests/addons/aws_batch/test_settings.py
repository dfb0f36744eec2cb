from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

from calibration.addons.aws_batch.settings import BatchSettings, Prices
from calibration.base import InputError
from calibration.base.records import flat_fields, read

ACCOUNT = "123456789012"
NEEDED: dict[str, Any] = {
    "region": "eu-west-1",
    "queue": "robots",
    "bucket": "team-robots",
    "tools-image": f"{ACCOUNT}.dkr.ecr.eu-west-1.amazonaws.com/calibration-ci:1",
    "job-role": f"arn:aws:iam::{ACCOUNT}:role/calibration-job",
    "execution-role": f"arn:aws:iam::{ACCOUNT}:role/calibration-execution",
}
WHERE = "calibration.yml: aws-batch"


def refused(**changes: Any) -> str:
    with pytest.raises(InputError) as caught:
        read(BatchSettings, {**NEEDED, **{key.replace("_", "-"): value for key, value in changes.items()}}, WHERE)
    return str(caught.value)


def test_required_settings_are_sufficient() -> None:
    assert read(BatchSettings, NEEDED, WHERE) == BatchSettings(
        region="eu-west-1",
        queue="robots",
        bucket="team-robots",
        tools_image=NEEDED["tools-image"],
        job_role=NEEDED["job-role"],
        execution_role=NEEDED["execution-role"],
    )


def test_every_key() -> None:
    secret = f"arn:aws:secretsmanager:eu-west-1:{ACCOUNT}:secret:token-AbCdEf"
    entry = {
        **NEEDED,
        "queue": f"arn:aws:batch:eu-west-1:{ACCOUNT}:job-queue/robots",
        "prefix": "team/calibration",
        "platform": "fargate",
        "architecture": "arm64",
        "spot": True,
        "attempts": 10,
        "cpus": 0.5,
        "memory": "512m",
        "disk": 200,
        "public-ip": True,
        "deadline": "6h",
        "stuck": 90,
        "secrets": {"TOKEN": secret},
        "tags": {"team": "robots"},
        "priority": 7,
        "share": "nightly",
        "log-group": "/team/robots",
        "prices": {"vcpu-hour": 0.04, "gb-hour": 0.0044, "currency": "EUR"},
    }
    settings = read(BatchSettings, entry, WHERE)
    assert settings == BatchSettings(
        region="eu-west-1",
        queue=f"arn:aws:batch:eu-west-1:{ACCOUNT}:job-queue/robots",
        bucket="team-robots",
        tools_image=NEEDED["tools-image"],
        job_role=NEEDED["job-role"],
        execution_role=NEEDED["execution-role"],
        prefix="team/calibration",
        architecture="arm64",
        spot=True,
        attempts=10,
        cpus=0.5,
        memory=512 * 1024**2,
        disk=200,
        public_ip=True,
        deadline=6 * 3600.0,
        stuck=90.0,
        secrets={"TOKEN": secret},
        tags={"team": "robots"},
        priority=7,
        share="nightly",
        log_group="/team/robots",
        prices=Prices(0.04, 0.0044, "EUR"),
    )
    ec2 = read(BatchSettings, {**NEEDED, "platform": "ec2", "shared-hosts": False}, WHERE)
    assert (ec2.platform, ec2.shared_hosts) == ("ec2", False)
    # fields and keys correspond one to one
    keys = {*entry, "shared-hosts"}
    assert {field.name.replace("_", "-") for field in fields(BatchSettings)} == keys
    assert flat_fields(BatchSettings).keys() == keys


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"regoin": "x"}, "unknown key 'regoin': did you mean 'region'?"),
        ({"region": "Ireland"}, "region: found 'Ireland', expected the name of a region such as eu-west-1"),
        ({"queue": "two words"}, "queue: found 'two words', expected the name or the ARN of a job queue"),
        ({"bucket": "s3://team/robots"}, "bucket: found 's3://team/robots', expected the name of an S3 bucket"),
        ({"prefix": "/a"}, "prefix: found '/a', expected folders such as team/calibration"),
        ({"prefix": "a/../b"}, "expected folders such as"),
        ({"prefix": "a//b"}, "expected folders such as"),
        ({"job_role": "calibration"}, "job-role: found 'calibration', expected the ARN of a role"),
        (
            {"execution_role": f"arn:aws:iam::{ACCOUNT}:user/x"},
            "expected the ARN of a role: arn:aws:iam::ACCOUNT:role/NAME",
        ),
        ({"platform": "eks"}, "platform: found 'eks', expected fargate or ec2"),
        ({"attempts": 11}, "attempts: found 11, expected a whole number from 1 to 10"),
        ({"attempts": 0}, "attempts: found 0, expected a whole number from 1 to 10"),
        ({"cpus": 0}, "cpus: found 0, expected a number above 0 and of at most 192"),
        ({"memory": "much"}, "aws-batch: memory: found 'much', expected a size"),
        ({"disk": 20}, "disk: found 20, expected a whole number from 21 to 200"),
        ({"deadline": "soon"}, "aws-batch: deadline: found 'soon', expected a time"),
        ({"stuck": 0}, "aws-batch: stuck: found 0.0, expected a time"),
        ({"secrets": {"TOKEN": "s3cret"}}, "secrets.TOKEN: expected the ARN of a secret or parameter"),
        ({"secrets": {"A B": f"arn:aws:ssm:eu-west-1:{ACCOUNT}:parameter/a"}}, "secrets: "),
        ({"tags": {"aws:x": "1"}}, "expected letters"),
        ({"tags": {"ci.calibration.run": "1"}}, "expected letters"),
        ({"tags": {"a": "ü"}}, "tags.a: found 'ü', expected letters"),
        ({"tags": {"a": "b\n"}}, "aws-batch: tags.a: found 'b\\n', expected letters"),
        ({"queue": "robots\n"}, "aws-batch: queue: found 'robots\\n', expected the name"),
        ({"priority": 1}, "priority orders the jobs of a share: set share too"),
        ({"prices": {"vcpu-hour": 1}}, "prices: missing key 'gb-hour'"),
        ({"platform": "ec2", "disk": 30}, "disk: platform ec2 does not support it: remove it, or set fargate"),
        ({"platform": "ec2", "public_ip": True}, "public-ip: platform ec2 does not support it"),
        ({"shared_hosts": False}, "shared-hosts: platform fargate does not support it: remove it, or set ec2"),
        ({"queue": f"arn:aws:batch:us-east-1:{ACCOUNT}:job-queue/q"}, "queue: it is in us-east-1, but region is eu-"),
        (
            {"execution_role": "arn:aws:iam::210987654321:role/x"},
            "it is of another account than job-role: 123456789012",
        ),
    ],
)
def test_invalid_settings(changes: dict[str, Any], message: str) -> None:
    said = refused(**changes)
    assert message in said
    assert said.startswith("calibration.yml: aws-batch")


def test_a_wrong_secret_is_not_repeated() -> None:
    assert "s3cret" not in refused(secrets={"TOKEN": "s3cret"})


@pytest.mark.parametrize("key", ["region", "queue", "bucket", "tools-image", "job-role"])
def test_missing_settings(key: str) -> None:
    with pytest.raises(InputError, match=f"missing key '{key}'"):
        read(BatchSettings, {name: value for name, value in NEEDED.items() if name != key}, WHERE)


def test_the_execution_role_is_missing() -> None:
    entry = {key: value for key, value in NEEDED.items() if key != "execution-role"}
    with pytest.raises(InputError, match=r"execution-role: it is missing: fargate pulls images"):
        read(BatchSettings, entry, WHERE)
    assert read(BatchSettings, {**entry, "platform": "ec2"}, WHERE).execution_role is None
    secrets = {"TOKEN": f"arn:aws:ssm:eu-west-1:{ACCOUNT}:parameter/token"}
    with pytest.raises(InputError, match=r"execution-role: it is missing: secrets are read"):
        read(BatchSettings, {**entry, "platform": "ec2", "secrets": secrets}, WHERE)


@pytest.mark.parametrize("entry", [None, "fargate", ["region"]])
def test_no_keys_at_all(entry: object) -> None:
    with pytest.raises(InputError, match=r"expected keys: region, queue"):
        read(BatchSettings, entry, WHERE)


def test_every_key_of_the_section_is_described() -> None:
    text = (Path(__file__).parents[3] / "docs" / "aws-batch.md").read_text()
    rows = "\n".join(line.split(" | ")[0] for line in text.splitlines() if line.startswith("| `"))
    assert [key for key in flat_fields(BatchSettings) if f"`{key}`" not in rows] == []
