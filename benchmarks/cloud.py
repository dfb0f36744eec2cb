"""Many jobs on AWS Batch: what the client of ten thousand needs, against an emulator whose jobs end at once."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from typing import Any

from benchmarks.rows import Bar, Row

PROGRAM = """
import json, sys, time
from pathlib import Path
from calibration.addons.aws_batch.backend import BatchBackend
from tests.addons.aws_batch.client import SETTINGS, jobs

def memory():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096

count, begin, seen, early = int(sys.argv[1]), time.perf_counter(), 0, 0
with BatchBackend(SETTINGS) as backend:
    for _, outcome in backend.run(jobs(count), Path(sys.argv[2])):
        assert outcome.verdict == "pass"
        seen += 1
        if seen == count // 4:
            early = memory()
    assert seen == count
    seconds = time.perf_counter() - begin
    print(json.dumps({"early": early, "late": memory(), "calls": sum(backend.aws.calls.values()), "seconds": seconds}))
"""


def measure(quick: bool) -> Iterator[Row]:
    """A tenth of the jobs, then all."""
    try:
        import boto3  # noqa: F401  (asked for only)
        import moto  # noqa: F401
    except ImportError as error:
        yield Row("cloud/calls to AWS for a job", skipped=f"needs the package {error.name}")
        return
    count = 2_000 if quick else 10_000
    few, many = _run(count // 10), _run(count)
    note = f"{count} jobs, {many['calls']} calls: nearly all fetch a result"
    yield Row("cloud/calls to AWS for a job", many["calls"] / count, "", Bar(high=1.2), note)
    note = f"from {count // 4} results to {count}; {many['late'] / 1e6:.0f} MB in the end"
    yield Row("cloud/growth of memory", many["late"] / many["early"], "x", Bar(high=1.1), note)
    each = {size: 1000 * told["seconds"] / size for size, told in ((count // 10, few), (count, many))}
    note = f"{each[count]:.1f} ms with {count} jobs, {each[count // 10]:.1f} with {count // 10}; emulator included"
    yield Row("cloud/time for a job, many over few", each[count] / each[count // 10], "x", Bar(high=1.2), note)


def _run(count: int) -> dict[str, Any]:
    from tests.addons.aws_batch.client import Did, Tasks
    from tests.addons.aws_batch.fixtures import started_aws
    from tests.addons.aws_batch.services import Services

    services = Services()
    try:
        with started_aws(services) as aws, tempfile.TemporaryDirectory() as folder:
            Tasks(aws, lambda task, attempt: Did())
            command = [sys.executable, "-c", PROGRAM, str(count), folder]
            done = subprocess.run(command, env={**os.environ, **aws.variables}, stdout=subprocess.PIPE, check=True)
    finally:
        services.close()
    told: dict[str, Any] = json.loads(done.stdout)
    return told
