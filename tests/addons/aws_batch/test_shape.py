from dataclasses import replace
from pathlib import Path

from calibration.addons.aws_batch.definition import (
    ContainerShape,
    MountShape,
    Resources,
    Shape,
    group_by_shape,
    shape_of,
)
from calibration.ci.execution.job import Artifact, Limits, Readiness, Relaxations
from tests.addons.aws_batch.samples import REGISTRY, SETTINGS, container, job, simulation


def test_shape_of_a_job(tmp_path: Path) -> None:
    assert shape_of(simulation(tmp_path), SETTINGS) == Shape(
        containers=(
            ContainerShape(
                name="simulation",
                image=f"{REGISTRY}/simulation@sha256:{'0' * 64}",
                resources=Resources(2, 3 * 1024 + 1),  # one byte more than 3 GiB
                mounts=(MountShape(0, "/data", False),),
            ),
            ContainerShape(
                name="robot",
                image=f"{REGISTRY}/robot:1",
                resources=Resources(1, 2048),
                user="1000",
                secrets=("TOKEN",),
                mounts=(MountShape(0, "/data", False), MountShape(1, "/scratch", True)),
            ),
        ),
        volumes=("/data", "/scratch"),
    )


def test_inputs_do_not_change_the_shape() -> None:
    changes = [
        job(container(command=("calibrate", "--seed", "2"), environment={"A": "1"}, working_directory="/w"), name="k"),
        job(container(readiness=Readiness(port=1), limits=Limits(seconds=3), artifacts=(Artifact("/o"),)), seconds=1),
        job(container(entrypoint=("/run",), success=(3,))),
        # explicit default values
        job(container(limits=Limits(cpus=SETTINGS.cpus, memory=SETTINGS.memory))),
    ]
    group, *others = group_by_shape([job(), *changes], SETTINGS)
    assert others == []
    assert group.jobs == (0, 1, 2, 3, 4)


def test_changes_of_the_shape() -> None:
    changes = [
        container(image="other"),
        container("another"),
        container(user="root"),
        container(limits=Limits(cpus=2)),
        container(limits=Limits(memory=10**9)),
        container(environment={"TOKEN": "x"}, secrets=frozenset({"TOKEN"})),
        container(relaxations=Relaxations(gpus=True)),
    ]
    jobs = [job(each) for each in [container(), *changes]]
    groups = group_by_shape([*jobs, *reversed(jobs)], SETTINGS)
    assert [group.jobs for group in groups] == [(i, 15 - i) for i in range(8)]
    assert len({group.name for group in groups}) == 8
    # the same jobs in another run and process have the same groups
    assert [group.name for group in groups] == [group.name for group in group_by_shape(jobs, SETTINGS)]
    assert groups[0].name == "c07b5b521ae6"
    assert group_by_shape([job()], replace(SETTINGS, cpus=4))[0].name != groups[0].name


def test_no_secret_is_in_a_shape(tmp_path: Path) -> None:
    assert "s3cret" not in repr(shape_of(simulation(tmp_path), SETTINGS))
