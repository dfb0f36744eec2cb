"""Access to objects of a bucket."""

import hashlib
import io
from collections.abc import Iterator
from pathlib import Path

import pytest

from calibration.addons.aws_batch.session import Aws, AwsLostError
from calibration.addons.aws_batch.store import Store
from calibration.base import InfrastructureError, InputError
from tests.addons.aws_batch.fixtures import BUCKET, REGION
from tests.addons.aws_batch.fixtures import Aws as FakeAws

pytestmark = pytest.mark.usefixtures("quick")


@pytest.fixture
def store(batch_emulator: FakeAws) -> Iterator[Store]:
    aws = Aws(REGION)
    yield Store(aws, BUCKET)
    aws.close()


def test_round_trip(store: Store, tmp_path: Path) -> None:
    store.put("a/b", b"content")
    assert store.get("a/b", 7) == b"content"
    assert store.get("a/c", 7) is None
    with pytest.raises(InfrastructureError, match="a/b has 7 bytes, at most 6 were expected"):
        store.get("a/b", 6)
    assert store.download("a/b", tmp_path / "b", 7) == hashlib.sha256(b"content").hexdigest()
    assert (tmp_path / "b").read_bytes() == b"content"
    assert store.download("a/b", tmp_path / "c", 8) == ""
    assert store.download("a/c", tmp_path / "c", 8) == ""
    assert not (tmp_path / "c").exists()
    with pytest.raises(InfrastructureError, match="b: cannot be written: File exists"):
        store.download("a/b", tmp_path / "b", 7)


def test_existing_objects_are_not_uploaded_again(store: Store, batch_emulator: FakeAws) -> None:
    calls = batch_emulator.services.calls
    for _ in range(2):
        store.upload("inputs/x.tar", io.BytesIO(b"tar"), 3)
        assert calls["s3:PUT"] == 1
    store.upload("inputs/x.ta", io.BytesIO(b"tar"), 3)  # prefix of another key
    assert calls["s3:PUT"] == 2


def test_large_objects(store: Store, tmp_path: Path) -> None:
    content = bytes(range(256)) * 40_000  # uploaded in several parts
    store.upload("inputs/large", io.BytesIO(content), len(content))
    assert store.download("inputs/large", tmp_path / "large", len(content)) == hashlib.sha256(content).hexdigest()


def test_folders_and_keys(store: Store) -> None:
    for key in ("r/1/2/x", "r/1/1/y", "r/10/1/z", "r/file"):
        store.put(key, b"")
    assert sorted(store.folders("r/")) == ["1", "10"]
    assert list(store.keys("r/1/")) == ["r/1/1/y", "r/1/2/x"]
    assert list(store.keys("nothing/")) == []


@pytest.mark.parametrize("method", ["GET", "PUT"])
def test_denied_access(store: Store, batch_emulator: FakeAws, method: str) -> None:
    batch_emulator.services.faults.refuse(f"s3:{method}", 403, "AccessDenied", "no", times=99)
    action = "s3:GetObject" if method == "GET" else "s3:PutObject"
    with pytest.raises(InputError, match=f"bucket '{BUCKET}': AWS: {action}: AccessDenied: the role or user needs"):
        store.get("a", 1) if method == "GET" else store.put("a", b"")


def test_an_answer_that_breaks_off(store: Store, batch_emulator: FakeAws, monkeypatch: pytest.MonkeyPatch) -> None:
    store.put("a", b"content")
    store.get("a", 7)
    body = store._s3.get_object(Bucket=BUCKET, Key="a")["Body"]
    monkeypatch.setattr(type(body), "read", lambda self, amount=None: (_ for _ in ()).throw(broken()))
    with pytest.raises(AwsLostError, match="bucket 'robots-results': AWS: "):
        store.get("a", 7)
    body.close()


def broken() -> Exception:
    from botocore.exceptions import ResponseStreamingError

    return ResponseStreamingError(error="Connection reset")
