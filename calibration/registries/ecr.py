"""AWS's registry (ECR): a password for some hours, and a repository where there is none."""

import base64
from typing import Any

import boto3
from botocore.config import Config

from calibration.aws_errors import aws_errors
from calibration.errors import InfrastructureError
from calibration.registries.credentials import Credentials
from calibration.registries.reference import ECR_PUBLIC, Reference, ecr_host, parse_reference
from calibration.workflow import Runner, add_mask

PUBLIC_REGION = "us-east-1"
"""Where the public registry has its only interface."""


def ecr_credentials(name: str, runner: Runner, create_repository: bool = False, insecure: bool = False) -> Credentials:
    """Get the password for an image's registry from AWS, and its repository where that is asked for.

    boto3 finds who one is as AWS's own tools do: variables, profile, role, OIDC; ``AWS_ENDPOINT_URL`` leads it
    elsewhere. A registry that is none of AWS's by its host is taken for one in the region of the environment.

    Args:
        name: of the image.
        runner: where what is secret is masked.
        create_repository: whether a repository that is missing is made.
        insecure: as in the settings.

    Raises:
        InputError: there are no credentials, they are expired or unknown, or may not do this.
        InfrastructureError: AWS cannot be reached, throttles, or fails.
    """
    reference = parse_reference(name)
    with aws_errors(reference.name, "ecr-public" if reference.registry == ECR_PUBLIC else "ecr"):
        client: Any = _client(reference.registry)
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


def _client(registry: str) -> object:
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
            return  # somebody else was faster
        runner.log(f"created the repository {reference.name}")
