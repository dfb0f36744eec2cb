"""The JSON Schema of scenario sets, for editors, against what reads them."""

import json
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml

from calibration.base import InputError
from calibration.robot.simulation.scenarios import scenario_set
from tests.robot.simulation.conftest import DATASETS
from tests.robot.simulation.scenarios.conftest import ReadSet

SCHEMA: dict[str, Any] = json.loads(Path(scenario_set.__file__).with_name("scenario_set.schema.json").read_text())
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)


def test_it_is_a_schema_of_the_set_that_ships() -> None:
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    VALIDATOR.validate(yaml.safe_load((DATASETS / "scenarios.yml").read_text()))


@pytest.mark.parametrize(
    "text",
    [
        "light: {ambient: {uniform: [0, 1]}, intensity: 0.5}",
        "light: {elevation_deg: {normal: [45, 10], within: [20, 80]}, azimuth_deg: {choice: [0, 90]}}",
        "occluders: {count: {choice: [0, 3]}, size_m: {log_uniform: [0.1, 1]}}",
        "sensors: {left_camera: {exposure: 2, translation_mm: 1}}",
        "constraints: [{parameter: scene.clearance_m, min: 1}, {less: [scene.clearance_m, scene.clearance_m]}]",
    ],
)
def test_both_accept_valid_documents(read_set: ReadSet, text: str) -> None:
    read_set(text)
    VALIDATOR.validate(yaml.safe_load(text))


@pytest.mark.parametrize(
    "text",
    [
        "lihgt: {}",
        "light: 1",
        "light: {ambient: much}",
        "light: {ambient: {uniform: [0]}}",
        "light: {ambient: {uniform: [0, 1], within: [0, 1]}}",
        "light: {ambient: {uniform: [0, 1], normal: [0, 1]}}",
        "light: {ambient: {log_uniform: [0, 1]}}",
        "light: {ambient: {choice: []}}",
        "light: {azimuth_deg: 3}",
        "occluders: {count: 1.5, size_m: 1}",
        "occluders: {count: 1}",
        "motion: {poses: {uniform: [1, 9]}}",
        "constraints: {}",
        "constraints: [{less: [scene.clearance_m]}]",
        "constraints: [{less: [scene.clearance_m, scene.clearance_m], min: 1}]",
    ],
)
def test_both_refuse_what_is_wrong(read_set: ReadSet, text: str) -> None:
    with pytest.raises(InputError):
        read_set(text)
    assert not VALIDATOR.is_valid(yaml.safe_load(text))
