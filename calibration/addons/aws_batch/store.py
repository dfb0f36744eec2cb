"""Access to AWS of a run: its bucket, and threads for transfers."""

import hashlib
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import IO, Any, Generic, TypeVar

import botocore.exceptions

from calibration.addons.aws_batch.session import Aws, aws_errors, error_code, pages
from calibration.addons.aws_batch.settings import BatchSettings
from calibration.addons.aws_batch.wire import Location
from calibration.base.errors import InfrastructureError, InputError

Result = TypeVar("Result")


class Workers(Generic[Result]):
    """Runs functions in threads; results are returned in the order of completion.

    Safe against signals in the waiting thread: it waits on a queue, without a lock.
    """

    def __init__(self, count: int) -> None:
        self.waiting = 0
        """Number of functions whose result has not been returned."""
        self._work: SimpleQueue[Callable[[], Result] | None] = SimpleQueue()
        self._answers: SimpleQueue[Result | _Failure] = SimpleQueue()
        self._count = count
        self._stopping = False
        self._threads: list[threading.Thread] = []

    def give(self, work: Callable[[], Result]) -> None:
        """Submit a function."""
        self.waiting += 1
        self._work.put(work)
        if len(self._threads) < min(self._count, self.waiting):
            self._threads.append(threading.Thread(target=self._run_until_stopped, daemon=True))
            self._threads[-1].start()

    def take(self, seconds: float | None) -> list[Result]:
        """Wait for a result, at most this long (exactly, if none is due); return all that are available.

        Raises:
            BaseException: exception of a function.
        """
        if not self.waiting:
            time.sleep(seconds or 0.0)
        found: list[Result] = []
        while self.waiting:
            try:
                answer = self._answers.get(timeout=0.0 if found else seconds)
            except Empty:
                break
            self.waiting -= 1
            if isinstance(answer, _Failure):
                raise answer.error
            found.append(answer)
        return found

    def stop(self) -> None:
        """Start no more functions."""
        self._stopping = True
        for _ in self._threads:
            self._work.put(None)

    def join(self, seconds: float) -> None:
        """Wait for running functions, at most this long for each thread."""
        for thread in self._threads:
            thread.join(seconds)

    def _run_until_stopped(self) -> None:
        while not self._stopping and (work := self._work.get()) is not None:
            try:
                self._answers.put(work())
            except BaseException as error:  # any exception is passed to the waiting thread
                self._answers.put(_Failure(error))


def in_threads(count: int, work: Iterable[Callable[[], Result]], ahead: int = 1000) -> Iterator[Result]:
    """Run functions in a number of threads; yield results in the order of completion.

    Raises:
        BaseException: exception of a function; no more functions are started then.
    """
    workers: Workers[Result] = Workers(count)
    try:
        for piece in work:
            workers.give(piece)
            yield from workers.take(None if workers.waiting > ahead else 0.0)
        while workers.waiting:
            yield from workers.take(None)
    finally:
        workers.stop()


class _Failure:
    def __init__(self, error: BaseException) -> None:
        self.error = error


_CHUNK_BYTES = 1024**2


class Store:
    """Objects of a bucket, by key."""

    def __init__(self, aws: Aws, bucket: str) -> None:
        self._aws = aws
        self._bucket = bucket
        self._where = f"bucket '{bucket}'"

    @property
    def _s3(self) -> Any:
        return self._aws.s3

    def check(self) -> None:
        """Check that the bucket exists, is accessible and in the region.

        Raises:
            InputError: it is not.
            AwsLostError: AWS does not answer.
        """
        with aws_errors(self._where):
            answer = self._s3.head_bucket(Bucket=self._bucket)
        region = answer.get("BucketRegion")
        if region and region != self._aws.region:
            raise InputError(f"{self._where}: it is in {region}, the jobs in {self._aws.region}: use one there")

    def put(self, key: str, data: bytes) -> None:
        """Write an object.

        Raises:
            InputError: access is denied.
            AwsLostError: AWS does not answer.
        """
        with aws_errors(self._where):
            self._s3.put_object(Bucket=self._bucket, Key=key, Body=data, ContentType="application/octet-stream")

    def upload(self, key: str, file: IO[bytes], size: int) -> None:
        """Upload a file of any size, unless the object exists; its key is derived from its content.

        Raises:
            InputError: access is denied.
            AwsLostError: AWS does not answer.
        """
        if self._size_of_object(key) != size:
            self.write(key, file)

    def write(self, key: str, file: IO[bytes]) -> None:
        """Upload a file of any size; needs no permission to list the bucket.

        Raises:
            InputError: access is denied.
            AwsLostError: AWS does not answer.
        """
        with aws_errors(self._where):
            self._s3.upload_fileobj(file, self._bucket, key)

    def get(self, key: str, most: int) -> bytes | None:
        """Return the content of an object of at most ``most`` bytes; None if it does not exist.

        Raises:
            InputError: access is denied.
            InfrastructureError: it is larger.
            AwsLostError: AWS does not answer.
        """
        answer = self._open_object(key)
        if answer is None:
            return None
        with closing(answer["Body"]) as body:
            if answer["ContentLength"] > most:
                raise InfrastructureError(
                    f"{self._where}: {key} has {answer['ContentLength']} bytes, at most {most} were expected"
                )
            with aws_errors(self._where):
                data: bytes = body.read(most)
        return data

    def download(self, key: str, path: Path, size: int) -> str:
        """Download an object of a known size to a new file.

        Returns:
            Its SHA-256; empty if the object does not exist, or has another size.

        Raises:
            InputError: access is denied.
            InfrastructureError: the file cannot be written.
            AwsLostError: AWS does not answer.
        """
        answer = self._open_object(key)
        if answer is None:
            return ""
        digest = hashlib.sha256()
        with closing(answer["Body"]) as body:
            if answer["ContentLength"] != size:
                return ""
            try:
                with path.open("xb") as file:
                    while chunk := self._read_chunk(body):
                        digest.update(chunk)
                        file.write(chunk)
            except OSError as error:
                raise InfrastructureError(f"{path}: cannot be written: {error.strerror or error}") from error
        return digest.hexdigest()

    def keys(self, prefix: str) -> Iterator[str]:
        """Yield all keys with a prefix.

        Raises:
            InputError: access is denied.
            AwsLostError: AWS does not answer.
        """
        for page in self._list_pages(Prefix=prefix):
            yield from (str(entry["Key"]) for entry in page.get("Contents", ()))

    def folders(self, prefix: str) -> Iterator[str]:
        """Yield the names of non-empty folders directly below a prefix, which ends with a slash.

        Raises:
            InputError: access is denied.
            AwsLostError: AWS does not answer.
        """
        for page in self._list_pages(Prefix=prefix, Delimiter="/"):
            found = page.get("CommonPrefixes", ())
            yield from (str(entry["Prefix"]).removeprefix(prefix).rstrip("/") for entry in found)

    def _list_pages(self, **settings: str) -> Iterator[dict[str, Any]]:
        return pages(self._s3, "list_objects_v2", self._where, Bucket=self._bucket, **settings)

    def _open_object(self, key: str) -> dict[str, Any] | None:
        with aws_errors(self._where):
            try:
                answer: dict[str, Any] = self._s3.get_object(Bucket=self._bucket, Key=key)
            except botocore.exceptions.ClientError as error:
                if error_code(error) in ("NoSuchKey", "404", "NotFound"):
                    return None
                raise
        return answer

    def _size_of_object(self, key: str) -> int | None:
        """Return the size of an object, from a listing, which needs no permission to read it."""
        with aws_errors(self._where):
            page = self._s3.list_objects_v2(Bucket=self._bucket, Prefix=key, MaxKeys=1)
        return next((int(entry["Size"]) for entry in page.get("Contents", ()) if entry["Key"] == key), None)

    def _read_chunk(self, body: Any) -> bytes:
        with aws_errors(self._where):
            data: bytes = body.read(_CHUNK_BYTES)
        return data


@dataclass(frozen=True)
class CloudRun:
    """A run on AWS Batch: its name, and access to what it uses."""

    name: str
    aws: Aws
    settings: BatchSettings
    store: Store
    folder: Path
    """Folder in which each job has a subfolder with its results."""

    def location(self, group: str = "") -> Location:
        """Return the location of a group of its jobs in S3; without a name, of what all groups share."""
        return Location(self.settings.bucket, self.settings.prefix, self.name, group)
