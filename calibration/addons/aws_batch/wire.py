"""Names shared by the client and tasks on AWS Batch: S3 keys, variables, containers and folders.

Layout of ``s3://BUCKET/PREFIX/``::

    inputs/SHA256.tar                        content of a mount, by its digest; shared by runs
    runs/RUN/jobs/GROUP/NNNNN.json           jobs of a group, `JOBS_PER_FILE` in each file
    runs/RUN/jobs/GROUP/submitted.json       ids of the submissions in AWS Batch
    runs/RUN/results/GROUP/INDEX/ATTEMPT/    results of one attempt: files/PATH..., and, last, outcome.json

A group contains jobs of one shape: one array (or several, above 10 000). Job ``INDEX_VARIABLE`` of a group is child
``INDEX - FIRST`` of its array.
"""

import re
from dataclasses import dataclass

from calibration.base.errors import InputError

PREPARE_CONTAINER, WATCH_CONTAINER = "calibration-prepare", "calibration-watch"
"""Our containers in every task: the first to run, and the essential one."""
JOB_FOLDER = "/calibration/job"
"""Volume shared by all containers of a task, with scripts and signals."""
MOUNTS_FOLDER = "/calibration/mounts"
"""Mount point of the volumes of the job's mounts in the first container: ``MOUNTS_FOLDER/0``, ``/1``..."""
JOBS_PER_FILE = 100
ARRIVAL_SECONDS = 1200.0
"""Time limit for the containers of a task to start, including pulls of images; the time of the job starts later."""
UPLOAD_SECONDS = 600.0
"""Time for stopping containers and uploading results, after the time of the job and before the time limit of the
task."""
OUTCOME_FILE, FILES_FOLDER = "outcome.json", "files"
LOCATION_VARIABLE, FIRST_VARIABLE = "CALIBRATION_LOCATION", "CALIBRATION_FIRST"
"""Variables of our containers, set on submission: ``s3://BUCKET/PREFIX``, run and group in the form of
`Location.text`, and the index of the array's first child."""
REGION_VARIABLE = "AWS_REGION"
"""Region of the bucket, set on submission, because ECS sets it only on Fargate."""
INDEX_VARIABLE, ATTEMPT_VARIABLE = "AWS_BATCH_JOB_ARRAY_INDEX", "AWS_BATCH_JOB_ATTEMPT"
"""Variables that Batch sets: index of the child (only in arrays), and of the attempt, from 1."""

_RUN_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,60}")


def check_run_name(name: str) -> None:
    """Refuse a name of a run that is invalid in keys and other names.

    Raises:
        InputError: it is invalid.
    """
    if not _RUN_NAME.fullmatch(name):
        raise InputError(f"run '{name}': expected letters, digits, _ . and -, at most 61")


@dataclass(frozen=True)
class Location:
    """Location of a group of a run's jobs in S3."""

    bucket: str
    prefix: str
    run: str
    group: str

    @property
    def text(self) -> str:
        """Value of the variable `LOCATION_VARIABLE`."""
        return f"s3://{self.bucket}/{self.prefix}/{self.run}/{self.group}"

    @classmethod
    def parse(cls, text: str) -> "Location":
        """Parse the variable `LOCATION_VARIABLE`."""
        bucket, _, path = text.removeprefix("s3://").partition("/")
        prefix, run, group = path.rsplit("/", 2)
        return cls(bucket, prefix, run, group)

    def input_key(self, sha256: str) -> str:
        """Return the key of a mount's content."""
        return f"{self.prefix}/inputs/{sha256}.tar"

    def jobs_key(self, index: int) -> str:
        """Return the key of the file with a job."""
        return f"{self.prefix}/runs/{self.run}/jobs/{self.group}/{index // JOBS_PER_FILE:05}.json"

    @property
    def submitted_key(self) -> str:
        """Key of the file with the ids of the group's submissions."""
        return f"{self.prefix}/runs/{self.run}/jobs/{self.group}/submitted.json"

    def attempts_key(self, index: int) -> str:
        """Return the prefix of the attempts at a job."""
        return f"{self.prefix}/runs/{self.run}/results/{self.group}/{index}/"

    def result_key(self, index: int, attempt: int, name: str = "") -> str:
        """Return the key of a file of an attempt, or their common prefix without a name."""
        return f"{self.attempts_key(index)}{attempt}/{name}"
