"""Conversion of whole Rigelfiles of every generation, compared with expected files.

After a change that is meant to be: WRITE_GOLDEN=1 pytest tests/addons/rigel/test_golden.py, and read the difference.
"""

import os
from pathlib import Path

import pytest
import yaml

from calibration.addons.rigel.conversion import convert, written
from calibration.addons.rigel.document import read_rigelfile
from calibration.ci.execution.backends import SECTIONS
from calibration.ci.image.specification import parse_image_specification
from calibration.pipeline.configuration import read_configuration

FOLDER = Path(__file__).with_name("rigelfiles")
NAMES = ["matrix", "older", "robomaker", "simulation-job"]
VARIABLES = {"LAB_USER": "lab", "API_TOKEN": "x", "DISPLAY": ":1", "TOKEN": "x", "ECR": "a.example.org"}


def conversion_of(name: str) -> str:
    return written(convert(read_rigelfile(FOLDER / f"{name}.rigel")), f"{name}.rigel")


@pytest.mark.parametrize("name", NAMES)
def test_what_a_rigelfile_becomes(name: str) -> None:
    text = conversion_of(name)
    golden = FOLDER / f"{name}.calibration.yml"
    if os.environ.get("WRITE_GOLDEN"):
        golden.write_text(text)
    assert text == golden.read_text()
    assert "pl4nted" not in text.lower()


@pytest.mark.parametrize("name", NAMES)
def test_our_own_reader_takes_it(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the variables set, the files there, and a system where there is none."""
    for variable, value in VARIABLES.items():
        monkeypatch.setenv(variable, value)
    if name in ("robomaker", "simulation-job") and "aws-batch" not in SECTIONS:
        pytest.skip("needs the add-on aws_batch")
    document = yaml.safe_load(conversion_of(name))
    document.setdefault("systems", {"robot": {"dataset": "TODO"}})
    for system in document["systems"].values():
        system.get("software", {}).pop("mounts", None)  # of folders that are not on this machine
    for simulation in document.get("simulation", {}).values():
        for mount in {m for container in simulation["containers"].values() for m in container.get("mounts", ())}:
            (tmp_path / mount.split(":")[0]).mkdir(parents=True)
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / ".rosinstall").write_text("- git: {uri: 'https://example.org/a.git', local-name: a}\n")
    path = tmp_path / "calibration.yml"
    path.write_text(yaml.safe_dump(document))
    configuration = read_configuration(path)
    assert configuration.systems
    assert "image" not in document or parse_image_specification(document["image"], tmp_path, "image").name
    assert (configuration.sections.of("aws-batch") is not None) == (name in ("robomaker", "simulation-job"))
    assert all(
        each.backend == "aws-batch" for each in configuration.simulations if configuration.sections.of("aws-batch")
    )
    if name == "matrix":
        assert configuration.noise.translations == configuration.noise.rotations == (0.0, 0.5)
        assert {system.name for system in configuration.systems} == {"calibrate_stereo", "calibrate_lidar"}
