"""Execution target of containers in calibration.yml: this machine's engine or the cloud."""

from pathlib import Path

import pytest

from calibration.base import InputError
from calibration.pipeline.configuration import PipelineConfiguration, read_configuration

ROLE = "arn:aws:iam::123456789012:role/robots"
SECTION = (
    "aws-batch: {region: eu-west-1, queue: '${QUEUE}', bucket: team-robots, tools-image: t, "
    f"job-role: '{ROLE}', execution-role: '{ROLE}'}}\n"
)
SIMULATIONS = """
simulation:
  own: {system: s}
  theirs: {containers: {robot: {image: i, command: collect}}}
  here: {backend: docker, containers: {robot: {image: i, command: collect}}}
  there: {backend: aws-batch, containers: {robot: {image: i, command: collect}}}
"""
VARIABLES = {"QUEUE": "robots"}


def read(tmp_path: Path, text: str) -> PipelineConfiguration:
    path = tmp_path / "calibration.yml"
    path.write_text(text)
    return read_configuration(path, VARIABLES)


@pytest.mark.parametrize(("more", "default"), [("", "docker"), ("backend: aws-batch\n", "aws-batch")])
def test_each_has_its_place(tmp_path: Path, more: str, default: str) -> None:
    configuration = read(tmp_path, SECTION + more + SIMULATIONS)
    assert {each.name: each.backend for each in configuration.simulations} == {
        "own": "embedded",
        "theirs": default,
        "here": "docker",
        "there": "aws-batch",
    }
    target = configuration.target
    assert (target.backend, target.run, target.resume) == (default, None, False)
    assert target.sections.of("aws-batch") is not None
    assert target.sections.of("aws-batch").queue == "robots"


def test_the_default_is_this_machine(tmp_path: Path) -> None:
    target = read(tmp_path, "systems: {a: {dataset: d}}").target
    assert (target.backend, target.settings) == ("docker", None)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "backend: aws-batch\nsystems: {a: {dataset: d}}",
            "backend: found aws-batch, but there is no section aws-batch",
        ),
        (SIMULATIONS, "simulation.there.backend: found aws-batch, but there is no section aws-batch"),
        ("backend: embedded\nsystems: {a: {dataset: d}}", "backend: found 'embedded', expected docker or aws-batch"),
        (SECTION.replace("region", "reggion") + SIMULATIONS, "aws-batch: unknown key 'reggion': did you mean 'region'"),
        (SECTION.replace("QUEUE", "QUEU") + SIMULATIONS, "aws-batch.queue: the environment variable QUEU is not set"),
        (
            SECTION.replace("${QUEUE}", "a b") + SIMULATIONS,
            "aws-batch.queue: found 'a b', expected the name or the ARN",
        ),
        (
            "simulation: {a: {system: s, backend: aws-batch}}",
            "simulation.a.backend: found aws-batch; containers run with docker or aws-batch, and these need containers",
        ),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError) as raised:
        read(tmp_path, text)
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)
