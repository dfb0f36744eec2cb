"""What a job left, sent to the bucket; and, when all of it is there, the outcome, which names it."""

from collections.abc import Iterable
from functools import partial
from pathlib import Path

from calibration.aws_errors import aws_errors
from calibration.errors import WorldError
from calibration.execution.batch.documents.outcome_document import TaskOutcome, outcome_document
from calibration.execution.batch.service.patience import patiently
from calibration.execution.batch.service.session import Aws
from calibration.execution.batch.workers import Workers
from calibration.execution.extraction import RefusedError
from calibration.execution.outcome import BroughtOut
from calibration.workflow.text import shorten

_WORKERS = 8
_LARGE = 8 * 1024**2
"""Bytes; a larger file is sent in parts."""
_LONGEST_KEY = 1024
"""Bytes that S3 takes."""


class Results:
    """The place in the bucket for what one attempt leaves."""

    def __init__(self, aws: Aws, bucket: str, prefix: str) -> None:
        """Nothing is sent yet; ``prefix`` ends with a slash."""
        self._aws = aws
        self._bucket = bucket
        self._prefix = prefix

    def send_files(self, files: Iterable[BroughtOut], folder: Path, below: str) -> None:
        """Send files.

        Args:
            files: by their paths relative to ``folder``.
            folder: has them.
            below: where they go, relative to the place of the attempt.

        Raises:
            RefusedError: a name is longer than S3 takes.
            InputError: it is not allowed.
            AwsLostError: AWS does not answer.
        """
        keys = {file.path: f"{self._prefix}{below}/{file.path}" for file in files}
        for path, key in keys.items():
            if len(key.encode()) > _LONGEST_KEY:
                raise RefusedError(f"artifact '{shorten(path)}' has a longer name than S3 takes")
        crew: Workers[None] = Workers(_WORKERS)
        try:
            work = (partial(patiently, partial(self._send, key, folder / path)) for path, key in keys.items())
            for _ in crew.all(work):
                pass
        finally:
            crew.stop()

    def send_outcome(self, outcome: TaskOutcome, name: str) -> None:
        """Send the outcome; nothing comes after it.

        Raises:
            InputError: it is not allowed.
            AwsLostError: AWS does not answer.
        """
        data = outcome_document(outcome)

        def put() -> None:
            with aws_errors(f"bucket '{self._bucket}'"):
                self._aws.s3.put_object(
                    Bucket=self._bucket, Key=f"{self._prefix}{name}", Body=data, ContentType="application/json"
                )

        patiently(put)

    def _send(self, key: str, path: Path) -> None:
        try:
            with path.open("rb") as file, aws_errors(f"bucket '{self._bucket}'"):
                if path.stat().st_size > _LARGE:
                    self._aws.s3.upload_fileobj(file, self._bucket, key)
                else:
                    self._aws.s3.put_object(
                        Bucket=self._bucket, Key=key, Body=file, ContentType="application/octet-stream"
                    )
        except OSError as error:
            raise WorldError(f"{path}: cannot be read: {error.strerror}") from error
