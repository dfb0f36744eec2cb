"""Fixtures of an AWS on this machine: no test reaches the real one."""

from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from ipaddress import ip_network
from typing import TYPE_CHECKING, Any

import pytest

from tests.docker_engine import _one_at_a_time

if TYPE_CHECKING:
    from docker import DockerClient

    from .emulator.attempt import Runner
    from .emulator.faults import Faults
    from .emulator.instant import Function
    from .emulator.server import Emulator
    from .services import Services

BUCKET, QUEUE, REGION = "robots-results", "robots", "eu-west-1"
KEY, SECRET = "AKIAEXAMPLE", "pl4nted-secret-key"


@dataclass(frozen=True)
class Aws:
    """An AWS with a bucket, and a Batch with a queue."""

    batch: "Emulator"
    services: "Services"

    @property
    def faults(self) -> "Faults":
        """Of Batch; those of the other services are in ``services.faults``."""
        return self.batch.faults

    @property
    def variables(self) -> dict[str, str]:
        """What a client needs in its environment."""
        return credentials() | {
            "AWS_ENDPOINT_URL": self.services.endpoint,
            "AWS_ENDPOINT_URL_S3": self.services.endpoint,
            "AWS_ENDPOINT_URL_BATCH": self.batch.endpoint,
        }

    def client(self, service: str, region: str = REGION) -> Any:
        """Return a client of a service that asks once only."""
        from botocore.config import Config

        endpoint = self.batch.endpoint if service == "batch" else self.services.endpoint
        config = Config(retries={"total_max_attempts": 1})
        return _session().client(service, region_name=region, endpoint_url=endpoint, config=config)


@cache
def _session() -> Any:
    """One for all clients: it takes long to read the descriptions of services."""
    import boto3

    return boto3.Session(KEY, SECRET)


def credentials() -> dict[str, str]:
    """Return keys that are nobody's, and nothing of the user's."""
    nowhere = "/nonexistent"
    return {
        "AWS_ACCESS_KEY_ID": KEY,
        "AWS_SECRET_ACCESS_KEY": SECRET,
        "AWS_DEFAULT_REGION": REGION,
        "AWS_EC2_METADATA_DISABLED": "true",
        "AWS_CONFIG_FILE": nowhere,
        "AWS_SHARED_CREDENTIALS_FILE": nowhere,
    }


@contextmanager
def started_aws(
    services: "Services", runner: "Runner | Function | None" = None, hosts: int = 4, time_scale: float = 1.0
) -> Generator[Aws]:
    """Start a Batch beside services that run, with a queue of Fargate's hosts and an empty bucket.

    Raises:
        AssertionError: the emulator made a mistake, or the test's function did.
    """
    from .emulator.server import Emulator

    services.reset()
    emulator = Emulator(runner, hosts, REGION, time_scale)
    try:
        emulator.add_queue(QUEUE)
        aws = Aws(emulator, services)
        services.make_bucket(BUCKET, REGION)
        yield aws
    finally:
        emulator.close()
        services.reset()
    assert not emulator.problems


@pytest.fixture(scope="session")
def aws_services() -> "Iterator[Services]":
    """S3, Logs, STS, ECR, IAM, on an address of this machine."""
    pytest.importorskip("moto.server", reason="needs moto[ecr,server]")
    pytest.importorskip("boto3", reason="needs the package boto3")
    from .services import Services

    services = Services()
    yield services
    services.close()


@pytest.fixture
def aws_variables(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> Callable[[Aws], None]:
    """Let this process, and those that it starts, be clients of an AWS."""

    def use(aws: Aws) -> None:
        import os

        for name in [name for name in os.environ if name.startswith("AWS_")]:
            monkeypatch.delenv(name)
        monkeypatch.setenv("HOME", str(tmp_path_factory.mktemp("home")))
        for name, value in aws.variables.items():
            monkeypatch.setenv(name, value)

    return use


@pytest.fixture
def batch_emulator(aws_services: "Services", aws_variables: Callable[[Aws], None]) -> Iterator[Aws]:
    """An AWS whose jobs are the function ``aws.batch.runner.function``; all end with 0 at once where none is given.

    This process is a client of it by its environment.
    """
    with started_aws(aws_services) as aws:
        aws_variables(aws)
        yield aws


def bridge_address(engine: "DockerClient") -> str:
    """Return the address of this machine on the engine's bridge, which containers reach."""
    bridge = engine.networks.get("bridge").attrs["IPAM"]["Config"][0]
    # The first start of an engine does not tell the gateway: there it is the first address.
    return str(bridge.get("Gateway") or next(ip_network(bridge["Subnet"]).hosts()))


@pytest.fixture(scope="session")
def reachable_services(engine: "DockerClient") -> "Iterator[Services]":
    """The same on an address that containers reach too: that of the engine's bridge."""
    pytest.importorskip("moto.server", reason="needs moto[ecr,server]")
    from .services import Services

    try:
        services = Services(bridge_address(engine))
    except OSError as error:
        pytest.skip(f"needs an engine whose bridge is this machine's: {error}")
    yield services
    services.close()


@contextmanager
def aws_in_containers(
    engine: "DockerClient", services: "Services", pause_image: str, hosts: int = 2, time_scale: float = 1.0
) -> Generator[Aws]:
    """Start a Batch whose tasks are containers of the engine, which reach the services as the job's role would.

    ``aws.batch.runner.secrets`` has the values of secrets, by their ARNs.
    """
    from .emulator.containers import Containers

    given = {
        "AWS_ACCESS_KEY_ID": KEY,
        "AWS_SECRET_ACCESS_KEY": SECRET,
        "AWS_REGION": REGION,
        "AWS_DEFAULT_REGION": REGION,
        "AWS_ENDPOINT_URL": services.endpoint,
    }

    def log(group: str, stream: str, lines: list[tuple[int, str]]) -> None:
        services.log(REGION, group, stream, lines)

    with started_aws(services, Containers(engine, pause_image, log, given), hosts, time_scale) as aws:
        yield aws


@pytest.fixture
def batch_in_containers(
    engine: "DockerClient",
    base_image: str,
    reachable_services: "Services",
    aws_variables: Callable[[Aws], None],
) -> Iterator[Aws]:
    """As `batch_emulator`, with tasks in real containers, two at once."""
    with aws_in_containers(engine, reachable_services, base_image) as aws:
        aws_variables(aws)
        yield aws


@pytest.fixture(scope="session")
def tools_image(engine: "DockerClient", python_image: str) -> str:
    """The name of an image with this package, as the tools of a task need it."""
    from .tools_image import build_tools_image

    with _one_at_a_time("tools"):
        return build_tools_image(engine, python_image)
