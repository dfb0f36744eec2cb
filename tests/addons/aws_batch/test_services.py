"""S3, Logs and STS of moto's, with the faults that tests ask for."""

from collections.abc import Callable
from typing import Any

import pytest

from .fixtures import BUCKET, REGION, SECRET, Aws


def code_of(call: Callable[..., Any], **request: Any) -> tuple[str, int]:
    from botocore.exceptions import ClientError

    with pytest.raises(ClientError) as caught:
        call(**request)
    return caught.value.response["Error"]["Code"], caught.value.response["ResponseMetadata"]["HTTPStatusCode"]


def test_the_bucket_is_that_of_the_clients(batch_emulator: Aws) -> None:
    s3 = batch_emulator.client("s3")
    s3.put_object(Bucket=BUCKET, Key="a/b", Body=b"first")
    batch_emulator.services.put(BUCKET, "a/c", b"second")
    assert batch_emulator.services.get(BUCKET, "a/b") == b"first"
    assert s3.get_object(Bucket=BUCKET, Key="a/c")["Body"].read() == b"second"
    assert batch_emulator.services.keys(BUCKET, "a/c") == ["a/c"]
    with pytest.raises(KeyError, match="a/d"):
        batch_emulator.services.get(BUCKET, "a/d")
    assert batch_emulator.services.calls == {"s3:PUT": 1, "s3:GET": 1}
    assert code_of(s3.get_object, Bucket=BUCKET, Key="a/d") == ("NoSuchKey", 404)
    assert code_of(s3.list_objects_v2, Bucket="nobodys") == ("NoSuchBucket", 404)


def test_logs_grow(batch_emulator: Aws) -> None:
    batch_emulator.services.log(REGION, "/robots", "a/b/c", [(1_900_000_000_000, "too far ahead")])
    batch_emulator.services.log(REGION, "/robots", "a/b/c", [])
    logs = batch_emulator.client("logs")
    asked = {"logGroupName": "/robots", "logStreamName": "a/b/c", "startFromHead": True}
    assert logs.get_log_events(**asked)["events"] == []
    from .emulator.jobs import now

    batch_emulator.services.log(REGION, "/robots", "a/b/c", [(now(), "second"), (now() - 1, "first")])
    answer = logs.get_log_events(**asked)
    assert [event["message"] for event in answer["events"]] == ["first", "second"]
    batch_emulator.services.log(REGION, "/robots", "a/b/c", [(now(), "third")])
    more = logs.get_log_events(**asked, nextToken=answer["nextForwardToken"])
    assert [event["message"] for event in more["events"]] == ["third"]
    assert code_of(logs.get_log_events, logGroupName="/none", logStreamName="a")[0] == "ResourceNotFoundException"


@pytest.mark.parametrize(
    ("service", "operation", "call", "request_"),
    [
        ("s3", "s3:GET", "get_object", {"Bucket": BUCKET, "Key": "a"}),
        ("s3", "s3:PUT", "put_object", {"Bucket": BUCKET, "Key": "a", "Body": b"x" * 100_000}),
        ("logs", "DescribeLogGroups", "describe_log_groups", {}),
        ("sts", "GetCallerIdentity", "get_caller_identity", {}),
    ],
)
def test_faults_of_the_other_services(
    batch_emulator: Aws, service: str, operation: str, call: str, request_: dict[str, Any]
) -> None:
    client = batch_emulator.client(service)
    batch_emulator.services.put(BUCKET, "a", b"x")
    faults = batch_emulator.services.faults
    faults.refuse(operation, 503, "SlowDown", "Please reduce your request rate.", times=2, after=1)
    getattr(client, call)(**request_)
    assert code_of(getattr(client, call), **request_) == ("SlowDown", 503)
    assert code_of(getattr(client, call), **request_) == ("SlowDown", 503)
    getattr(client, call)(**request_)
    faults.expire(operation, times=1)
    assert code_of(getattr(client, call), **request_) == ("ExpiredTokenException", 403)
    assert batch_emulator.services.calls[operation] == 5


def test_a_fault_for_some_keys_only(batch_emulator: Aws) -> None:
    s3 = batch_emulator.client("s3")
    batch_emulator.services.put(BUCKET, "results/7/outcome.json", b"{}")
    batch_emulator.services.put(BUCKET, "results/8/outcome.json", b"{}")
    batch_emulator.services.faults.refuse("s3:GET", 500, "InternalError", "We encountered an error", match="/7/")
    assert s3.get_object(Bucket=BUCKET, Key="results/8/outcome.json")["Body"].read() == b"{}"
    assert code_of(s3.get_object, Bucket=BUCKET, Key="results/7/outcome.json") == ("InternalError", 500)
    assert s3.get_object(Bucket=BUCKET, Key="results/7/outcome.json")["Body"].read() == b"{}"


@pytest.mark.parametrize(("answered", "there"), [(False, []), (True, ["a"])])
def test_the_connection_breaks(batch_emulator: Aws, answered: bool, there: list[str]) -> None:
    from botocore.exceptions import HTTPClientError

    batch_emulator.services.faults.drop("s3:PUT", answered=answered)
    with pytest.raises(HTTPClientError):
        batch_emulator.client("s3").put_object(Bucket=BUCKET, Key="a", Body=b"x")
    assert batch_emulator.services.keys(BUCKET) == there


def test_one_is_nobody_of_aws(batch_emulator: Aws) -> None:
    identity = batch_emulator.client("sts").get_caller_identity()
    assert identity["Account"] == "123456789012"
    assert set(batch_emulator.services.calls) == {"GetCallerIdentity"}
    assert SECRET not in repr(batch_emulator)
