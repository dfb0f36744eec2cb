"""Images by their digest, so that all jobs of a run have the same, and a definition says which."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from calibration.aws_errors import aws_errors, error_code
from calibration.errors import InputError
from calibration.execution.batch.service.session import Aws
from calibration.registries.ecr import parse_host
from calibration.registries.reference import Reference, parse_reference

if TYPE_CHECKING:
    from botocore.exceptions import ClientError

_MISSING = ("RepositoryNotFoundException", "ImageNotFoundException")


def with_digests(aws: Aws, images: Iterable[str]) -> dict[str, str]:
    """Each image by its digest where it is in ECR; as it is written where it is elsewhere, or has one already.

    Raises:
        InputError: there is no such image, or it is not for us.
        AwsLostError: ECR does not answer.
    """
    return {image: _with_digest(aws, image) for image in dict.fromkeys(images)}


def _with_digest(aws: Aws, image: str) -> str:
    reference = parse_reference(image)
    host = parse_host(reference.registry)
    if host is None or reference.digest is not None:
        return image
    tag = reference.tag or "latest"
    with aws_errors(f"image {image}"):
        details = _describe(aws.ecr(host.region), reference, host.account, tag)
    if not details:
        raise InputError(f"image {image}: it is not in ECR: push it (calibration build-image --push true)")
    return str(reference.with_digest(str(details[0]["imageDigest"])))


def _describe(ecr: Any, reference: Reference, account: str, tag: str) -> list[dict[str, Any]]:
    import botocore.exceptions

    try:
        answer: dict[str, Any] = ecr.describe_images(
            registryId=account, repositoryName=reference.repository, imageIds=[{"imageTag": tag}]
        )
    except botocore.exceptions.ClientError as error:
        if _is_missing(error):
            return []
        raise
    return list(answer["imageDetails"])


def _is_missing(error: "ClientError") -> bool:
    return error_code(error) in _MISSING
