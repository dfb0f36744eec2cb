"""The documents of jobs on AWS Batch, fuzzed by `tests.campaigns`."""

from calibration.addons.aws_batch.wire import Input, job_entry, jobs_document, read_job
from calibration.ci.execution.job import Container, Job, Readiness
from tests.campaigns.target import Target


def _job() -> list[bytes]:
    ready = Readiness(port=80, seconds=1.0)
    job = Job("a", (Container("m", "image", ("x",), environment={"A": "b"}, readiness=ready),), seconds=3600.0)
    return [jobs_document([job_entry(job, (Input(0, "k", "0" * 64, 3),), memory=100)])]


TARGETS = {
    "job": Target("job.json", _job, lambda path: read_job(path.read_bytes(), 0, "job"), 4),
}
"""By name."""
