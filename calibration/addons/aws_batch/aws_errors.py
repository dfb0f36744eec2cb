"""Errors of AWS as one-line messages: who has to do what, or that a retry may succeed."""

from collections.abc import Iterator
from contextlib import contextmanager

import botocore.exceptions as aws
from boto3.exceptions import Boto3Error

from calibration.base.errors import CalibrationError, InfrastructureError, InputError
from calibration.base.text import one_line, shorten

_CODES_OF_EXPIRY = ("ExpiredToken", "ExpiredTokenException", "RequestExpired", "TokenRefreshRequired")
_CODES_OF_UNKNOWN_CREDENTIALS = (
    "UnrecognizedClientException",
    "InvalidClientTokenId",
    "InvalidAccessKeyId",
    "InvalidSignatureException",
    "SignatureDoesNotMatch",
    "InvalidToken",
    "MissingAuthenticationToken",
    "IncompleteSignature",
)
_CODES_OF_DENIAL = (
    "AccessDenied",
    "AccessDeniedException",
    "UnauthorizedOperation",
    "NotAuthorized",
    "Forbidden",
    "403",
)
THROTTLING_CODES = (
    "Throttling",
    "ThrottlingException",
    "ThrottledException",
    "TooManyRequestsException",
    "RequestLimitExceeded",
    "RequestThrottled",
    "SlowDown",
    "429",
)
_CODES_OF_OTHER_REGION = (
    "PermanentRedirect",
    "AuthorizationHeaderMalformed",
    "IllegalLocationConstraintException",
    "MovedPermanently",
    "301",
)
_CODES_OF_WRONG_CLOCK = ("RequestTimeTooSkewed", "RequestInTheFuture")
_ACTION_OF_OPERATION = {
    "HeadBucket": "s3:ListBucket",
    "ListObjectsV2": "s3:ListBucket",
    "HeadObject": "s3:GetObject",
    "GetObject": "s3:GetObject",
    "PutObject": "s3:PutObject",
    "CreateMultipartUpload": "s3:PutObject",
    "UploadPart": "s3:PutObject",
    "CompleteMultipartUpload": "s3:PutObject",
    "AbortMultipartUpload": "s3:AbortMultipartUpload",
    "GetLogEvents": "logs:GetLogEvents",
    "DescribeImages": "ecr:DescribeImages",
    "AssumeRoleWithWebIdentity": "sts:AssumeRoleWithWebIdentity",
}
"""IAM actions of operations whose action has another name or service than the operation."""


class AwsLostError(InfrastructureError):
    """AWS is unreachable, throttles or fails temporarily: a retry may succeed."""


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
    except (
        aws.CredentialRetrievalError,
        aws.ProfileNotFound,
        aws.ConfigNotFound,
        aws.ConfigParseError,
        aws.InvalidRegionError,
        aws.ParamValidationError,
        aws.SSOError,
        aws.TokenRetrievalError,
        aws.UnknownServiceError,
    ) as error:
        raise InputError(f"{where}: AWS: {_shorten_text(error)}") from None
    except aws.EndpointConnectionError as error:
        raise AwsLostError(f"{where}: AWS: {_shorten_text(error)}: check the network, and the region's name") from None
    except (aws.ConnectionError, aws.HTTPClientError, aws.IncompleteReadError) as error:
        raise AwsLostError(f"{where}: AWS: {_shorten_text(error)}") from None
    except (aws.BotoCoreError, Boto3Error, ValueError) as error:  # ValueError: an invalid URL or timestamp
        raise InfrastructureError(f"{where}: AWS: {_shorten_text(error)}") from None


def error_code(error: aws.ClientError) -> str:
    """Return the error code of AWS's answer: ``NoSuchKey``; for HEAD requests only the HTTP status."""
    return str(error.response.get("Error", {}).get("Code", "")) or "unknown error"


def _error_of_answer(where: str, service: str, error: aws.ClientError) -> CalibrationError:
    """Return the error to raise for an answer of AWS."""
    code = error_code(error)
    action = _ACTION_OF_OPERATION.get(error.operation_name, f"{service}:{error.operation_name}")
    failure = f"{where}: AWS: {action}: {one_line(code)}"
    status = error.response.get("ResponseMetadata", {}).get("HTTPStatusCode", 500)
    if code in _CODES_OF_EXPIRY:
        return InputError(f"{failure}: the credentials are expired: get new ones")
    if code in _CODES_OF_UNKNOWN_CREDENTIALS:
        return InputError(f"{failure}: AWS does not know these credentials: check key, secret and token")
    if code in _CODES_OF_WRONG_CLOCK:
        return InfrastructureError(f"{failure}: the clock of this machine is wrong")
    if code in _CODES_OF_DENIAL:
        policy = " (calibration aws-policy prints a policy)" if service == "batch" else ""
        return InputError(f"{failure}: the role or user needs this permission{policy}")
    if code in THROTTLING_CODES:
        return AwsLostError(f"{failure}: too many requests, also after several tries: try again later")
    if code in _CODES_OF_OTHER_REGION or status == 301:
        headers = error.response.get("ResponseMetadata", {}).get("HTTPHeaders", {})
        region = headers.get("x-amz-bucket-region")
        there = f": it is in {one_line(shorten(region))}" if region else ""
        return InputError(f"{failure}: the bucket is in another region{there}")
    if code in ("NoSuchBucket", "404") and error.operation_name in ("HeadBucket", "PutObject", "ListObjectsV2"):
        return InputError(f"{failure}: there is no such bucket")
    line = f"{failure}: {_shorten_text(error.response.get('Error', {}).get('Message', ''))}"
    if status >= 500 or code in ("RequestTimeout", "InternalError", "ServerException", "ServiceUnavailable"):
        return AwsLostError(line)
    return InputError(line)


def _shorten_text(text: object) -> str:
    return shorten(one_line(str(text)), 300)
