"""Sessions with AWS: errors as one-line messages, credentials, clients, and retries.

boto3 finds credentials as AWS's own tools do; in a GitHub job with permission for OIDC tokens, the role is assumed with
a new token each time, so that a run may outlast one. ``AWS_ENDPOINT_URL`` and ``AWS_ENDPOINT_URL_<SERVICE>`` replace
the addresses of services.
"""

import json
import os
import random
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import Any, TypeVar
from urllib.parse import urlsplit

import boto3
import botocore.exceptions as aws
import botocore.session
from boto3.exceptions import Boto3Error
from botocore.config import Config
from botocore.credentials import AssumeRoleWithWebIdentityCredentialFetcher, DeferredRefreshableCredentials

from calibration.base import CalibrationError, InfrastructureError, InputError, one_line, shorten
from calibration.base.http import Http

_ACTION_OF_OPERATION = {
    **dict.fromkeys(("HeadBucket", "ListObjectsV2"), "s3:ListBucket"),
    **dict.fromkeys(("HeadObject", "GetObject"), "s3:GetObject"),
    **dict.fromkeys(("PutObject", "CreateMultipartUpload", "UploadPart", "CompleteMultipartUpload"), "s3:PutObject"),
    "AbortMultipartUpload": "s3:AbortMultipartUpload",
    "GetLogEvents": "logs:GetLogEvents",
    "DescribeImages": "ecr:DescribeImages",
    "AssumeRoleWithWebIdentity": "sts:AssumeRoleWithWebIdentity",
}
"""IAM actions of operations whose action has another name or service than the operation."""


class AwsLostError(InfrastructureError):
    """AWS is unreachable, throttles or fails temporarily: a retry may succeed."""


_ERRORS_OF_SETTINGS = (
    *(aws.CredentialRetrievalError, aws.ProfileNotFound, aws.ConfigNotFound, aws.ConfigParseError, aws.SSOError),
    *(aws.InvalidRegionError, aws.ParamValidationError, aws.TokenRetrievalError, aws.UnknownServiceError),
)
_CODES_OF_DENIAL = (
    "AccessDenied",
    "AccessDeniedException",
    "UnauthorizedOperation",
    "NotAuthorized",
    "Forbidden",
    "403",
)
_CODES_OF_OTHER_REGION = (
    *("PermanentRedirect", "AuthorizationHeaderMalformed", "IllegalLocationConstraintException", "MovedPermanently"),
    "301",
)
_CODES_OF_FAILURE = ("RequestTimeout", "InternalError", "ServerException", "ServiceUnavailable")
_ERROR_OF_CODES: tuple[tuple[tuple[str, ...], type[CalibrationError], str], ...] = (
    (
        ("ExpiredToken", "ExpiredTokenException", "RequestExpired", "TokenRefreshRequired"),
        InputError,
        "the credentials are expired: get new ones",
    ),
    (
        (
            *("UnrecognizedClientException", "InvalidClientTokenId", "InvalidAccessKeyId", "InvalidSignatureException"),
            *("SignatureDoesNotMatch", "InvalidToken", "MissingAuthenticationToken", "IncompleteSignature"),
        ),
        InputError,
        "AWS does not know these credentials: check key, secret and token",
    ),
    (
        ("RequestTimeTooSkewed", "RequestInTheFuture"),
        InfrastructureError,
        "the clock of this machine is wrong",
    ),
    (
        (
            *("Throttling", "ThrottlingException", "ThrottledException", "TooManyRequestsException"),
            *("RequestLimitExceeded", "RequestThrottled", "SlowDown", "429"),
        ),
        AwsLostError,
        "too many requests, also after several tries: try again later",
    ),
)
"""Codes of AWS's answers, each with the error to raise and its message."""


@contextmanager
def aws_errors(where: str, service: str = "batch") -> Iterator[None]:
    """Convert exceptions of boto3 to errors with a one-line message.

    Args:
        where: prefix of the messages.
        service: IAM prefix of the service that is called; operations in `_ACTION_OF_OPERATION` have their own.

    Raises:
        InputError: credentials are missing, expired, unknown or lack a permission, or the request is invalid.
        AwsLostError: AWS cannot be reached, throttles, or fails.
    """
    try:
        yield
    except aws.ClientError as error:
        raise _error_of_answer(where, service, error) from None
    except aws.NoRegionError:
        raise InputError(f"{where}: AWS's region is not known: set AWS_REGION") from None
    except (aws.NoCredentialsError, aws.PartialCredentialsError):
        hint = "set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, a profile, or let the workflow assume a role"
        raise InputError(f"{where}: AWS: there are no credentials: {hint}") from None
    except _ERRORS_OF_SETTINGS as error:
        raise InputError(f"{where}: AWS: {_shorten_text(error)}") from None
    except aws.EndpointConnectionError as error:
        raise AwsLostError(f"{where}: AWS: {_shorten_text(error)}: check the network, and the region's name") from None
    except (aws.ConnectionError, aws.HTTPClientError, aws.IncompleteReadError) as error:
        raise AwsLostError(f"{where}: AWS: {_shorten_text(error)}") from None
    except (aws.BotoCoreError, Boto3Error, ValueError) as error:  # ValueError: an invalid URL or timestamp
        raise InfrastructureError(f"{where}: AWS: {_shorten_text(error)}") from None


def pages(client: Any, operation: str, where: str, **request: Any) -> Iterator[dict[str, Any]]:
    """Yield the pages of an answer, such as of ``list_jobs``.

    Raises:
        InputError, AwsLostError: see `aws_errors`.
    """
    found = iter(client.get_paginator(operation).paginate(**request))
    while True:
        with aws_errors(where):
            page = next(found, None)
        if page is None:
            return
        yield page


def error_code(error: aws.ClientError) -> str:
    """Return the error code of AWS's answer: ``NoSuchKey``; for HEAD requests only the HTTP status."""
    return str(error.response.get("Error", {}).get("Code", "")) or "unknown error"


def _error_of_answer(where: str, service: str, error: aws.ClientError) -> CalibrationError:
    """Return the error to raise for an answer of AWS."""
    code = error_code(error)
    action = _ACTION_OF_OPERATION.get(error.operation_name, f"{service}:{error.operation_name}")
    failure = f"{where}: AWS: {action}: {one_line(code)}"
    status = error.response.get("ResponseMetadata", {}).get("HTTPStatusCode", 500)
    for codes, kind, advice in _ERROR_OF_CODES:
        if code in codes:
            return kind(f"{failure}: {advice}")
    if code in _CODES_OF_DENIAL:
        policy = " (calibration aws-policy prints a policy)" if service == "batch" else ""
        return InputError(f"{failure}: the role or user needs this permission{policy}")
    if code in _CODES_OF_OTHER_REGION or status == 301:
        headers = error.response.get("ResponseMetadata", {}).get("HTTPHeaders", {})
        region = headers.get("x-amz-bucket-region")
        there = f": it is in {one_line(shorten(region))}" if region else ""
        return InputError(f"{failure}: the bucket is in another region{there}")
    if code in ("NoSuchBucket", "404") and error.operation_name in ("HeadBucket", "PutObject", "ListObjectsV2"):
        return InputError(f"{failure}: there is no such bucket")
    line = f"{failure}: {_shorten_text(error.response.get('Error', {}).get('Message', ''))}"
    if status >= 500 or code in _CODES_OF_FAILURE:
        return AwsLostError(line)
    return InputError(line)


def _shorten_text(text: object) -> str:
    return shorten(one_line(str(text)), 300)


Result = TypeVar("Result")

LONGEST_OUTAGE = 300.0
"""Seconds for which AWS may be unreachable, beyond boto3's own retries."""
_FIRST_DELAY, _MAX_DELAY = 1.0, 30.0


class Backoff:
    """Retry delays of a service, and their time-out."""

    def __init__(self, seconds: float = LONGEST_OUTAGE) -> None:
        self._seconds = seconds
        self._since: float | None = None
        self._delay = _FIRST_DELAY

    def answered(self) -> None:
        """Record an answer."""
        self._since, self._delay = None, _FIRST_DELAY

    def failed(self, error: AwsLostError) -> float:
        """Record a failure.

        Returns:
            Seconds until the next attempt.

        Raises:
            AwsLostError: the time-out has passed.
        """
        now = time.monotonic()
        self._since = now if self._since is None else self._since
        if now - self._since >= self._seconds:
            raise error
        delay, self._delay = self._delay, min(_MAX_DELAY, 2 * self._delay)
        return delay * random.uniform(0.75, 1.25)  # noqa: S311 (jitter, to spread simultaneous clients)


def with_retries(ask: Callable[[], Result], go_on: Callable[[], bool] = lambda: True) -> Result:
    """Repeat a call until it succeeds.

    Args:
        ask: call that may raise `AwsLostError`.
        go_on: returns whether a failed call is repeated.

    Raises:
        AwsLostError: the time-out has passed.
    """
    backoff = Backoff()
    while True:
        try:
            return ask()
        except AwsLostError as error:
            delay = backoff.failed(error)
            if not go_on():
                raise
            time.sleep(delay)


MAX_TRIES = 8
"""Attempts of a call that AWS throttles or fails, with increasing delays."""
MAX_CONNECTIONS = 32
_OIDC_AUDIENCE = "sts.amazonaws.com"
_TOKEN_URL_VARIABLE, _TOKEN_VARIABLE = "ACTIONS_ID_TOKEN_REQUEST_URL", "ACTIONS_ID_TOKEN_REQUEST_TOKEN"


class Aws:
    """Clients of the services of one region. Thread-safe."""

    def __init__(self, region: str) -> None:
        """Create the session, without a request to AWS."""
        self.region = region
        self.calls: Counter[str] = Counter()
        """Number of requests by ``batch:DescribeJobs``, including retries."""
        self._lock = threading.RLock()
        self._clients: dict[str, Any] = {}

    @property
    def batch(self) -> Any:
        """Client of AWS Batch."""
        return self._client_of_service("batch")

    @property
    def submitting(self) -> Any:
        """Client of AWS Batch for calls that are not idempotent: without retries."""
        return self._client_of_service("batch", tries=1)

    @property
    def s3(self) -> Any:
        """Client of S3."""
        return self._client_of_service("s3")

    @property
    def logs(self) -> Any:
        """Client of CloudWatch Logs."""
        return self._client_of_service("logs")

    def ecr(self, region: str) -> Any:
        """Return the client of a region's registry."""
        return self._client_of_service("ecr", region=region)

    def close(self) -> None:
        """Close the connections."""
        with self._lock:
            clients, self._clients = self._clients, {}
        for client in clients.values():
            client.close()

    def _client_of_service(self, service: str, tries: int = MAX_TRIES, region: str | None = None) -> Any:
        key = f"{service} {tries} {region}"
        with self._lock:
            if key not in self._clients:
                self._clients[key] = self._new_client(service, tries, region or self.region)
            return self._clients[key]

    def _new_client(self, service: str, tries: int, region: str) -> Any:
        own_endpoint = os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL")
        config = Config(
            retries={"mode": "standard", "total_max_attempts": tries},
            connect_timeout=10,
            read_timeout=60,
            max_pool_connections=MAX_CONNECTIONS,
            tcp_keepalive=True,
            s3={"addressing_style": "path" if own_endpoint else "auto"},
        )
        with aws_errors(f"region {region}"):
            client: Any = self._boto_session.client(service, region_name=region, config=config)
        client.meta.events.register("before-send", self._count_call)
        return client

    @cached_property
    def _boto_session(self) -> Any:
        with aws_errors(f"region {self.region}"):
            session = botocore.session.get_session()
            _take_role_by_tokens_of_github(session, self.region)
            return boto3.session.Session(botocore_session=session, region_name=self.region)

    def _count_call(self, event_name: str, **_: object) -> None:
        service, operation = event_name.split(".")[1:3]
        with self._lock:
            self.calls[f"{service}:{operation}"] += 1


def _take_role_by_tokens_of_github(session: Any, region: str) -> None:
    """Assume the role of a GitHub job with a new OIDC token whenever its credentials expire."""
    url, secret = os.environ.get(_TOKEN_URL_VARIABLE), os.environ.get(_TOKEN_VARIABLE)
    scoped = session.get_scoped_config()
    by_file = scoped.get("role_arn") if "web_identity_token_file" in scoped else None
    role = os.environ.get("AWS_ROLE_ARN") or by_file
    if not url or not secret or not role:
        return

    def create(service: str, **settings: Any) -> Any:
        return session.create_client(service, region_name=region, **settings)

    fetcher = AssumeRoleWithWebIdentityCredentialFetcher(
        client_creator=create,
        web_identity_token_loader=lambda: _token_of_github(url, secret),
        role_arn=role,
        extra_args={"RoleSessionName": os.environ.get("AWS_ROLE_SESSION_NAME") or "calibration-ci"},
    )
    session._credentials = DeferredRefreshableCredentials(fetcher.fetch_credentials, "calibration-ci-github")


def _token_of_github(url: str, secret: str) -> str:
    """Request an OIDC token of the current job from GitHub.

    Raises:
        InfrastructureError: GitHub returns no token.
    """
    if urlsplit(url).scheme not in ("https", "http"):
        raise InfrastructureError(f"GitHub's token service: {_TOKEN_URL_VARIABLE} is no URL")
    http = Http([secret], address=_TOKEN_URL_VARIABLE)
    try:
        answer = http.send("GET", f"{url}&audience={_OIDC_AUDIENCE}", {"Authorization": f"bearer {secret}"})
        token = str(json.loads(answer.body)["value"])
    except (InfrastructureError, ValueError, LookupError, TypeError, RecursionError) as error:
        why = f"answered {answer.status}" if not isinstance(error, InfrastructureError) else error
        raise InfrastructureError(f"GitHub's token service gives no token for a role in AWS ({why})") from None
    finally:
        http.close()
    return token
