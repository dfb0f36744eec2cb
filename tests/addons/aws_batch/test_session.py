"""Errors of AWS are one line; credentials are found as on GitHub."""

import json
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

from calibration.addons.aws_batch import session
from calibration.addons.aws_batch.session import Aws, AwsLostError, aws_errors
from calibration.addons.aws_batch.store import Store
from calibration.base import CalibrationError, InfrastructureError, InputError
from tests.addons.aws_batch.fixtures import BUCKET, REGION
from tests.addons.aws_batch.fixtures import Aws as FakeAws

pytestmark = pytest.mark.usefixtures("quick")


def describe(aws: Aws) -> None:
    with aws_errors("jobs"):
        aws.batch.describe_jobs(jobs=["x"])


def failure(aws: Aws) -> CalibrationError:
    with pytest.raises(CalibrationError) as caught:
        describe(aws)
    aws.close()
    assert "\n" not in str(caught.value)
    return caught.value


@pytest.fixture
def once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "MAX_TRIES", 1)
    monkeypatch.setattr(Aws._client_of_service, "__defaults__", (1, None))


@pytest.mark.usefixtures("once")
@pytest.mark.parametrize(
    ("status", "code", "kind", "message"),
    [
        (403, "ExpiredTokenException", InputError, "the credentials are expired: get new ones"),
        (403, "UnrecognizedClientException", InputError, "AWS does not know these credentials"),
        (403, "InvalidSignatureException", InputError, "AWS does not know these credentials"),
        (403, "AccessDeniedException", InputError, "batch:DescribeJobs: AccessDeniedException: the role or user needs"),
        (429, "TooManyRequestsException", AwsLostError, "too many requests, also after several tries"),
        (500, "ServerException", AwsLostError, "batch:DescribeJobs: ServerException: said\\x1b[2J"),
        (403, "RequestTimeTooSkewed", InfrastructureError, "the clock of this machine is wrong"),
        (400, "ClientException", InputError, "batch:DescribeJobs: ClientException: said"),
    ],
)
def test_errors_of_aws(
    batch_emulator: FakeAws, status: int, code: str, kind: type[CalibrationError], message: str
) -> None:
    batch_emulator.faults.refuse("DescribeJobs", status, code, "said\x1b[2J\nmore")
    error = failure(Aws(REGION))
    assert type(error) is kind
    assert str(error).startswith("jobs: AWS: batch:DescribeJobs: ")
    assert message in str(error)


@pytest.mark.usefixtures("once")
def test_a_connection_that_breaks(batch_emulator: FakeAws) -> None:
    batch_emulator.faults.drop("DescribeJobs")
    assert type(failure(Aws(REGION))) is AwsLostError


def test_throttled_requests_are_retried_and_counted(batch_emulator: FakeAws) -> None:
    batch_emulator.faults.throttle("DescribeJobs", times=2)
    aws = Aws(REGION)
    describe(aws)
    assert aws.calls == {"batch:DescribeJobs": 3}
    aws.close()


@pytest.mark.usefixtures("once")
def test_unreachable_aws(batch_emulator: FakeAws, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AWS_ENDPOINT_URL_BATCH", "http://127.0.0.1:1")
    error = failure(Aws(REGION))
    assert type(error) is AwsLostError
    assert "check the network, and the region's name" in str(error)


def test_no_credentials(batch_emulator: FakeAws, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.delenv(name)
    assert "there are no credentials: set AWS_ACCESS_KEY_ID" in str(failure(Aws(REGION)))
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "half")
    assert "there are no credentials" in str(failure(Aws(REGION)))


def test_settings_that_make_no_sense(batch_emulator: FakeAws, monkeypatch: pytest.MonkeyPatch) -> None:
    assert isinstance(failure(Aws("no region")), InputError)
    monkeypatch.setenv("AWS_ENDPOINT_URL_BATCH", "not a URL")
    assert "jobs: AWS" in str(failure(Aws(REGION))) or "region" in str(failure(Aws(REGION)))
    monkeypatch.delenv("AWS_ENDPOINT_URL_BATCH")
    monkeypatch.setenv("AWS_PROFILE", "nobody")
    assert "The config profile (nobody) could not be found" in str(failure(Aws(REGION)))


class TokenService(BaseHTTPRequestHandler):
    """Stand-in of GitHub's service for OIDC tokens."""

    asked = 0
    answer = b'{"value": "eyJ.planted.jwt"}'

    def do_GET(self) -> None:
        type(self).asked += 1
        right = self.headers["Authorization"] == "bearer planted" and self.path == "/t?v=1&audience=sts.amazonaws.com"
        self.send_response(200 if right else 403)
        self.end_headers()
        self.wfile.write(self.answer)

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def tokens(monkeypatch: pytest.MonkeyPatch) -> Iterator[type[TokenService]]:
    class Fresh(TokenService):
        pass

    with HTTPServer(("127.0.0.1", 0), Fresh) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.05,))
        thread.start()
        monkeypatch.setenv("ACTIONS_ID_TOKEN_REQUEST_URL", f"http://127.0.0.1:{server.server_port}/t?v=1")
        monkeypatch.setenv("ACTIONS_ID_TOKEN_REQUEST_TOKEN", "planted")
        yield Fresh
        server.shutdown()
        thread.join()


def caller(aws: Aws) -> str:
    client = aws._client_of_service("sts")
    arn: str = client.get_caller_identity()["Arn"]
    aws.close()
    return arn


ROLE = "arn:aws:iam::123456789012:role/robots/ci"


def test_on_github_the_role_comes_first(
    batch_emulator: FakeAws, tokens: type[TokenService], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "assumed-role" not in caller(Aws(REGION))  # without a role
    assert tokens.asked == 0
    monkeypatch.setenv("AWS_ROLE_ARN", ROLE)
    assert ":assumed-role/ci/calibration-ci" in caller(Aws(REGION))
    assert tokens.asked == 1


def test_a_profile_with_a_token_of_the_workflow_gets_fresh_ones(
    batch_emulator: FakeAws,
    tokens: type[TokenService],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    config = tmp_path_factory.mktemp("aws") / "config"
    config.write_text(f"[default]\nrole_arn = {ROLE}\nweb_identity_token_file = /nonexistent\n")
    monkeypatch.setenv("AWS_CONFIG_FILE", str(config))
    assert ":assumed-role/ci/" in caller(Aws(REGION))
    assert tokens.asked == 1


@pytest.mark.parametrize("answer", [b"{}", b"no JSON", b"[]"])
def test_no_token(
    batch_emulator: FakeAws, tokens: type[TokenService], monkeypatch: pytest.MonkeyPatch, answer: bytes
) -> None:
    monkeypatch.setenv("AWS_ROLE_ARN", ROLE)
    tokens.answer = answer
    error = failure(Aws(REGION))
    assert isinstance(error, InfrastructureError)
    assert "GitHub's token service gives no token for a role in AWS" in str(error)
    assert "planted" not in str(error)
    monkeypatch.setenv("ACTIONS_ID_TOKEN_REQUEST_TOKEN", "wrong")
    assert "(answered 403)" in str(failure(Aws(REGION)))
    monkeypatch.setenv("ACTIONS_ID_TOKEN_REQUEST_URL", "file:///etc/passwd")
    assert "is no URL" in str(failure(Aws(REGION)))


@pytest.mark.parametrize(
    ("bucket", "fault", "message"),
    [
        ("nothere", None, "bucket 'nothere': AWS: s3:ListBucket: 404: there is no such bucket"),
        (BUCKET, (403, "AccessDenied"), "s3:ListBucket: 403: the role or user needs this permission"),
    ],
)
@pytest.mark.usefixtures("once")
def test_buckets(batch_emulator: FakeAws, bucket: str, fault: tuple[int, str] | None, message: str) -> None:
    if fault is not None:
        batch_emulator.services.faults.refuse("s3:HEAD", *fault, "", times=3)
    aws = Aws(REGION)
    with pytest.raises(InputError) as caught:
        Store(aws, bucket).check()
    assert message in str(caught.value)
    aws.close()


@pytest.mark.parametrize(("region", "there"), [("eu-north-1", ": it is in eu-north-1"), ("", "")])
def test_a_bucket_that_redirects(region: str, there: str) -> None:
    from botocore.exceptions import ClientError

    headers = {"x-amz-bucket-region": region} if region else {}
    answer = {"Error": {"Code": "301"}, "ResponseMetadata": {"HTTPStatusCode": 301, "HTTPHeaders": headers}}
    with pytest.raises(InputError) as caught, aws_errors("bucket 'b'"):
        raise ClientError(answer, "HeadBucket")
    assert str(caught.value) == f"bucket 'b': AWS: s3:ListBucket: 301: the bucket is in another region{there}"


def test_a_bucket_elsewhere(batch_emulator: FakeAws) -> None:
    aws = Aws("eu-central-1")
    with pytest.raises(InputError, match=r"it is in eu-west-1, the jobs in eu-central-1: use one there"):
        Store(aws, BUCKET).check()
    aws.close()


def test_secrets_are_in_no_repr(batch_emulator: FakeAws) -> None:
    aws = Aws(REGION)
    describe(aws)
    assert "pl4nted" not in repr(vars(aws))
    aws.close()


def test_modules_before_the_backend_need_no_aws_packages() -> None:
    import subprocess
    import sys

    heavy = "{'boto3', 'botocore', 'docker', 'requests'}"
    modules = (
        "calibration.addons.aws_batch.settings, calibration.addons.aws_batch.aws_policy, calibration.commands.cleanup"
    )
    code = f"import {modules}, sys; print(sorted({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout.replace("'", '"')) == []
