"""Credentials for AWS's registry ECR, and creation of a missing repository."""

import base64
from typing import Any

import boto3
from botocore.config import Config

from calibration.addons.aws_batch.session import aws_errors
from calibration.base import InfrastructureError
from calibration.ci.registries.reference import ECR_PUBLIC, Credentials, Reference, ecr_host, parse_reference
from calibration.ci.workflow import Runner, add_mask

PUBLIC_REGION = "us-east-1"
"""The only region of the public registry's API."""


def ecr_credentials(name: str, runner: Runner, create_repository: bool = False, insecure: bool = False) -> Credentials:
    """Get the password of an image's registry from AWS, and create its repository on request.

    boto3 finds the AWS credentials as usual: variables, profile, role, OIDC; ``AWS_ENDPOINT_URL`` replaces the address.
    A registry whose host is not of AWS is taken for one in the region of the environment.

    Args:
        name: name of the image.
        runner: runner that masks the secrets.
        create_repository: whether a missing repository is created.
        insecure: as in the settings.

    Raises:
        InputError: there are no credentials, they are expired or unknown, or lack a permission.
        InfrastructureError: AWS cannot be reached, throttles, or fails.
    """
    reference = parse_reference(name)
    with aws_errors(reference.name, "ecr-public" if reference.registry == ECR_PUBLIC else "ecr"):
        client: Any = _create_client(reference.registry)
        try:
            data = client.get_authorization_token().get("authorizationData")
            if create_repository:
                _create_repository(client, reference, runner)
        finally:
            client.close()
    try:
        token = (data if reference.registry == ECR_PUBLIC else data[0])["authorizationToken"]
        username, colon, password = base64.b64decode(token, validate=True).decode().partition(":")
    except (LookupError, TypeError, ValueError):
        token = colon = ""
    if not colon:
        raise InfrastructureError(f"{reference.name}: AWS answers without a token")
    add_mask(runner, token)
    return Credentials(reference.registry, username, password, insecure=insecure)


def _create_client(registry: str) -> object:
    host = ecr_host(registry)
    region = PUBLIC_REGION if registry == ECR_PUBLIC else host.region if host else None
    return boto3.session.Session().client(
        "ecr-public" if registry == ECR_PUBLIC else "ecr",
        region_name=region,
        config=Config(retries={"mode": "standard", "total_max_attempts": 4}, connect_timeout=10, read_timeout=30),
    )


def _create_repository(client: Any, reference: Reference, runner: Runner) -> None:
    repository = reference.repository
    if reference.registry == ECR_PUBLIC:  # public.ecr.aws/<alias>/<repository>
        repository = repository.partition("/")[2]
    host = ecr_host(reference.registry)
    account = {"registryId": host.account} if host else {}
    try:
        client.describe_repositories(repositoryNames=[repository], **account)
    except client.exceptions.RepositoryNotFoundException:
        try:
            client.create_repository(repositoryName=repository, **account)
        except client.exceptions.RepositoryAlreadyExistsException:
            return  # created meanwhile by another process
        runner.log(f"created the repository {reference.name}")
