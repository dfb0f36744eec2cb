"""Access to AWS of a run: its bucket, the upload of jobs and of their mounts, and threads for transfers."""

import hashlib
import os
import stat
import tarfile
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePosixPath
from queue import Empty, SimpleQueue
from typing import IO, Any, Generic, TypeVar

import botocore.exceptions

from calibration.addons.aws_batch.following import batches
from calibration.addons.aws_batch.session import Aws, aws_errors, error_code, pages, with_retries
from calibration.addons.aws_batch.settings import BatchSettings
from calibration.addons.aws_batch.wire import JOBS_PER_FILE, Input, Location, job_entry, jobs_document, mount_targets
from calibration.base import InfrastructureError, InputError, writing
from calibration.ci.execution.job import Job

Result = TypeVar("Result")


class Workers(Generic[Result]):
    """Runs functions in threads; results are returned in the order of completion.

    Safe against signals in the waiting thread: it waits on a queue, without a lock.
    """

    def __init__(self, count: int) -> None:
        self.waiting = 0
        """Number of functions whose result has not been returned."""
        self._work: SimpleQueue[Callable[[], Result] | None] = SimpleQueue()
        self._answers: SimpleQueue[Result | BaseException] = SimpleQueue()
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
            if isinstance(answer, BaseException):
                raise answer
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
                self._answers.put(error)


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
            with writing(path), path.open("xb") as file:
                while chunk := self._read_chunk(body):
                    digest.update(chunk)
                    file.write(chunk)
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


@dataclass(frozen=True)
class Packed:
    """Digest and size of a tar file."""

    sha256: str
    size: int
    """Bytes."""


def pack(folder: Path, file: IO[bytes]) -> Packed:
    """Write the content of a folder to a tar file.

    Files are readable for all users. Links within the folder are kept.

    Raises:
        InputError: something cannot be read, is not a file or folder, or is a link out of the folder.
        InfrastructureError: the tar file cannot be written.
    """
    root = folder.resolve()
    try:
        with tarfile.open(fileobj=file, mode="w", format=tarfile.PAX_FORMAT) as archive:
            for path in _all_in(root):
                _add_to_archive(archive, root, path)
    except OSError as error:
        raise InfrastructureError(f"{folder}: cannot be packed: {error.strerror or error}") from error
    size = file.tell()
    file.seek(0)
    return Packed(hashlib.file_digest(file, "sha256").hexdigest(), size)  # type: ignore[arg-type]


def _all_in(folder: Path) -> Iterator[Path]:
    """Yield all paths below a folder in a reproducible order."""
    try:
        entries = sorted(folder.iterdir())
    except OSError as error:
        raise InputError(f"{folder}: cannot be read: {error.strerror}") from None
    for path in entries:
        yield path
        if path.is_dir() and not path.is_symlink():
            yield from _all_in(path)


def _add_to_archive(archive: tarfile.TarFile, root: Path, path: Path) -> None:
    status = path.lstat()
    entry = tarfile.TarInfo(path.relative_to(root).as_posix())
    executable = status.st_mode & 0o100
    entry.mode = 0o755 if executable or stat.S_ISDIR(status.st_mode) else 0o644
    if stat.S_ISLNK(status.st_mode):
        entry.type, entry.linkname = tarfile.SYMTYPE, _link_inside(root, path)
        archive.addfile(entry)
    elif stat.S_ISDIR(status.st_mode):
        entry.type = tarfile.DIRTYPE
        archive.addfile(entry)
    elif stat.S_ISREG(status.st_mode):
        entry.size = status.st_size
        try:
            content = path.open("rb")
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror}") from None
        with content:
            archive.addfile(entry, content)  # an OSError if the file was truncated meanwhile
    else:
        raise InputError(f"{path}: is no file or folder, but a device, a pipe or a socket: AWS Batch cannot have it")


def _link_inside(root: Path, path: Path) -> str:
    """Return the target of a link within the folder.

    Raises:
        InputError: it is outside of the folder.
    """
    name = os.fspath(path.readlink())
    to = os.path.normpath(path.parent / name)
    if PurePosixPath(name).is_absolute() or not Path(to).is_relative_to(root):
        raise InputError(f"{path}: is a link to '{name}', which points out of the folder: replace it by a copy")
    return name


_IN_MEMORY = 4 * 1024**2
"""Size of a tar in bytes above which a temporary file is used."""


class InputUploader:
    """Uploads each mounted folder once."""

    def __init__(self, run: CloudRun) -> None:
        self._run = run
        self._packed: dict[Path, Packed] = {}

    def upload(self, jobs: Iterable[Job], workers: int) -> None:
        """Upload the mounted folders of jobs, unless the bucket has them.

        Raises:
            InputError: something cannot be read, or access to the bucket is denied.
            InfrastructureError: a file changes meanwhile, or the disk is full.
            AwsLostError: AWS does not answer.
        """
        sources = dict.fromkeys(
            mount.source.resolve() for job in jobs for container in job.containers for mount in container.mounts
        )
        self._packed.update(in_threads(workers, (partial(self._upload_folder, source) for source in sources)))

    def entry(self, job: Job) -> dict[str, Any]:
        """Return the entry of a job whose mounts have been uploaded."""
        return job_entry(job, self._inputs_of_job(job), self._run.settings.memory)

    def _inputs_of_job(self, job: Job) -> Iterator[Input]:
        mounts = {mount.target.rstrip("/"): mount for c in job.containers for mount in c.mounts}
        writable = {m.target.rstrip("/") for c in job.containers for m in c.mounts if m.writable}
        for volume, target in enumerate(mount_targets(job)):
            packed = self._packed[mounts[target].source.resolve()]
            key = self._run.location().input_key(packed.sha256)
            yield Input(volume, key, packed.sha256, packed.size, target in writable)

    def _upload_folder(self, source: Path) -> tuple[Path, Packed]:
        with tempfile.SpooledTemporaryFile(max_size=_IN_MEMORY) as file:
            packed = pack(source, file)

            def send() -> None:
                file.seek(0)
                self._run.store.upload(self._run.location().input_key(packed.sha256), file, packed.size)

            with_retries(send)
        return source, packed


def upload_jobs(
    store: Store, location: Location, jobs: Sequence[Job], entry: Callable[[Job], dict[str, Any]], workers: int
) -> None:
    """Upload the entries of a group's jobs, several per file.

    Raises:
        InputError: access to the bucket is denied.
        AwsLostError: AWS does not answer.
    """

    def pieces() -> Iterator[Callable[[], None]]:
        for number, some in enumerate(batches(jobs, JOBS_PER_FILE)):
            data = jobs_document([entry(job) for job in some])
            key = location.jobs_key(number * JOBS_PER_FILE)
            yield partial(with_retries, partial(store.put, key, data))

    for _ in in_threads(workers, pieces(), ahead=2 * workers):
        pass
