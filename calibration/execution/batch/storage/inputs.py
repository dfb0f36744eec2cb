"""What jobs read, brought to S3: what their mounts hold, and the jobs themselves."""

import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, Any, Protocol

from calibration.execution.batch.documents.job_document import Input, job_entry, jobs_document, mount_targets
from calibration.execution.batch.service.following import batches
from calibration.execution.batch.service.patience import patiently
from calibration.execution.batch.storage.packing import Packed, pack
from calibration.execution.batch.wire import JOBS_PER_FILE, Location
from calibration.execution.batch.workers import Workers
from calibration.execution.job import Job

_IN_MEMORY = 4 * 1024**2
"""Bytes of a tar; a larger one goes through a file."""


class Objects(Protocol):
    """Takes objects by their keys: `calibration.execution.batch.storage.store.Store`, or what stands for it."""

    def put(self, key: str, data: bytes) -> None:
        """Write an object."""

    def upload(self, key: str, file: IO[bytes], size: int) -> None:
        """Write an object of any size from a file, unless it is there; its key tells its content."""


@dataclass(frozen=True)
class _Done:
    source: Path
    packed: Packed


class Inputs:
    """Knows the tar of each folder that is mounted somewhere; each is made and sent once."""

    def __init__(self, store: Objects, location: Location, memory: int) -> None:
        """Begin.

        Args:
            store: takes them.
            location: of any group; inputs are shared.
            memory: bytes, of a container that says none.
        """
        self._store = store
        self._location = location
        self._memory = memory
        self._packed: dict[Path, Packed] = {}

    def upload(self, jobs: Iterable[Job], workers: int) -> None:
        """Send what the mounts of jobs hold, unless it is there.

        Raises:
            InputError: something cannot be read, or the bucket not be written.
            WorldError: a file changes meanwhile, or the disk is full.
            AwsLostError: AWS does not answer.
        """
        sources = dict.fromkeys(
            mount.source.resolve() for job in jobs for container in job.containers for mount in container.mounts
        )
        crew: Workers[_Done] = Workers(workers)
        try:
            for done in crew.all(partial(self._upload, source) for source in sources):
                self._packed[done.source] = done.packed
        finally:
            crew.stop()

    def entry(self, job: Job) -> dict[str, Any]:
        """The entry of a job whose mounts have been sent."""
        return job_entry(job, self._inputs(job), self._memory)

    def _inputs(self, job: Job) -> Iterator[Input]:
        mounts = {mount.target.rstrip("/"): mount for c in job.containers for mount in c.mounts}
        writable = {m.target.rstrip("/") for c in job.containers for m in c.mounts if m.writable}
        for volume, target in enumerate(mount_targets(job)):
            packed = self._packed[mounts[target].source.resolve()]
            key = self._location.input_key(packed.sha256)
            yield Input(volume, key, packed.sha256, packed.size, target in writable)

    def _upload(self, source: Path) -> _Done:
        with tempfile.SpooledTemporaryFile(max_size=_IN_MEMORY) as file:
            packed = pack(source, file)

            def send() -> None:
                file.seek(0)
                self._store.upload(self._location.input_key(packed.sha256), file, packed.size)

            patiently(send)
        return _Done(source, packed)


def upload_jobs(
    store: Objects, location: Location, jobs: Sequence[Job], entry: Callable[[Job], dict[str, Any]], workers: int
) -> None:
    """Send the entries of the jobs of a group, in files of some each.

    Raises:
        InputError: the bucket cannot be written.
        AwsLostError: AWS does not answer.
    """
    crew: Workers[None] = Workers(workers)

    def pieces() -> Iterator[Callable[[], None]]:
        for number, some in enumerate(batches(jobs, JOBS_PER_FILE)):
            data = jobs_document([entry(job) for job in some])
            key = location.jobs_key(number * JOBS_PER_FILE)
            yield partial(patiently, partial(store.put, key, data))

    try:
        for _ in crew.all(pieces(), ahead=2 * workers):
            pass
    finally:
        crew.stop()
