from dataclasses import replace

import pytest

from calibration.base import InputError
from calibration.ci.execution.job import Container, Job
from calibration.ci.execution.job_check import check_job, start_order
from calibration.ci.execution.ros import on_one_address, with_ros

JOB = Job(
    "j", (Container("sim", "team:1", environment={"ROS_HOME": "/mine"}), Container("robot", "team:2", after=("sim",)))
)


def test_none_changes_nothing() -> None:
    assert with_ros(JOB, "none") is JOB


def test_ros_1_has_a_master_that_everybody_waits_for() -> None:
    job = with_ros(JOB, "1")
    check_job(job)
    master, sim, robot = start_order(job)
    assert (master.name, master.image, master.essential) == ("master", "team:1", False)
    assert master.readiness is not None
    assert master.readiness.port == 11311
    assert (sim.after, robot.after) == (("master",), ("master", "sim"))
    for container in (master, sim, robot):
        assert container.environment["ROS_MASTER_URI"] == "http://master:11311"
        assert container.environment["ROS_HOSTNAME"] == container.name
    assert sim.environment["ROS_HOME"] == "/mine"  # the user's values take precedence


def test_ros_2_has_no_master_and_a_network_of_its_own() -> None:
    job = with_ros(replace(JOB, containers=(Container("a", "i", environment={"ROS_DOMAIN_ID": "7"}),)), "2")
    check_job(job)
    assert [c.name for c in job.containers] == ["a"]
    assert job.containers[0].environment["ROS_DOMAIN_ID"] == "7"
    assert job.own_network


@pytest.mark.parametrize(
    ("job", "message"),
    [
        (replace(JOB, network="none"), "ROS 1 needs the network private or internal, found none"),
        (replace(JOB, containers=(Container("master", "i"),)), "no other container may have the name 'master'"),
    ],
)
def test_invalid_jobs_with_a_master(job: Job, message: str) -> None:
    with pytest.raises(InputError, match=message):
        with_ros(job, "1")


def test_on_one_address_everybody_is_here() -> None:
    job = on_one_address(with_ros(JOB, "1"))
    check_job(job)
    for container in job.containers:
        assert container.environment["ROS_MASTER_URI"] == "http://127.0.0.1:11311"
        assert container.environment["ROS_HOSTNAME"] == "127.0.0.1"
    assert job.containers[1].environment["ROS_HOME"] == "/mine"
    assert [container.after for container in job.containers] == [(), ("master",), ("master", "sim")]


@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({"ROS_MASTER_URI": "http://b:1/x"}, {"ROS_MASTER_URI": "http://127.0.0.1:1/x"}),
        ({"ROS_MASTER_URI": "http://b"}, {"ROS_MASTER_URI": "http://127.0.0.1"}),
        # values that name no container of the job are kept
        ({"ROS_MASTER_URI": "http://bb:1"}, {"ROS_MASTER_URI": "http://bb:1"}),
        ({"ROS_MASTER_URI": "b"}, {"ROS_MASTER_URI": "b"}),
        ({"ROS_HOSTNAME": "10.0.0.7", "SERVER": "b"}, {"ROS_HOSTNAME": "10.0.0.7", "SERVER": "b"}),
        ({}, {}),
    ],
)
def test_on_one_address_only_names_of_containers_change(environment: dict[str, str], expected: dict[str, str]) -> None:
    job = Job("j", (Container("a", "i", environment=environment), Container("b", "i")))
    moved = on_one_address(job)
    assert moved.containers[0].environment == expected
    assert moved == replace(job, containers=moved.containers)
