"""Access to the bucket of a run."""

import hashlib
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import botocore.exceptions

from calibration.addons.aws_batch.aws_errors import aws_errors, error_code
from calibration.addons.aws_batch.session import Aws
from calibration.base.errors import InfrastructureError, InputError

if TYPE_CHECKING:
    from botocore.exceptions import ClientError

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
        pages = iter(self._s3.get_paginator("list_objects_v2").paginate(Bucket=self._bucket, **settings))
        while True:
            with aws_errors(self._where):
                page = next(pages, None)
            if page is None:
                return
            yield page

    def _open_object(self, key: str) -> dict[str, Any] | None:
        with aws_errors(self._where):
            try:
                answer: dict[str, Any] = self._s3.get_object(Bucket=self._bucket, Key=key)
            except botocore.exceptions.ClientError as error:
                if _is_missing(error):
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


def _is_missing(error: "ClientError") -> bool:
    return error_code(error) in ("NoSuchKey", "404", "NotFound")
