"""The recorder beside a job's containers: who waits for whom, how its bag is closed, and how large it may become."""

import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from calibration.base import InputError
from calibration.ci.execution.job import Container, Job
from calibration.ci.execution.outcome import ContainerOutcome, End, JobOutcome
from calibration.ci.execution.ros import (
    RECORDER_NAME,
    RECORDER_SCRIPT,
    Recording,
    RosVersion,
    recorder_reasons,
    with_recorder,
    with_ros,
)

JOB = Job("job", (Container("simulation", "robot:1"), Container("robot", "robot:1", after=("simulation",))))
PLACE = "/tmp/messages/robot"  # noqa: S108 (in a container)
CHILD = """
import os, signal, sys, time
going = True
def stop(*_):
    global going
    going = False
signal.signal(signal.SIGINT, stop)
with open("robot.bag.active", "wb", buffering=0) as bag:
    while going:
        bag.write(bytes(int(sys.argv[1])))
        time.sleep(0.05)
time.sleep(1.5)
os.rename("robot.bag.active", "robot.bag")
"""
"""Writes a bag as rosbag's program does: under another name until it is closed."""
PARENT = """
import subprocess, sys
subprocess.Popen([sys.executable, "-c", *sys.argv[1:]]).wait()
"""
"""Dies of SIGINT at once, as rosbag's script does, while its child closes the bag."""


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


def recorded(folder: Path, kib: int, step: int, by: signal.Signals | None) -> tuple[int, str]:
    """Run the recorder's script on something that records so many bytes at a time, and send it a signal.

    Returns:
        Its exit code when it has ended, whatever it has started still does, and what it has written to its log.
    """
    (folder / "bag").mkdir()
    arguments = ["bash", "-c", RECORDER_SCRIPT, "recorder", str(folder / "bag"), str(kib)]
    with (folder / "log").open("w") as log:
        process = subprocess.Popen(
            [*arguments, sys.executable, "-c", PARENT, CHILD, str(step)], cwd=folder / "bag", stderr=log
        )
        until = time.monotonic() + 60
        while not list(folder.glob("bag/robot.bag*")) and time.monotonic() < until:
            time.sleep(0.01)
        if by is not None:
            process.send_signal(by)
        code = process.wait(60)
    return code, (folder / "log").read_text()


@pytest.mark.parametrize("by", [signal.SIGTERM, signal.SIGINT])
def test_the_end_of_the_job_closes_the_bag_before_the_recorder_ends(by: signal.Signals, tmp_path: Path) -> None:
    _, log = recorded(tmp_path, 1 << 20, 10, by)
    assert [file.name for file in (tmp_path / "bag").iterdir()] == ["robot.bag"]
    assert "KeyboardInterrupt" in log


def test_a_bag_that_becomes_too_large_is_closed_and_the_recorder_ends(tmp_path: Path) -> None:
    code, log = recorded(tmp_path, 200, 100_000, None)
    assert code == 3
    assert "larger than 200 KiB" in log
    assert [file.name for file in (tmp_path / "bag").iterdir()] == ["robot.bag"]


def test_a_recorder_that_dies_ends_with_its_code(tmp_path: Path) -> None:
    arguments = ["bash", "-c", RECORDER_SCRIPT, "recorder", str(tmp_path), "100", "bash", "-c", "exit 7"]
    assert subprocess.run(arguments, check=False, timeout=60).returncode == 7
