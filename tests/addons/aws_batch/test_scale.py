"""Many jobs: constant memory during downloads, and a bounded number of requests per job."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.addons.aws_batch.client import Did, Tasks
from tests.addons.aws_batch.fixtures import Aws

JOBS = 300
PROGRAM = """
import json, sys, time
from pathlib import Path
from calibration.addons.aws_batch.backend import BatchBackend
from tests.addons.aws_batch.client import SETTINGS, jobs

def memory():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096

count = int(sys.argv[1])
seen, marks = set(), {}
with BatchBackend(SETTINGS) as backend:
    began = time.monotonic()
    for index, outcome in backend.run(jobs(count), Path(sys.argv[2])):
        assert outcome.verdict == "pass" and outcome.job == f"world/{index}" and index not in seen
        seen.add(index)
        if len(seen) in (count // 4, count):
            marks[len(seen)] = memory()
    assert len(seen) == count
    told = {"calls": backend.aws.calls, "seconds": backend.usage.seconds, "took": time.monotonic() - began}
    print(json.dumps({"memory": list(marks.values()), **told}))
"""


@pytest.mark.thorough
def test_many_jobs(batch_emulator: Aws, tmp_path: Path) -> None:
    Tasks(batch_emulator, lambda task, attempt: Did())
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(JOBS), str(tmp_path)], env=os.environ, stdout=subprocess.PIPE, check=True
    )
    told = json.loads(done.stdout)
    early, late = told["memory"]
    assert late - early < 8 * 1024**2
    calls = told["calls"]
    assert calls["s3:GetObject"] == JOBS  # the outcome only, without artifacts
    assert calls["s3:PutObject"] == JOBS // 100 + 1
    assert calls["batch:SubmitJob"] == 1
    looks = 3 * told["took"]  # at least a second apart
    assert sum(calls.values()) - calls["s3:GetObject"] - calls["s3:PutObject"] < 0.1 * JOBS + looks
    assert told["seconds"] >= 60 * JOBS  # Fargate bills at least one minute
