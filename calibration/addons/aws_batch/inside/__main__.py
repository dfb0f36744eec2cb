"""``python -m calibration.addons.aws_batch.inside prepare|watch``: entry point of our two containers in a task.

Both return 0 if they have worked, whatever the job's verdict; otherwise they print an error and return the exit code
of `calibration.base.errors`. A stopped task (its job is terminated, its host is lost) leaves no outcome.
"""

import os
import posixpath
import sys
import tarfile
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from calibration.addons.aws_batch import wire
from calibration.addons.aws_batch.inside.script import Signs, script_of
from calibration.addons.aws_batch.inside.watch import Watch, ended_neighbours
from calibration.addons.aws_batch.session import Aws, with_retries
from calibration.addons.aws_batch.store import Store, in_threads
from calibration.base import (
    CalibrationError,
    InfrastructureError,
    InputError,
    one_line,
    shorten,
    write_atomically,
    writing,
)
from calibration.base.process import terminate_cleanly
from calibration.ci.execution.extraction import RefusedError, path_parts
from calibration.ci.execution.job import OUTPUT
from calibration.ci.execution.outcome import ArtifactFile, ContainerOutcome, End


def prepare(task: wire.TaskJob, store: Store, signs: Signs, mounts: Path, output: Path) -> None:
    """Prepare a job.

    Args:
        task: the job.
        store: bucket with the content of its mounts.
        signs: folder that all its containers see.
        mounts: folder with the volumes of its mounts, by number.
        output: the job's own volume.

    Raises:
        InputError: the job cannot run here, or access to the bucket is denied.
        InfrastructureError: an input differs from its digest, or a volume cannot be written.
        AwsLostError: AWS does not answer.
    """
    scripts = {container.name: script_of(container, task.job) for container in task.job.containers}
    for item in task.inputs:
        _fill_volume(item, store, mounts / str(item.volume))
    with writing(output):
        output.chmod(0o1777)  # images may have any user
    signs.make(task.job)
    for name, script in scripts.items():
        path = signs.folder / f"{name}.sh"
        write_atomically(path, script.encode("utf-8", "surrogateescape"))
        path.chmod(0o644)


def _fill_volume(item: wire.Input, store: Store, volume: Path) -> None:
    where = f"volume {item.volume}: s3 object {item.key}"
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "input.tar")
        found = store.download(item.key, file, item.size)
        if found != item.sha256:
            raise InfrastructureError(f"{where}: it is missing or changed: run the job again")
        try:
            with tarfile.open(file, "r:") as archive:
                # Python's own filter differs between versions
                archive.extraction_filter = getattr(tarfile, "fully_trusted_filter", None)
                archive.extractall(volume, members=map(_check_entry, archive))  # noqa: S202 (each is checked)
            if item.writable:
                _open_for_all(volume)
        except (tarfile.TarError, OSError, RefusedError) as error:
            raise InfrastructureError(f"{where}: cannot be unpacked: {shorten(one_line(str(error)), 200)}") from error


def _check_entry(entry: tarfile.TarInfo) -> tarfile.TarInfo:
    """Return a tar entry if it is a file, folder or link within the folder.

    Raises:
        RefusedError: it is something else.
    """
    above = path_parts(entry.name)[:-1]
    if entry.issym():
        to = posixpath.normpath(posixpath.join(*above, entry.linkname))
        if to.startswith("/") or to.split("/")[0] == "..":
            raise RefusedError(f"'{entry.name}' is a link to '{entry.linkname}', which leaves the folder")
    elif not entry.isreg() and not entry.isdir():
        raise RefusedError(f"'{entry.name}' is no file, folder or link")
    return entry


def _open_for_all(folder: Path) -> None:
    """Make everything in a folder writable for all users."""
    folder.chmod(0o777)
    for above, folders, files in os.walk(folder):
        for name in (*folders, *files):
            path = Path(above, name)
            if not path.is_symlink():
                path.chmod(path.stat().st_mode | 0o666 | (0o111 if path.is_dir() else 0))


_UPLOAD_WORKERS = 8
_LONGEST_KEY = 1024
"""S3's limit, in bytes."""


def send_files(store: Store, files: Iterable[ArtifactFile], folder: Path, place: str) -> None:
    """Upload the artifacts of a job.

    Args:
        store: bucket for the files.
        files: files with paths relative to ``folder``.
        folder: folder of the files.
        place: prefix of their keys.

    Raises:
        RefusedError: a name exceeds S3's limit.
        InputError: access is denied.
        AwsLostError: AWS does not answer.
    """

    def send(key: str, path: Path) -> None:
        try:
            with path.open("rb") as file:
                store.write(key, file)
        except OSError as error:
            raise InfrastructureError(f"{path}: cannot be read: {error.strerror}") from error

    keys = {file.path: f"{place}/{file.path}" for file in files}
    for path, key in keys.items():
        if len(key.encode()) > _LONGEST_KEY:
            raise RefusedError(f"artifact '{shorten(path)}' has a longer name than S3 allows")
    for _ in in_threads(
        _UPLOAD_WORKERS, (partial(with_retries, partial(send, key, folder / path)) for path, key in keys.items())
    ):
        pass


@dataclass(frozen=True)
class Places:
    """Mount points of the task's volumes."""

    job: Path = Path(wire.JOB_FOLDER)
    mounts: Path = Path(wire.MOUNTS_FOLDER)
    output: Path = Path(OUTPUT)


class ContainerTask:
    """Identity of the job of this task, and access to its files."""

    def __init__(self, variables: Mapping[str, str]) -> None:
        """Read it from the variables that the client and Batch have set.

        Raises:
            InputError: a variable is missing or wrong.
        """
        try:
            self.location = wire.Location.parse(variables[wire.LOCATION_VARIABLE])
            self.index = int(variables[wire.FIRST_VARIABLE]) + int(variables.get(wire.INDEX_VARIABLE, "0"))
            self.attempt = int(variables.get(wire.ATTEMPT_VARIABLE, "1"))
            region = variables.get(wire.REGION_VARIABLE) or variables["AWS_DEFAULT_REGION"]
        except (KeyError, ValueError) as error:
            raise InputError(f"the variables of the task are not those of a job: {error}") from None
        self.aws = Aws(region)
        self.store = Store(self.aws, self.location.bucket)

    def key(self, name: str) -> str:
        """Return the key of a result of this attempt."""
        return self.location.result_key(self.index, self.attempt, name)

    def send_outcome(self, outcome: wire.TaskOutcome) -> None:
        """Upload the outcome, as the last file.

        Raises:
            InputError: access is denied.
            AwsLostError: AWS does not answer.
        """
        with_retries(partial(self.store.put, self.key(wire.OUTCOME_FILE), wire.outcome_document(outcome)))

    def job(self) -> wire.TaskJob:
        """Download the job.

        Raises:
            InputError: access to the bucket is denied.
            InfrastructureError: the job is missing or invalid.
            AwsLostError: AWS does not answer.
        """
        key = self.location.jobs_key(self.index)
        data = with_retries(lambda: self.store.get(key, wire.MAX_JOBS_BYTES))
        if data is None:
            raise InfrastructureError(f"s3://{self.location.bucket}/{key}: there is no such object")
        return wire.read_job(data, self.index % wire.JOBS_PER_FILE, key)


def main(arguments: Sequence[str], variables: Mapping[str, str], places: Places = Places()) -> int:
    """Run one of our containers; return its exit code."""
    verbs = {"prepare": _prepare_task, "watch": _watch_task}
    try:
        if len(arguments) != 1 or arguments[0] not in verbs:
            raise InputError("expected prepare or watch")
        with terminate_cleanly():
            task = ContainerTask(variables)
            verbs[arguments[0]](task, places, variables)
    except CalibrationError as error:
        print(f"error: {error}", file=sys.stderr, flush=True)
        return int(error.exit_code)
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr, flush=True)
        return 143
    return 0


def _prepare_task(task: ContainerTask, places: Places, _: Mapping[str, str]) -> None:
    described = task.job()
    try:
        prepare(described, task.store, Signs(places.job), places.mounts, places.output)
    except CalibrationError as error:
        containers = tuple(ContainerOutcome(each.name, End.NOT_STARTED) for each in described.job.containers)
        reasons = (str(error),)
        failed = wire.TaskOutcome(described.job.name, task.attempt, error.exit_code, reasons, containers=containers)
        with suppress(CalibrationError):  # the error is in the log anyway
            task.send_outcome(failed)
        raise


def _watch_task(task: ContainerTask, places: Places, variables: Mapping[str, str]) -> None:
    neighbours = partial(ended_neighbours, variables)
    watch = Watch(task.job().job, Signs(places.job), places.output, neighbours=neighbours)
    with tempfile.TemporaryDirectory() as folder:
        files = Path(folder, "artifacts")
        watch.run(files)
        try:
            send_files(task.store, watch.outcome(task.attempt).artifacts, files, task.key(wire.FILES_FOLDER))
        except CalibrationError as error:
            watch.fail(error)
        task.send_outcome(watch.outcome(task.attempt))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:], os.environ))
