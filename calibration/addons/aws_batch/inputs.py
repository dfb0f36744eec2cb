"""Upload of jobs and the content of their mounts to S3."""

import hashlib
import os
import stat
import tarfile
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePosixPath
from typing import IO, Any

from calibration.addons.aws_batch.following import batches
from calibration.addons.aws_batch.session import with_retries
from calibration.addons.aws_batch.store import CloudRun, Store, in_threads
from calibration.addons.aws_batch.wire import JOBS_PER_FILE, Input, Location, job_entry, jobs_document, mount_targets
from calibration.base.errors import InfrastructureError, InputError
from calibration.ci.execution.job import Job


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
