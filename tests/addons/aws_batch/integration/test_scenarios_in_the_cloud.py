"""Scenarios of our simulation on AWS Batch give the same bytes as on this machine's engine."""

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.addons.aws_batch.emulator.faults import child
from tests.addons.aws_batch.fixtures import BUCKET, QUEUE, REGION
from tests.integration.pipeline.test_scenarios import collect, on_docker, scenarios, tree

if TYPE_CHECKING:
    from tests.addons.aws_batch.fixtures import Aws

__all__ = ["on_docker", "scenarios"]

ROLE = "arn:aws:iam::123456789012:role/robots"


@pytest.fixture
def section(tools_image: str, tmp_path: Path) -> Path:
    path = tmp_path / "cloud.yml"
    path.write_text(
        f"aws-batch: {{region: {REGION}, queue: {QUEUE}, bucket: {BUCKET}, tools-image: '{tools_image}', "
        f"job-role: '{ROLE}', execution-role: '{ROLE}'}}\n"
    )
    return path


@pytest.mark.thorough
def test_in_the_cloud_the_verdict_and_every_byte_are_the_same(
    on_docker: Path,
    small: Path,
    scenarios: Path,
    section: Path,
    tools_image: str,
    batch_in_containers: "Aws",
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    batch_in_containers.faults.lose_host(child(1))
    batch_in_containers.faults.throttle("SubmitJob")
    batch_in_containers.faults.throttle("DescribeJobs", times=2, after=1)
    output = tmp_path / "out"
    options = ("--aws-batch", str(section), "--run", "nightly")
    assert collect(small, scenarios, output, "aws-batch", tools_image, *options) == 1
    said = capsys.readouterr().out
    assert "attempt 1 of 2 lost its host" in said
    assert tree(output / "scenarios") == tree(on_docker / "scenarios")
    names = ("results.json", "scenarios.csv", "junit.xml", "summary.md")
    assert {name: (output / name).read_bytes() for name in names} == {
        name: (on_docker / name).read_bytes() for name in names
    }
    batch = batch_in_containers.client("batch")
    for status in ("SUBMITTED", "PENDING", "RUNNABLE", "STARTING", "RUNNING"):
        assert batch.list_jobs(jobQueue=QUEUE, jobStatus=status)["jobSummaryList"] == []

    calls = len(batch.list_jobs(jobQueue=QUEUE, jobStatus="SUCCEEDED")["jobSummaryList"])
    again = tmp_path / "again"  # another machine: nothing but the name of the run is known
    assert collect(small, scenarios, again, "aws-batch", tools_image, *options, "--resume") == 1
    assert tree(again / "scenarios") == tree(on_docker / "scenarios")
    assert len(batch.list_jobs(jobQueue=QUEUE, jobStatus="SUCCEEDED")["jobSummaryList"]) == calls
