import socket
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from calibration.base import InputError
from calibration.ci.execution.job import OUTPUT, Artifact, Container, Job, Limits, Mount, Readiness, Relaxations
from calibration.ci.execution.job_check import check_job, check_jobs, start_order


def container(name: str = "a", **settings: Any) -> Container:
    return Container(name, "image:1", ("true",), **settings)


def job(*containers: Container, name: str = "job", **settings: Any) -> Job:
    return Job(name, containers or (container(),), **settings)


def refused(wrong: Job) -> str:
    with pytest.raises(InputError) as caught:
        check_job(wrong)
    return str(caught.value)


def test_valid_jobs_are_accepted(tmp_path: Path) -> None:
    check_job(
        job(
            container(
                environment={"A": "1", "TOKEN": "x"},
                secrets=frozenset({"TOKEN"}),
                working_directory="/w",
                mounts=(Mount(tmp_path, "/data"),),
                limits=Limits(memory=64 * 1024**2, cpus=0.5, processes=10, seconds=1.5),
                readiness=Readiness(port=1, log="ready", file="/f", command=("true",)),
                artifacts=(Artifact(f"{OUTPUT}/*"),),
                relaxations=Relaxations(devices=("/dev/null",)),
                success=(0, 3),
            ),
            container("b", after=("a",), essential=False),
            name="t2rgb/tn0.5_rn0/seed 1",
        )
    )


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"image": " "}, "it has no image"),
        ({"name": "a b"}, "no name for a container"),
        ({"name": "../x"}, "no name for a container"),
        ({"name": "x" * 64}, "no name for a container"),
        ({"environment": {"A=B": "1"}}, "environment: 'A=B' is no name"),
        ({"environment": {"A": "x\0"}}, "NUL"),
        ({"secrets": frozenset({"TOKEN"})}, "secrets: 'TOKEN' is no variable of its environment"),
        ({"command": ("a\0",)}, "command: an argument has a NUL"),
        ({"working_directory": "here"}, "working-directory 'here': expected an absolute path"),
        ({"limits": Limits(memory=1024)}, "memory: 1024 bytes are below the minimum of all engines"),
        ({"readiness": Readiness(file="relative")}, "ready: file 'relative': expected an absolute path"),
        ({"readiness": Readiness(log="(")}, "is no regular expression"),
        ({"mounts": (Mount(Path("/nosuch"), "/data"),)}, "mount '/data': there is no /nosuch on this machine"),
        ({"mounts": (Mount(Path("/etc"), "data"),)}, "mount 'data': expected an absolute path"),
        ({"mounts": (Mount(Path("/etc"), "/"),)}, "expected an absolute path in the container, and not its root"),
        ({"mounts": (Mount(Path("/etc"), "/a/../b"),)}, "mount '/a/../b': expected an absolute path"),
        ({"mounts": (Mount(Path("/etc"), "/a"), Mount(Path("/etc"), "/a/"))}, "another mount has the same target"),
        ({"mounts": (Mount(Path("/etc"), OUTPUT),)}, "is the job's own volume"),
        ({"mounts": (Mount(Path("/etc"), "/calibration"),)}, "is the job's own volume"),
        ({"mounts": (Mount(Path("/etc"), f"{OUTPUT}/x"),)}, "is the job's own volume"),
        ({"mounts": (Mount(Path("/"), "/host"),)}, "docker-socket: true"),
        ({"mounts": (Mount(Path("/var/run"), "/host"),)}, "docker-socket: true"),
        ({"artifacts": (Artifact("out/*"),)}, "artifact 'out/*': expected an absolute path"),
        ({"artifacts": (Artifact("/out/../etc"),)}, "artifact '/out/../etc': expected an absolute path"),
        ({"artifacts": (Artifact("/**/*.csv"),)}, "the whole container would have to be read"),
        ({"artifacts": (Artifact("/"),)}, "the whole container would have to be read"),
        ({"after": ("b",)}, "after: there is no container 'b'"),
        ({"after": ("a",)}, "containers wait for each other: a after a"),
        ({"essential": False}, "no container is essential"),
    ],
)
def test_a_container_that_makes_no_sense(settings: dict[str, Any], message: str) -> None:
    said = refused(job(replace(container(), **settings)))
    assert message in said
    assert said.startswith("job 'job'")


def test_a_socket_is_refused_wherever_it_lies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    engine = tmp_path / "engine"
    engine.mkdir()
    with socket.socket(socket.AF_UNIX) as opened:
        opened.bind(str(engine / "docker.sock"))
        link = tmp_path / "innocent"
        link.symlink_to(engine / "docker.sock")
        assert "docker-socket: true" in refused(job(container(mounts=(Mount(link, "/data"),))))
        monkeypatch.setenv("DOCKER_HOST", f"unix://{engine}/docker.sock")
        assert "docker-socket: true" in refused(job(container(mounts=(Mount(engine, "/data"),))))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (Job("job", ()), "it has 0 containers"),
        (job(container("a"), container("A")), "two containers have the name 'A'"),
        (job(name="../a"), "no name for a job"),
        (job(name="a/./b"), "no name for a job"),
        (job(name="a//b"), "no name for a job"),
        (job(name="/a"), "no name for a job"),
        (job(name=""), "no name for a job"),
        (job(name="a\nb"), "no name for a job"),
        (job(name="/".join("abcdefghi")), "no name for a job"),
        (
            job(container("a", after=("c",)), container("b", after=("a",)), container("c", after=("b",))),
            "a after c after b after a",
        ),
        (job(container("sim"), container("b", after=("sum",))), "did you mean 'sim'?"),
    ],
)
def test_a_job_that_makes_no_sense(wrong: Job, message: str) -> None:
    assert message in refused(wrong)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["a", "A"], "another job of the run has the name 'a'"),
        (["a/artifacts", "a"], "job 'a/artifacts': its folder would lie in that of job 'a'"),
    ],
)
def test_jobs_of_a_run_have_folders_of_their_own(names: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        check_jobs([job(name=name) for name in names])
    check_jobs([job(name="a/1"), job(name="a/2"), job(name="b")])


def test_the_order_is_the_given_one_where_nothing_waits() -> None:
    order = start_order(job(container("c", after=("d",)), container("a"), container("d"), container("b")))
    assert [each.name for each in order] == ["d", "c", "a", "b"]
