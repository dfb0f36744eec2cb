"""The way into AWS: who we are, where its services are, and what its errors mean.

boto3 finds credentials as AWS's own tools do; in a GitHub job that may ask for tokens, a role is taken by a fresh token
each time, so that a run may last longer than one. ``AWS_ENDPOINT_URL`` and ``AWS_ENDPOINT_URL_<SERVICE>`` lead
elsewhere.
"""

import json
import os
import random
import threading
import time
from collections import Counter
from collections.abc import Callable
from functools import cached_property
from typing import Any, TypeVar
from urllib.parse import urlsplit

import boto3
import botocore.session
from botocore.config import Config
from botocore.credentials import AssumeRoleWithWebIdentityCredentialFetcher, DeferredRefreshableCredentials

from calibration.aws_errors import AwsLostError, aws_errors
from calibration.errors import InfrastructureError
from calibration.http import Http

Result = TypeVar("Result")

PATIENCE = 300.0
"""Seconds that AWS may be away, beyond what boto3 tries by itself."""
_FIRST, _LONGEST = 1.0, 30.0


class Patience:
    """How long something that answered before has not answered."""

    def __init__(self, seconds: float = PATIENCE) -> None:
        self._seconds = seconds
        self._since: float | None = None
        self._delay = _FIRST

    def answered(self) -> None:
        """Note that it did."""
        self._since, self._delay = None, _FIRST

    def failed(self, error: AwsLostError) -> float:
        """Note that it did not.

        Returns:
            Seconds after which it may be asked again.

        Raises:
            AwsLostError: it has been away too long.
        """
        now = time.monotonic()
        self._since = now if self._since is None else self._since
        if now - self._since >= self._seconds:
            raise error
        delay, self._delay = self._delay, min(_LONGEST, 2 * self._delay)
        return delay * random.uniform(0.75, 1.25)  # noqa: S311 (so that many do not come at the same moment)


def patiently(ask: Callable[[], Result], go_on: Callable[[], bool] = lambda: True) -> Result:
    """Ask until there is an answer.

    Args:
        ask: what may raise `AwsLostError`.
        go_on: whether it is worth asking again.

    Raises:
        AwsLostError: AWS has been away too long.
    """
    patience = Patience()
    while True:
        try:
            return ask()
        except AwsLostError as error:
            delay = patience.failed(error)
            if not go_on():
                raise
            time.sleep(delay)


TRIES = 8
"""How often a call is made that AWS throttles or fails, with more and more time between."""
CONNECTIONS = 32
_AUDIENCE = "sts.amazonaws.com"
_TOKEN_URL, _TOKEN = "ACTIONS_ID_TOKEN_REQUEST_URL", "ACTIONS_ID_TOKEN_REQUEST_TOKEN"


class Aws:
    """Clients of the services of one region. They may be used from any thread."""

    def __init__(self, region: str) -> None:
        """Nothing is asked of AWS yet."""
        self.region = region
        self.calls: Counter[str] = Counter()
        """How many requests were sent, by ``batch:DescribeJobs``; tries that were repeated count too."""
        self._lock = threading.RLock()
        self._clients: dict[str, Any] = {}

    @property
    def batch(self) -> Any:
        """AWS Batch."""
        return self._client("batch")

    @property
    def submitting(self) -> Any:
        """AWS Batch for what must not be done twice: nothing is tried again."""
        return self._client("batch", tries=1)

    @property
    def s3(self) -> Any:
        """S3, where results are."""
        return self._client("s3")

    @property
    def logs(self) -> Any:
        """CloudWatch Logs."""
        return self._client("logs")

    def ecr(self, region: str) -> Any:
        """The registry of a region."""
        return self._client("ecr", region=region)

    def close(self) -> None:
        """Close the connections."""
        with self._lock:
            clients, self._clients = self._clients, {}
        for client in clients.values():
            client.close()

    def _client(self, service: str, tries: int = TRIES, region: str | None = None) -> Any:
        key = f"{service} {tries} {region}"
        with self._lock:
            if key not in self._clients:
                self._clients[key] = self._new_client(service, tries, region or self.region)
            return self._clients[key]

    def _new_client(self, service: str, tries: int, region: str) -> Any:
        config = Config(
            retries={"mode": "standard", "total_max_attempts": tries},
            connect_timeout=10,
            read_timeout=60,
            max_pool_connections=CONNECTIONS,
            tcp_keepalive=True,
            s3={"addressing_style": "path" if _has_own_endpoint() else "auto"},
        )
        with aws_errors(f"region {region}"):
            client: Any = self._session.client(service, region_name=region, config=config)
        client.meta.events.register("before-send", self._count)
        return client

    @cached_property
    def _session(self) -> Any:
        with aws_errors(f"region {self.region}"):
            session = botocore.session.get_session()
            _take_role_by_tokens_of_github(session, self.region)
            return boto3.session.Session(botocore_session=session, region_name=self.region)

    def _count(self, event_name: str, **_: object) -> None:
        service, operation = event_name.split(".")[1:3]
        with self._lock:
            self.calls[f"{service}:{operation}"] += 1


def _take_role_by_tokens_of_github(session: Any, region: str) -> None:
    """In a GitHub job with a role: take it by a new token whenever its credentials run out."""
    url, secret = os.environ.get(_TOKEN_URL), os.environ.get(_TOKEN)
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
    """Ask GitHub's token service for a token that says which job this is.

    Raises:
        InfrastructureError: it gives none.
    """
    if urlsplit(url).scheme not in ("https", "http"):
        raise InfrastructureError(f"GitHub's token service: {_TOKEN_URL} is no URL")
    http = Http([secret], address=_TOKEN_URL)
    try:
        answer = http.send("GET", f"{url}&audience={_AUDIENCE}", {"Authorization": f"bearer {secret}"})
        token = str(json.loads(answer.body)["value"])
    except (InfrastructureError, ValueError, LookupError, TypeError, RecursionError) as error:
        why = f"answered {answer.status}" if not isinstance(error, InfrastructureError) else error
        raise InfrastructureError(f"GitHub's token service gives no token for a role in AWS ({why})") from None
    finally:
        http.close()
    return token


def _has_own_endpoint() -> bool:
    return bool(os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL"))
