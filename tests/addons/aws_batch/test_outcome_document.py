"""Invalid outcomes are refused, with the name of the file."""

import json
from contextlib import suppress
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.addons.aws_batch.wire import (
    TaskOutcome,
    max_outcome_bytes,
    outcome_document,
    read_outcome,
)
from calibration.base import CalibrationError, ExitCode, InfrastructureError
from calibration.ci.execution.job import Container, Job
from calibration.ci.execution.outcome import ArtifactFile, ContainerOutcome, End

JOB = Job(
    "j/1",
    (Container("sim", "i", essential=False), Container("robot", "i", success=(0, 3))),
    artifact_bytes=100,
    artifact_files=3,
)
FILE = ArtifactFile("d/a.csv", "robot", 60, "0" * 64)
PASSED = TaskOutcome(
    "j/1",
    2,
    ExitCode.PASS,
    seconds=1.5,
    containers=(
        ContainerOutcome("sim", End.STOPPED, 143, "SIGTERM", 1.25),
        ContainerOutcome("robot", End.EXITED, 3, None, 1.0),
    ),
    artifacts=(FILE, replace(FILE, path="d/b", size=40)),
    left_out=("container 'robot': 'd/l' is a link to 'a'",),
)
FAILED = replace(
    PASSED,
    exit_code=ExitCode.FAIL,
    reasons=("first", "second"),
    containers=(
        ContainerOutcome("sim", End.NOT_STARTED),
        ContainerOutcome("robot", End.LOST, None, None, 1.0),
    ),
    artifacts=(),
    left_out=(),
)


def read(document: object, job: Job = JOB, attempt: int = 2) -> TaskOutcome:
    return read_outcome(json.dumps(document).encode(), job, attempt, "f")


@pytest.mark.parametrize("outcome", [PASSED, FAILED, replace(FAILED, exit_code=ExitCode.INFRASTRUCTURE)])
def test_round_trip(outcome: TaskOutcome) -> None:
    data = outcome_document(outcome)
    assert read_outcome(data, JOB, 2, "f") == outcome
    assert len(data) < max_outcome_bytes(JOB)


def containers(**changes: Any) -> list[dict[str, Any]]:
    first, second = json.loads(outcome_document(PASSED))["containers"]
    return [first, {**second, **changes}]


def artifact(**changes: Any) -> list[dict[str, Any]]:
    first, second = json.loads(outcome_document(PASSED))["artifacts"]
    return [first, {**second, **changes}]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"schema": 2}, "schema: found 2"),
        ({"job": "other"}, "job: found 'other', expected 'j/1'"),
        ({"attempt": 1}, "attempt: found 1"),
        ({"exit_code": 4}, "exit_code: found 4"),
        ({"exit_code": 1}, "exit_code: found 1, expected 0 without reasons, another with some"),
        ({"reasons": ["no"]}, "exit_code: found 0, expected 0 without reasons, another with some"),
        ({"reasons": ["x"] * 1001, "exit_code": 1}, "reasons: found a list of 1001"),
        ({"seconds": -1}, "seconds: found -1"),
        ({"more": 1}, "unknown key 'more'"),
        ({"containers": []}, "containers: found [], expected ['sim', 'robot']"),
        ({"containers": containers(name="sim")}, "containers: found ['sim', 'sim']"),
        ({"containers": containers(end="flew away")}, "end: found 'flew away'"),
        ({"containers": containers(exit_code=256)}, "exit_code: found 256"),
        ({"containers": containers(signal="rm -rf")}, "signal: found 'rm -rf'"),
        ({"containers": containers(exit_code=1)}, "container 'robot' exited with exit code 1"),
        ({"containers": containers(end="lost")}, "container 'robot' lost with"),
        ({"containers": containers(end="stopped")}, "reported as passed, but no essential container ended"),
        ({"artifacts": artifact(path="../x")}, "artifact '../x' leaves its folder"),
        ({"artifacts": artifact(path="/x")}, "artifact '/x' leaves its folder"),
        ({"artifacts": artifact(path="d//b")}, "path: found 'd//b', expected a plain path"),
        ({"artifacts": artifact(path="a\0b")}, "has a name that some file systems do not allow"),
        ({"artifacts": artifact(path="\ud800")}, "has a name that some file systems do not allow"),
        ({"artifacts": artifact(path="d/a.csv")}, "'d/a.csv' occurs twice"),
        ({"artifacts": artifact(path="d")}, "'d' is a folder and a file"),
        ({"artifacts": artifact(container="x")}, "artifacts: there is no container 'x'"),
        ({"artifacts": artifact(size=41)}, "artifacts: found 101 bytes, at most 100 were expected"),
        ({"artifacts": artifact(sha256="0" * 63 + "g")}, "sha256: found '0"),
        ({"artifacts": artifact() * 2}, "artifacts: found "),
        ({"left_out": ["x"] * 4}, "left_out: found "),
    ],
)
def test_inconsistent_outcomes(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InfrastructureError) as caught:
        read({**json.loads(outcome_document(PASSED)), **changes})
    assert message in str(caught.value)
    assert str(caught.value).startswith("f: ")


def test_lines_command_nothing() -> None:
    """Neither in a terminal nor on the runner."""
    document = json.loads(outcome_document(FAILED))
    found = read({**document, "reasons": ["a\n::error::b\x1b[31m"]})
    assert found.reasons == ("a ::error::b\\x1b[31m",)


def test_documents_that_are_too_large() -> None:
    with pytest.raises(InfrastructureError, match=r"f: found .* bytes, at most .* were expected"):
        read_outcome(b" " * (max_outcome_bytes(JOB) + 1), JOB, 2, "f")


def test_many_reasons_are_cut_so_that_it_can_be_read() -> None:
    found = replace(FAILED, reasons=("x" * 9000,) * 2000)
    read_back = read_outcome(outcome_document(found), JOB, 2, "f")
    assert len(read_back.reasons) == 1000
    assert {len(reason) for reason in read_back.reasons} == {4096}


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)


@given(st.sampled_from(sorted(json.loads(outcome_document(PASSED)))), VALUES)
def test_whatever_a_field_is_it_is_refused_or_read(name: str, value: object) -> None:
    with suppress(CalibrationError):
        read({**json.loads(outcome_document(PASSED)), name: value})
