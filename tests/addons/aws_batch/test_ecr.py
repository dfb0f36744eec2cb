import base64
import io
import json
from collections.abc import Iterator

import pytest

from calibration.addons.aws_batch.ecr import ecr_credentials
from calibration.base import CalibrationError, InfrastructureError, InputError
from calibration.ci.github.service import GITHUB
from calibration.ci.registries.reference import RegistrySettings, ecr_host, is_ecr
from calibration.ci.registries.registry import registry_login
from calibration.ci.workflow import Runner
from tests.ci.registries.server import Reply, serve

ACCOUNT = "123456789012"
HOST = f"{ACCOUNT}.dkr.ecr.eu-west-1.amazonaws.com"
NAME = f"{HOST}/team/robot"
SECRET = "pl4nted-secret-key"  # noqa: S105


@pytest.fixture(autouse=True)
def aws(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Set access keys, and ignore the user's files."""
    folder = tmp_path_factory.mktemp("aws")
    monkeypatch.setenv("HOME", str(folder))
    monkeypatch.setenv("DOCKER_CONFIG", str(folder))
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "AKIAEXAMPLE")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", SECRET)
    for name in ("AWS_PROFILE", "AWS_REGION", "AWS_DEFAULT_REGION", "AWS_SESSION_TOKEN"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture(scope="module")
def moto() -> Iterator[str]:
    """Return the address of an emulator of AWS's API."""
    server = pytest.importorskip("moto.server", reason="needs moto[ecr,server]").ThreadedMotoServer(
        ip_address="127.0.0.1", port=0, verbose=False
    )
    server.start()
    host, port = server.get_host_and_port()
    yield f"http://{host}:{port}"
    server.stop()


@pytest.fixture
def emulator(moto: str, monkeypatch: pytest.MonkeyPatch) -> str:
    import requests

    requests.post(f"{moto}/moto-api/reset", timeout=10)
    monkeypatch.setenv("AWS_ENDPOINT_URL", moto)
    return moto


@pytest.fixture
def log() -> io.StringIO:
    return io.StringIO()


@pytest.fixture
def runner(log: io.StringIO) -> Runner:
    return Runner(GITHUB, stdout=log)


@pytest.mark.parametrize(
    ("registry", "region"),
    [
        (HOST, "eu-west-1"),
        (f"{ACCOUNT}.dkr.ecr.us-gov-west-1.amazonaws.com", "us-gov-west-1"),
        (f"{ACCOUNT}.dkr.ecr-fips.us-gov-east-1.amazonaws.com", "us-gov-east-1"),
        (f"{ACCOUNT}.dkr.ecr.cn-northwest-1.amazonaws.com.cn", "cn-northwest-1"),
        (f"{ACCOUNT}.dkr-ecr.ap-southeast-2.on.aws", "ap-southeast-2"),
    ],
)
def test_hosts_of_aws(registry: str, region: str) -> None:
    host = ecr_host(registry)
    assert host is not None
    assert (host.account, host.region) == (ACCOUNT, region)
    assert is_ecr(registry)


@pytest.mark.parametrize(
    "registry",
    [
        "ghcr.io",
        f"{HOST}.evil.org",
        f"evil.{HOST}",
        "12345.dkr.ecr.eu-west-1.amazonaws.com",
        "127.0.0.1:5000",
        f"{HOST}:443",
    ],
)
def test_other_hosts(registry: str) -> None:
    assert not is_ecr(registry)


def test_the_public_registry_is_one() -> None:
    assert is_ecr("public.ecr.aws")


def repositories(url: str) -> list[str]:
    import boto3

    client = boto3.client("ecr", endpoint_url=url, region_name="eu-west-1")
    try:
        return [entry["repositoryUri"] for entry in client.describe_repositories()["repositories"]]
    finally:
        client.close()


def test_a_password_from_the_emulator(emulator: str, runner: Runner, log: io.StringIO) -> None:
    found = registry_login(None, f"{NAME}:v1", runner)
    assert (found.registry, found.username) == (HOST, "AWS")
    assert found.password == f"{ACCOUNT}-auth-token"  # as moto defines it
    assert found.password not in repr(found)
    masked = [line.removeprefix("::add-mask::") for line in log.getvalue().splitlines()]
    assert found.password in masked
    assert base64.b64encode(f"AWS:{found.password}".encode()).decode() in masked
    assert repositories(emulator) == []


def test_a_repository_is_made_where_that_is_asked_for(emulator: str, runner: Runner, log: io.StringIO) -> None:
    settings = RegistrySettings(kind="ecr", create_repository=True)
    for _ in range(2):
        registry_login(settings, NAME, runner)
        assert repositories(emulator) == [NAME]
    assert log.getvalue().count(f"created the repository {NAME}\n") == 1


def test_a_stand_in_of_a_registry_of_aws(emulator: str, runner: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = RegistrySettings(kind="ecr")
    with pytest.raises(InputError, match=r"127\.0\.0\.1:5000/robot: AWS's region is not known: set AWS_REGION"):
        registry_login(settings, "127.0.0.1:5000/robot", runner)
    monkeypatch.setenv("AWS_REGION", "eu-west-1")
    monkeypatch.setenv("AWS_DEFAULT_REGION", "eu-west-1")
    found = registry_login(settings, "127.0.0.1:5000/robot", runner)
    assert (found.registry, found.username) == ("127.0.0.1:5000", "AWS")


def reply(status: int, code: str, message: str = "said") -> Reply:
    headers = {"Content-Type": "application/x-amz-json-1.1", "x-amzn-ErrorType": code}
    return Reply(status, json.dumps({"__type": code, "message": message}).encode(), headers)


@pytest.mark.thorough(but_first=4)
@pytest.mark.parametrize(
    ("answer", "error", "message"),
    [
        (reply(400, "ExpiredTokenException"), InputError, "ExpiredTokenException: the credentials are expired"),
        (reply(400, "UnrecognizedClientException"), InputError, "AWS does not know these credentials"),
        (reply(400, "InvalidSignatureException"), InputError, "AWS does not know these credentials"),
        (reply(400, "AccessDeniedException"), InputError, "GetAuthorizationToken: AccessDeniedException: the role or"),
        (reply(400, "InvalidParameterException", "a\nb"), InputError, "InvalidParameterException: a b"),
        (reply(500, "ServerException", "oops"), InfrastructureError, "ServerException: oops"),
        (
            reply(400, "ThrottlingException"),
            InfrastructureError,
            "ThrottlingException: too many requests, also after several tries",
        ),
        (Reply(502, b"<html>"), InfrastructureError, "GetAuthorizationToken"),
        (Reply(200, b"<html>"), InfrastructureError, "AWS answers without a token"),
        (Reply(200, b"{}"), InfrastructureError, "AWS answers without a token"),
        (Reply(200, b'{"authorizationData": []}'), InfrastructureError, "AWS answers without a token"),
        (
            Reply(200, b'{"authorizationData": [{"authorizationToken": "%"}]}'),
            InfrastructureError,
            "AWS answers without a token",
        ),
        (
            Reply(200, b'{"authorizationData": [{"authorizationToken": "QVdT"}]}'),
            InfrastructureError,
            "without a token",
        ),
    ],
)
def test_errors_of_aws(
    runner: Runner,
    monkeypatch: pytest.MonkeyPatch,
    answer: Reply,
    error: type[CalibrationError],
    message: str,
) -> None:
    monkeypatch.setattr("botocore.retries.standard.ExponentialBackoff.delay_amount", lambda *_: 0.0)
    with serve(lambda _: answer) as server:
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{server.address}")
        with pytest.raises(error) as caught:
            ecr_credentials(NAME, runner)
    assert str(caught.value).startswith(f"{NAME}: AWS")
    assert message in str(caught.value)
    assert SECRET not in str(caught.value)
    transient = answer.status >= 500 or b"Throttling" in answer.body
    assert len(server.requests) == (4 if transient else 1)


def test_no_credentials(runner: Runner, monkeypatch: pytest.MonkeyPatch, emulator: str) -> None:
    monkeypatch.delenv("AWS_ACCESS_KEY_ID")
    monkeypatch.delenv("AWS_SECRET_ACCESS_KEY")
    with pytest.raises(InputError, match="AWS: there are no credentials: set AWS_ACCESS_KEY_ID"):
        ecr_credentials(NAME, runner)
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "AKIAEXAMPLE")
    with pytest.raises(InputError, match="AWS: there are no credentials"):
        ecr_credentials(NAME, runner)


def test_no_such_profile(runner: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AWS_PROFILE", "nobody")
    with pytest.raises(InputError, match=r"AWS: The config profile \(nobody\) could not be found"):
        ecr_credentials(NAME, runner)


def test_no_aws_at_all(runner: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("botocore.retries.standard.ExponentialBackoff.delay_amount", lambda *_: 0.0)
    with serve(lambda _: Reply()) as server:
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{server.address}")
    with pytest.raises(InfrastructureError, match="AWS: Could not connect to the endpoint URL"):
        ecr_credentials(NAME, runner)


def test_the_public_registry(runner: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    """moto has no public ECR: this tests the form of the requests, not AWS's behaviour."""
    token = base64.b64encode(b"AWS:pu8lic").decode()
    missing = reply(400, "RepositoryNotFoundException")
    answers = [
        Reply(200, json.dumps({"authorizationData": {"authorizationToken": token}}).encode()),
        missing,
        Reply(200, b"{}"),
    ]
    asked: list[tuple[str, object]] = []

    def answer(request: object) -> Reply:
        target = request.headers["x-amz-target"].rpartition(".")[2]  # type: ignore[attr-defined]
        asked.append((target, json.loads(request.body)))  # type: ignore[attr-defined]
        return answers.pop(0)

    with serve(answer) as server:
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{server.address}")
        found = ecr_credentials("public.ecr.aws/alias/team/robot", runner, create_repository=True)
    assert (found.registry, found.username, found.password) == ("public.ecr.aws", "AWS", "pu8lic")
    assert asked == [
        ("GetAuthorizationToken", {}),
        ("DescribeRepositories", {"repositoryNames": ["team/robot"]}),
        ("CreateRepository", {"repositoryName": "team/robot"}),
    ]


def test_concurrent_creation_of_the_repository(runner: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    token = base64.b64encode(b"AWS:p").decode()
    answers = [
        Reply(200, json.dumps({"authorizationData": [{"authorizationToken": token}]}).encode()),
        reply(400, "RepositoryNotFoundException"),
        reply(400, "RepositoryAlreadyExistsException"),
    ]
    with serve(lambda _: answers.pop(0)) as server:
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{server.address}")
        assert ecr_credentials(NAME, runner, create_repository=True).username == "AWS"
