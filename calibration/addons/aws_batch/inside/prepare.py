"""Preparation of a job before its containers start: content of volumes, and scripts."""

import os
import posixpath
import tarfile
import tempfile
from pathlib import Path

from calibration.addons.aws_batch.documents import Input, TaskJob
from calibration.addons.aws_batch.inside.script import Signs, script_of
from calibration.addons.aws_batch.store import Store
from calibration.base.errors import InfrastructureError
from calibration.base.files import write_atomically
from calibration.base.text import one_line, shorten
from calibration.ci.execution.extraction import RefusedError, path_parts


def prepare(task: TaskJob, store: Store, signs: Signs, mounts: Path, output: Path) -> None:
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
    try:
        output.chmod(0o1777)  # images may have any user
    except OSError as error:
        raise InfrastructureError(f"{output}: cannot be written: {error.strerror}") from error
    signs.make(task.job)
    for name, script in scripts.items():
        path = signs.folder / f"{name}.sh"
        write_atomically(path, script.encode("utf-8", "surrogateescape"))
        path.chmod(0o644)


def _fill_volume(item: Input, store: Store, volume: Path) -> None:
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
