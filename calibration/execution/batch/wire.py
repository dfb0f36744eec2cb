"""What the client and a task on AWS Batch tell each other: keys in S3, variables, names of containers and folders.

Below ``s3://BUCKET/PREFIX/``::

    inputs/SHA256.tar                        what a mount holds, by its content; shared by runs
    runs/RUN/jobs/GROUP/NNNNN.json           the jobs of a group, `JOBS_PER_FILE` in each file
    runs/RUN/jobs/GROUP/submitted.json       under which ids of AWS Batch they were submitted
    runs/RUN/results/GROUP/INDEX/ATTEMPT/    what one attempt leaves: files/PATH..., and, last, outcome.json

A group is jobs of one shape: one array (or a few, past 10 000). Job ``INDEX`` of a group is child
``INDEX - FIRST`` of its array.
"""

import re
from dataclasses import dataclass

from calibration.errors import InputError

PREPARE, WATCH = "calibration-prepare", "calibration-watch"
"""Our containers in every task: the first to run, and the essential one."""
JOB_FOLDER = "/calibration/job"
"""A volume that all containers of a task share: scripts, and what they tell each other."""
MOUNTS_FOLDER = "/calibration/mounts"
"""Where the first container sees the volumes of the mounts: ``MOUNTS_FOLDER/0``, ``/1``..."""
JOBS_PER_FILE = 100
ARRIVAL_SECONDS = 1200.0
"""What the containers of a task have for coming up, images pulled among it; the time of the job begins after that."""
UPLOAD_SECONDS = 600.0
"""What is left, after the time of the job, for stopping its containers and bringing out what they left, before the
task's own limit should strike."""
OUTCOME_FILE, FILES_FOLDER = "outcome.json", "files"
LOCATION, FIRST = "CALIBRATION_LOCATION", "CALIBRATION_FIRST"
"""Variables of our containers, given when the job is submitted: ``s3://BUCKET/PREFIX``'s run and group as in
`Location.text`, and the index of the array's first child."""
REGION = "AWS_REGION"
"""Variable that says where the bucket is. ECS sets it on Fargate only, so it is given when the job is submitted."""
INDEX, ATTEMPT = "AWS_BATCH_JOB_ARRAY_INDEX", "AWS_BATCH_JOB_ATTEMPT"
"""Variables that Batch sets: the child (none where there is no array), and the attempt, from 1."""

_RUN_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,60}")


def check_run_name(name: str) -> None:
    """Refuse a name of a run that cannot be part of keys and of other names.

    Raises:
        InputError: it cannot.
    """
    if not _RUN_NAME.fullmatch(name):
        raise InputError(f"run '{name}': expected letters, digits, _ . and -, at most 61")


@dataclass(frozen=True)
class Location:
    """A group of jobs of a run, in S3."""

    bucket: str
    prefix: str
    run: str
    group: str

    @property
    def text(self) -> str:
        """As the variable `LOCATION` has it."""
        return f"s3://{self.bucket}/{self.prefix}/{self.run}/{self.group}"

    @classmethod
    def parse(cls, text: str) -> "Location":
        """Read the variable."""
        bucket, _, path = text.removeprefix("s3://").partition("/")
        prefix, run, group = path.rsplit("/", 2)
        return cls(bucket, prefix, run, group)

    def input_key(self, sha256: str) -> str:
        """Of what a mount holds."""
        return f"{self.prefix}/inputs/{sha256}.tar"

    def jobs_key(self, index: int) -> str:
        """Of the file that has the job."""
        return f"{self.prefix}/runs/{self.run}/jobs/{self.group}/{index // JOBS_PER_FILE:05}.json"

    @property
    def submitted_key(self) -> str:
        """Of the file that says under which ids the group was submitted."""
        return f"{self.prefix}/runs/{self.run}/jobs/{self.group}/submitted.json"

    def attempts_key(self, index: int) -> str:
        """Of the folder that has a folder for each attempt at a job."""
        return f"{self.prefix}/runs/{self.run}/results/{self.group}/{index}/"

    def result_key(self, index: int, attempt: int, name: str = "") -> str:
        """Of a file that an attempt leaves; of their folder where no name is given."""
        return f"{self.attempts_key(index)}{attempt}/{name}"
