import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.addons.aws_batch.wire import (
    Input,
    TaskJob,
    job_entry,
    jobs_document,
    mount_targets,
    parse_json,
    read_job,
)
from calibration.base import InfrastructureError
from calibration.ci.execution.job import Artifact, Container, Job, Limits, Mount, Readiness

SECRET = "pl4nted"  # noqa: S105
FULL = Job(
    "set/3",
    (
        Container(
            "sim",
            "image",
            ("run", "it's $x"),
            entrypoint=("/e",),
            environment={"A": "1", "TOKEN": SECRET},
            secrets=frozenset({"TOKEN"}),
            working_directory="/w",
            user="7",
            mounts=(Mount(Path("/data"), "/b/"), Mount(Path("/world"), "/a", writable=True)),
            limits=Limits(memory=5 * 2**20, cpus=2, seconds=9.5),
            readiness=Readiness(port=80, log="up", file="/f", command=("ask",), seconds=3),
            after=("robot",),
            essential=False,
            success=(0, 3),
            artifacts=(Artifact("/calibration/output/*", required=False),),
        ),
        Container("robot", "image", ("go",), mounts=(Mount(Path("/data"), "/b"),)),
    ),
    seconds=None,
    artifact_bytes=10,
    artifact_files=20,
)
INPUTS = (Input(0, "p/inputs/x.tar", "ab", 3, writable=True), Input(1, "p/inputs/y.tar", "cd", 4))


def document(**changes: Any) -> bytes:
    return jobs_document([{**job_entry(FULL, INPUTS), **changes}])


def robot(**changes: Any) -> dict[str, Any]:
    return {"robot": {**job_entry(FULL, ())["containers"]["robot"], **changes}}


def test_a_task_has_the_job_without_properties_of_its_definition() -> None:
    data = jobs_document([job_entry(replace(FULL, name="other"), ()), job_entry(FULL, INPUTS, memory=64)])
    expected = TaskJob(
        replace(
            FULL,
            containers=(
                replace(
                    FULL.containers[0],
                    image="",
                    environment={"A": "1"},
                    secrets=frozenset(),
                    user=None,
                    mounts=(),
                    limits=Limits(memory=5 * 2**20, seconds=9.5),
                ),
                replace(FULL.containers[1], image="", mounts=(), limits=Limits(memory=64)),
            ),
        ),
        INPUTS,
    )
    assert read_job(data, 1, "f") == expected
    assert SECRET.encode() not in data
    assert b"TOKEN" not in data


def test_volumes_are_numbered_by_their_targets() -> None:
    assert mount_targets(FULL) == ("/a", "/b")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"{}", "f: there is no job 0 in it"),
        (b"[]", "f: there is no job 0 in it"),
        (b"[1]", "f: job 0: found 1, expected keys: name, "),
        (document(more=1), "f: job 0: unknown key 'more'"),
        (document(timeout=-1), "f: job 0: timeout: found -1"),
        (
            document(containers={"../x": {}}),
            "containers: found the name '../x', expected the name of a container",
        ),
        (document(containers={"a\nb": {}}), "expected the name of a container"),
        (document(containers=robot(success=[256])), "containers.robot.success.0: found 256"),
        (document(containers=robot(ready={"port": 0})), "containers.robot.ready.port: found 0"),
        (document(inputs=[{"volume": -1}]), "inputs.0.volume: found -1"),
    ],
)
def test_invalid_documents_are_refused(data: bytes, message: str) -> None:
    with pytest.raises(InfrastructureError) as caught:
        read_job(data, 0, "f")
    assert message in str(caught.value)


ARGUMENTS = st.text(st.characters(exclude_characters="\0"), max_size=20)
VARIABLES = st.text(st.characters(exclude_characters="="), min_size=1, max_size=20)


@given(
    st.builds(
        Container,
        name=st.from_regex(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,10}", fullmatch=True),
        image=st.just(""),
        command=st.lists(ARGUMENTS, max_size=3).map(tuple),
        entrypoint=st.none() | st.lists(ARGUMENTS, max_size=2).map(tuple),
        environment=st.dictionaries(VARIABLES, st.text(max_size=20), max_size=3),
        limits=st.builds(
            Limits,
            memory=st.none() | st.integers(1, 2**40),
            cpus=st.none(),
            seconds=st.none() | st.floats(0, 1e7, exclude_min=True),
        ),
        essential=st.booleans(),
        success=st.lists(st.integers(0, 255), max_size=3).map(tuple),
    )
)
def test_round_trip(container: Container) -> None:
    job = Job("j", (container,))
    assert read_job(jobs_document([job_entry(job, ())]), 0, "f") == TaskJob(job)


def test_the_same_jobs_are_the_same_bytes() -> None:
    assert document() == document()
    assert json.loads(document())[0]["name"] == "set/3"


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"x" * 101, "f: found 101 bytes, at most 100 were expected"),
        (b"{", "f: this is no JSON: Expecting property name"),
        (b'{"a": NaN}', "f: this is no JSON: found NaN, a finite number was expected"),
        (b"-Infinity", "f: this is no JSON: found -Infinity, a finite number was expected"),
        (b"\xff", "f: this is no JSON: "),
        (b"[" * 100, "f: this is no JSON: "),
    ],
)
def test_invalid_json(data: bytes, message: str) -> None:
    with pytest.raises(InfrastructureError) as caught:
        parse_json(data, 100, "f")
    assert message in str(caught.value)


def test_nested_too_deeply() -> None:
    with pytest.raises(InfrastructureError, match="this is no JSON: "):
        parse_json(b"[" * 200_000 + b"]" * 200_000, 10**6, "f")
