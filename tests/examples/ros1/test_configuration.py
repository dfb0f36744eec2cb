"""What the example says of itself fits together."""

import os
from pathlib import Path

import defusedxml.ElementTree
import pytest

from calibration.ci.image.specification import Recipe
from calibration.pipeline.configuration import PipelineConfiguration, read_configuration
from tests.examples.ros1.conftest import EXAMPLE


@pytest.fixture(scope="module")
def configuration() -> PipelineConfiguration:
    return read_configuration(EXAMPLE / "calibration.yml", {"REGISTRY": "127.0.0.1:5000"})


@pytest.fixture(scope="module")
def recipe(configuration: PipelineConfiguration) -> Recipe:
    assert configuration.image is not None
    assert isinstance(configuration.image.source, Recipe)
    return configuration.image.source


def test_the_pipeline_reads_it(configuration: PipelineConfiguration) -> None:
    assert configuration.image is not None
    assert (configuration.image.name, configuration.image.promote) == ("127.0.0.1:5000/ros1-example", ("stable",))
    [system] = configuration.systems
    assert system.collected == "ros1-collected"
    assert system.software is not None
    [simulation] = configuration.simulations
    assert simulation.name == system.collected


def test_what_is_copied_is_there(recipe: Recipe) -> None:
    for file in recipe.files:
        assert file.source.exists(), file.source


@pytest.mark.parametrize("name", ["robot", "simulation"])
def test_the_packages_are_found_by_their_names_and_have_what_they_need(recipe: Recipe, name: str) -> None:
    package = defusedxml.ElementTree.parse(EXAMPLE / name / "package.xml").getroot()
    [target] = [file.target for file in recipe.files if file.source.resolve() == EXAMPLE / name]
    assert target == f"/opt/{package.findtext('name')}"
    for needed in package.findall("exec_depend"):
        assert f"python3-{needed.text}".replace("_", "-") in recipe.apt


@pytest.mark.parametrize("launch", sorted(EXAMPLE.glob("*/*.launch")), ids=lambda path: path.name)
def test_a_launch_file_starts_a_program_that_is_there(launch: Path) -> None:
    [node] = defusedxml.ElementTree.parse(launch).getroot().findall("node")
    assert node.get("pkg") == f"example_{launch.parent.name}"
    program = launch.parent / str(node.get("type"))
    assert os.access(program, os.X_OK)
    assert program.read_text().startswith("#!/usr/bin/env python3\n")
    assert node.get("required") == "true"  # else roslaunch stays when it has died
