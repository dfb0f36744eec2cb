"""The recorder beside a job's containers: who waits for whom, how its bag is closed, and how large it may become."""

import signal
import subprocess
import time
from dataclasses import replace
from pathlib import Path

import pytest

from calibration.base.errors import InputError
from calibration.ci.execution.job import Container, Job
from calibration.ci.execution.outcome import ContainerOutcome, End, JobOutcome
from calibration.ci.execution.recorder import (
    RECORDER_NAME,
    RECORDER_SCRIPT,
    Recording,
    recorder_reasons,
    with_recorder,
)
from calibration.ci.execution.ros import RosVersion, with_ros

JOB = Job("job", (Container("simulation", "robot:1"), Container("robot", "robot:1", after=("simulation",))))
PLACE = "/tmp/messages/robot"  # noqa: S108 (in a container)
RECORDS = """
trap 'mv robot.bag.active robot.bag; exit 0' INT
echo first > robot.bag.active
while :; do head -c "$1" /dev/zero >> robot.bag.active; sleep 0.05; done
"""
"""Writes a bag as rosbag does: under another name until it is closed."""


def test_the_others_wait_for_the_recorder_and_the_job_does_not_wait_for_it() -> None:
    job = with_ros(with_recorder(JOB, Recording(topics=("/scan", "/tf")), "1"), "1")
    found = {container.name: container for container in job.containers}
    assert list(found) == ["master", "simulation", "robot", RECORDER_NAME]
    assert found["robot"].after == ("master", RECORDER_NAME, "simulation")
    recorder = found[RECORDER_NAME]
    assert (recorder.after, recorder.essential, recorder.image) == (("master",), False, "robot:1")
    assert recorder.command[-6:] == ("rosbag", "record", "-O", f"{PLACE}.bag", "/scan", "/tf")
    assert recorder.environment["ROS_MASTER_URI"]
    assert job.artifact_bytes > JOB.artifact_bytes


def test_ros2_records_all_topics_by_its_own_recorder() -> None:
    recorder = with_recorder(JOB, Recording(image="tools:1"), "2").containers[-1]
    assert recorder.image == "tools:1"
    assert recorder.command[-6:] == ("ros2", "bag", "record", "-o", PLACE, "-a")


def test_without_a_recording_the_job_is_as_it_was() -> None:
    assert with_recorder(JOB, None, "1") is JOB


@pytest.mark.parametrize(
    ("job", "version", "found"),
    [
        (JOB, "none", "ros: 1 or 2"),
        (replace(JOB, containers=(Container(RECORDER_NAME, "robot:1"),)), "1", f"'{RECORDER_NAME}'"),
    ],
)
def test_what_cannot_be_recorded_is_wrong_input(job: Job, version: RosVersion, found: str) -> None:
    with pytest.raises(InputError, match=found):
        with_recorder(job, Recording(), version)


@pytest.mark.parametrize(
    ("end", "code", "found"),
    [
        (End.STOPPED, None, ""),
        (End.EXITED, 3, "has reached 1 GiB"),
        (End.EXITED, 1, "ended before the applications: exited with code 1"),
        (End.OUT_OF_MEMORY, 137, "out of memory"),
    ],
)
def test_a_recorder_that_ends_too_early_is_a_reason(end: End, code: int | None, found: str) -> None:
    outcome = JobOutcome("job", Path("job"), (ContainerOutcome(RECORDER_NAME, end, code),))
    reasons = recorder_reasons(outcome, Recording())
    assert bool(reasons) == bool(found)
    assert all(found in reason for reason in reasons)
    assert recorder_reasons(outcome, None) == ()


def recorder(folder: Path, kib: int, step: int) -> "subprocess.Popen[str]":
    """Start the recorder's script, with something that records so many bytes at a time, and wait for its first."""
    arguments = ["bash", "-c", RECORDER_SCRIPT, "recorder", str(folder), str(kib)]
    process = subprocess.Popen(
        [*arguments, "bash", "-c", RECORDS, "records", str(step)], cwd=folder, stderr=subprocess.PIPE, text=True
    )
    until = time.monotonic() + 60
    while not list(folder.glob("robot.bag*")) and time.monotonic() < until:
        time.sleep(0.01)
    return process


@pytest.mark.parametrize("by", [signal.SIGTERM, signal.SIGINT])
def test_the_end_of_the_job_closes_the_bag(by: signal.Signals, tmp_path: Path) -> None:
    with recorder(tmp_path, 1 << 20, 10) as process:
        process.send_signal(by)
        _, said = process.communicate(timeout=60)
    assert process.returncode == 0, said
    assert [file.name for file in tmp_path.iterdir()] == ["robot.bag"]


def test_a_bag_that_becomes_too_large_is_closed_and_the_recorder_ends(tmp_path: Path) -> None:
    with recorder(tmp_path, 200, 100_000) as process:
        _, said = process.communicate(timeout=60)
    assert process.returncode == 3, said
    assert "larger than 200 KiB" in said
    assert [file.name for file in tmp_path.iterdir()] == ["robot.bag"]


def test_a_recorder_that_dies_ends_with_its_code(tmp_path: Path) -> None:
    arguments = ["bash", "-c", RECORDER_SCRIPT, "recorder", str(tmp_path), "100", "bash", "-c", "exit 7"]
    assert subprocess.run(arguments, check=False, timeout=60).returncode == 7
