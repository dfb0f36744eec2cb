"""Job definitions: a new revision only where what it says differs from the newest that there is."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from calibration.aws_errors import aws_errors
from calibration.execution.batch.requests.definition import DIGEST_TAG
from calibration.execution.batch.service.session import Aws


def ensure(aws: Aws, request: Mapping[str, Any]) -> str:
    """Register a definition, unless there is one that says the same.

    Args:
        aws: where.
        request: of RegisterJobDefinition, with its digest in the tags.

    Returns:
        The ARN, with the revision.

    Raises:
        InputError: it is not allowed, or AWS refuses what it says.
        AwsLostError: AWS does not answer.
    """
    name = str(request["jobDefinitionName"])
    digest = request["tags"][DIGEST_TAG]
    for definition in _active(aws, name):
        if definition.get("tags", {}).get(DIGEST_TAG) == digest:
            return str(definition["jobDefinitionArn"])
    with aws_errors(f"job definition '{name}'"):
        # done twice, because an answer was lost, it is another revision that says the same
        return str(aws.batch.register_job_definition(**request)["jobDefinitionArn"])


def find_old(aws: Aws) -> list[str]:
    """The ARNs of all revisions of definitions of ours but the newest of each.

    Raises:
        InputError: it is not allowed.
        AwsLostError: AWS does not answer.
    """
    revisions: dict[str, dict[int, str]] = {}
    for definition in _active(aws):
        if DIGEST_TAG in definition.get("tags", {}):
            of_name = revisions.setdefault(str(definition["jobDefinitionName"]), {})
            of_name[int(definition["revision"])] = str(definition["jobDefinitionArn"])
    return [arn for found in revisions.values() for revision, arn in sorted(found.items()) if revision != max(found)]


def deregister(aws: Aws, arns: Iterable[str]) -> None:
    """Deregister revisions of definitions.

    Raises:
        InputError: it is not allowed.
        AwsLostError: AWS does not answer.
    """
    for arn in arns:
        with aws_errors(f"job definition {arn}"):
            aws.batch.deregister_job_definition(jobDefinition=arn)


def _active(aws: Aws, name: str | None = None) -> Iterator[dict[str, Any]]:
    """Definitions of a name, or all, that jobs can be submitted with."""
    chosen = {} if name is None else {"jobDefinitionName": name}
    token: dict[str, str] = {}
    while True:
        with aws_errors("job definitions" if name is None else f"job definition '{name}'"):
            page = aws.batch.describe_job_definitions(status="ACTIVE", **chosen, **token)
        yield from page["jobDefinitions"]
        if not page.get("nextToken"):
            return
        token = {"nextToken": page["nextToken"]}
