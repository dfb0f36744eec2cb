"""A run as a folder: what goes to S3, what goes to Kubernetes, and how.

::

    jobs.yaml    for kubectl apply
    objects/     for aws s3 sync: what the mounts hold, and the jobs, by their keys in the bucket
    jobs.csv     where the result of each job will be
    README.md    the commands
"""

import csv
import io
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from calibration.errors import InputError, WorldError
from calibration.execution.batch.requests.shape import Group
from calibration.execution.batch.settings import BatchSettings
from calibration.execution.batch.storage.inputs import Inputs, upload_jobs
from calibration.execution.batch.wire import FILES_FOLDER, OUTCOME_FILE, Location
from calibration.execution.job import Job
from calibration.execution.job_check import check_jobs
from calibration.execution.kubernetes.rendering import (
    RUN_LABEL,
    SECRET,
    SERVICE_ACCOUNT,
    check_and_group,
    name_of,
    rendered,
)
from calibration.execution.ros import on_one_address
from calibration.files import write_atomically

MANIFESTS, OBJECTS, TABLE, README = "jobs.yaml", "objects", "jobs.csv", "README.md"
_README = """\
# Run {run} on Kubernetes

{count} for a cluster that has Kubernetes 1.29 or later. The inputs go to S3 first:

    aws s3 sync {objects} s3://{bucket} --region {region}
    kubectl apply -f {manifests}

In the namespace there have to be

- the ServiceAccount `{account}`, whose pods have in AWS the rights that `calibration aws-policy --for job` prints
{secrets}- the right to pull the images.

How far it is: `kubectl get jobs -l {label}={label_value}`. A pod ends well when it has brought out what became of its
job, whatever that is. What became of it:

    aws s3 sync s3://{bucket}/{results} results --region {region}

`{table}` says where the result of each job is then. In it is a folder for each attempt, with `{outcome}` (`exit_code`:
0 pass, 1 fail, 2 and 3 could not be run; and `reasons`), and what was brought out in `{files}`. A job without an
`{outcome}` has not ended, or its pod was killed.

Nothing stays in the cluster after

    kubectl delete jobs -l {label}={label_value}
"""


@dataclass(frozen=True)
class _Folder:
    """A folder that stands for a bucket."""

    root: Path

    def put(self, key: str, data: bytes) -> None:
        write_atomically(self.root / key, data)

    def upload(self, key: str, file: IO[bytes], size: int) -> None:
        path = self.root / key
        if path.exists() and path.stat().st_size == size:
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("wb") as target:
            shutil.copyfileobj(file, target)


def write_rendering(jobs: Sequence[Job], settings: BatchSettings, run: str, folder: Path) -> None:
    """Write jobs for Kubernetes, with all that they need; what an earlier run left in the folder is replaced.

    Nothing is asked of AWS or of a cluster.

    Args:
        jobs: as they would go to a backend.
        settings: name the bucket, our image, and what containers get that say nothing.
        run: its name, in the bucket and in the cluster.
        folder: is made; all of it is there, or nothing.

    Raises:
        InputError: a job makes no sense in a pod, an input cannot be read, or the folder has other files.
        WorldError: the folder cannot be written.
    """
    check_jobs(jobs)
    jobs = [on_one_address(job) for job in jobs]
    groups = check_and_group(jobs, settings)
    if folder.exists() and not (folder / MANIFESTS).is_file():
        raise InputError(f"{folder}: exists already, and is no earlier rendering: remove it, or name another folder")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".kubernetes-", dir=folder.parent) as work:
            new = Path(work, "new")
            _write_objects(jobs, groups, settings, run, new / OBJECTS)
            write_atomically(new / TABLE, _table(jobs, groups))
            write_atomically(new / README, _readme(jobs, settings, run))
            write_atomically(new / MANIFESTS, rendered(jobs, settings, run))
            if folder.exists():
                folder.rename(Path(work, "old"))
            new.rename(folder)
    except OSError as error:
        raise WorldError(f"{folder}: cannot be written: {error.strerror or error}") from error


def _write_objects(
    jobs: Sequence[Job], groups: Sequence[Group], settings: BatchSettings, run: str, folder: Path
) -> None:
    store = _Folder(folder)
    location = Location(settings.bucket, settings.prefix, run, "")
    inputs = Inputs(store, location, settings.memory)
    inputs.upload(jobs, workers=1)
    for group in groups:
        place = Location(settings.bucket, settings.prefix, run, group.name)
        upload_jobs(store, place, [jobs[number] for number in group.jobs], inputs.entry, workers=1)


def _table(jobs: Sequence[Job], groups: Sequence[Group]) -> str:
    """Where the result of each job is, in the order of the jobs."""
    places = {number: f"results/{group.name}/{index}/" for group in groups for index, number in enumerate(group.jobs)}
    with io.StringIO(newline="") as text:
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(("job", "result"))
        writer.writerows((job.name, places[number]) for number, job in enumerate(jobs))
        return text.getvalue()


def _readme(jobs: Sequence[Job], settings: BatchSettings, run: str) -> str:
    secrets = sorted({name for job in jobs for container in job.containers for name in container.secrets})
    names = ", ".join(f"`{name}`" for name in secrets)
    return _README.format(
        run=run,
        count=f"{len(jobs)} job{'s' * (len(jobs) != 1)}",
        objects=OBJECTS,
        manifests=MANIFESTS,
        bucket=settings.bucket,
        region=settings.region,
        account=SERVICE_ACCOUNT,
        secrets=f"- the Secret `{SECRET}` with the variables {names}\n" if secrets else "",
        label=RUN_LABEL,
        label_value=name_of(run),
        results=f"{settings.prefix}/runs/{run}/results",
        table=TABLE,
        outcome=OUTCOME_FILE,
        files=FILES_FOLDER,
    )
