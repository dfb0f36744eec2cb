"""Section ``aws-batch`` of calibration.yml, from a RoboMaker simulation job."""

import re
from collections.abc import Sequence
from typing import Any

from calibration.addons.rigel.fields import Fields, Notes, plain
from calibration.base import InputError
from calibration.base.records import Place, flat_fields, read_as
from calibration.ci.execution.backends import SECTIONS

NO_REGION, NO_BUCKET, TO_DO = "xx-todo-1", "todo", "TODO"
"""Placeholders for unknown values: syntactically valid names that do not exist."""
_NO_ACCOUNT = "0" * 12
_ACCOUNT_IN_TEXT = re.compile(r"(?:^arn:[^:]*:iam::|^)([0-9]{12})(?=:role/|\.dkr\.ecr\.)")
_MAX_TAGS = 30


def batch_section(fields: Fields, region: str, *, gpu: bool, images: Sequence[str], notes: Notes) -> dict[str, Any]:
    """Return the section, and take the fields that it is made of.

    Args:
        fields: of the simulation job.
        region: region of the job; empty if unknown.
        gpu: whether it needs a GPU.
        images: images of its containers; one in ECR contains the account.
        notes: notes of the conversion.

    Raises:
        InputError: a field has the wrong type.
    """
    role, where = fields.plain("iam_role"), fields.at("iam_role")
    account = next((match[1] for text in (role, *images) if (match := _ACCOUNT_IN_TEXT.search(text))), _NO_ACCOUNT)
    bucket, prefix = _convert_output(fields, notes)
    section: dict[str, Any] = {
        "region": region if _may_have_value("region", region) else NO_REGION,
        "queue": TO_DO,
        "bucket": bucket,
    }
    if prefix:
        section["prefix"] = prefix
    section["tools-image"] = TO_DO
    section["job-role"] = role if _may_have_value("job-role", role) else f"arn:aws:iam::{account}:role/{TO_DO}"
    if section["region"] == NO_REGION:
        notes.to_do("aws-batch.region", f"{'unknown' if not region else f'{region} is not a region'}: set it")
    hosts = "of EC2 instances with a GPU" if gpu else "Fargate"
    notes.to_do("aws-batch.queue", f"write the name of a job queue whose compute environment is {hosts}")
    notes.to_do("aws-batch.tools-image", "build the image of examples/aws-batch, push it to ECR, and write its name")
    if section["job-role"] != role:
        what = f"{role} is not the ARN of a role" if role else "there is none"
        notes.to_do(where if role else "aws-batch.job-role", f"{what}: write that of the containers' role")
    else:
        why = (
            "it let robomaker.amazonaws.com take it: let ecs-tasks.amazonaws.com do so (calibration aws-policy --for "
            "trust), and give it what calibration aws-policy --for job prints"
        )
        notes.to_do(where, why)
    if gpu:
        section["platform"] = "ec2"
    else:
        section["execution-role"] = f"arn:aws:iam::{account}:role/{TO_DO}"
        notes.to_do(
            "aws-batch.execution-role",
            "write the ARN of a role that pulls images and writes logs: calibration aws-policy --for execution",
        )
    _convert_network(fields.fields("vpc_config"), section, gpu, notes)
    _convert_tags(fields, section, notes)
    _convert_policy(fields.fields("batch_policy"), section, notes)
    return section


def merged(first: dict[str, Any], second: dict[str, Any], where: str, notes: Notes) -> dict[str, Any]:
    """Merge the sections of two jobs: the second's values replace only unknown values of the first."""
    result = dict(first)
    for key, value in second.items():
        if key not in result or _is_unknown(result[key]):
            result[key] = value
        elif value != result[key] and not _is_unknown(value):
            notes.lost(where, f"there is one section aws-batch, and its {key} is {result[key]}, not {value}")
    if _is_unknown(result.get("execution-role")) and (found := _ACCOUNT_IN_TEXT.search(result["job-role"])):
        result["execution-role"] = f"arn:aws:iam::{found[1]}:role/{TO_DO}"  # both roles must belong to one account
    if result.get("platform") == "ec2" and result.pop("public-ip", None):  # one of the jobs needs a GPU
        notes.lost(where, "there is one queue, of EC2: the subnets say whether instances have a public address")
    return result


def _is_unknown(value: object) -> bool:
    return value in (NO_REGION, NO_BUCKET) or (isinstance(value, str) and value.endswith(TO_DO))


def _convert_output(fields: Fields, notes: Notes) -> tuple[str, str]:
    """Return bucket and prefix of the results, from Rigel's text or the service's mapping."""
    where, given = fields.at("output_location"), fields.take("output_location")
    if isinstance(given, dict):
        location = Fields(given, where, notes, fields.spelling)
        bucket, prefix = location.text("s3_bucket"), location.text("s3_prefix")
        location.rest()
    else:
        text = "" if given is None else str(given)
        bucket, _, prefix = text.removeprefix("s3://").partition("/")
    bucket, prefix = plain(bucket, notes, where), plain(prefix, notes, where).strip("/")
    if prefix and not _may_have_value("prefix", prefix):
        notes.lost(where, f"{prefix} is no prefix that is taken here: everything is below calibration/")
        prefix = ""
    if not _may_have_value("bucket", bucket):
        what = f"{bucket} is no name of a bucket" if bucket else "it names none"
        notes.to_do(where if given is not None else "aws-batch.bucket", f"{what}: write the bucket for the results")
        return NO_BUCKET, prefix
    return bucket, prefix


def _convert_network(vpc: Fields, section: dict[str, Any], gpu: bool, notes: Notes) -> None:
    for key, what in (("subnets", "subnets"), ("security_groups", "security groups")):
        names = vpc.plains(key)
        if names:
            why = f"they belong to the compute environment of the queue: set its {what} to {', '.join(names)}"
            notes.to_do(vpc.at(key), why)
    public = vpc.truth("assign_public_ip")
    if public and gpu:
        notes.lost(vpc.at("assign_public_ip"), "on EC2 the subnets say whether instances have a public address")
    elif public:
        section["public-ip"] = True
    vpc.rest()


def _convert_tags(fields: Fields, section: dict[str, Any], notes: Notes) -> None:
    tags: dict[str, str] = {}
    where = fields.at("tags")
    for key, value in fields.mapping("tags").items():
        texts = plain(key, notes, where), plain(str(value), notes, where)
        if len(tags) == _MAX_TAGS or not _accepts_value("tags", dict([texts])):
            notes.lost(f"{where}.{key}", f"at most {_MAX_TAGS} tags of letters, digits and _ . : / = + - @ are taken")
        else:
            tags[texts[0]] = texts[1]
    if tags:
        section["tags"] = tags


def _convert_policy(policy: Fields, section: dict[str, Any], notes: Notes) -> None:
    """Convert the policy of a batch of jobs."""
    seconds = policy.take("timeout_in_seconds")
    if isinstance(seconds, int | float) and not isinstance(seconds, bool) and seconds > 0:
        section["deadline"] = f"{seconds}s"
    if policy.take("max_concurrency") is not None:
        why = "the number of concurrent jobs is limited by the maximum of vCPUs of the compute environment"
        notes.to_do(policy.at("max_concurrency"), why)
    policy.rest()


def _may_have_value(key: str, value: str) -> bool:
    """Return whether a key accepts a value; a reference to the environment is checked only at run time."""
    return "${" in value or _accepts_value(key, value)


def _accepts_value(key: str, value: object) -> bool:
    if "aws-batch" not in SECTIONS:  # the add-on is not installed, and so its limits of values are unknown
        return True
    settings, _ = SECTIONS["aws-batch"]
    try:
        read_as(flat_fields(settings)[key].type, value, Place(""))
    except InputError:
        return False
    return True
