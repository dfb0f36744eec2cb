"""A convention is the first reason of a cell, with or without a result, and of init; copies count once."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.base import InputError
from calibration.engine.estimation.options import Options
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.pipeline.first_configuration import first_configuration
from calibration.pipeline.matrix.cell_result import Cell, CellResult
from calibration.pipeline.matrix.loaded_system import load
from calibration.pipeline.matrix.running_cell import run_cell
from calibration.pipeline.system import Copies, System
from tests.pipeline.conftest import DATASETS
from tests.thorough import thorough

DOOR = Path("door") / "real"


@pytest.fixture
def door(shared_data: Path) -> Path:
    folder = shared_data / DOOR
    if not folder.is_dir():
        pytest.skip(f"no {DOOR} of public recordings")
    return folder


def ran(folder: Path, output: Path, **keys: Any) -> CellResult:
    system = System("robot", folder, options=Options(description="rough"), **keys)
    return run_cell(Cell("robot", StartingNoise()), load(system), output)


def test_a_result_that_fits_nothing_has_the_convention_as_its_only_reason(door: Path, tmp_path: Path) -> None:
    cell = ran(door / "02-green-mistakes" / "B4-euler-as-rotvec" / "data" / "robot", tmp_path)
    assert [(f.kind, f.severity) for f in cell.findings] == [("convention", "red")]
    [reason] = cell.reasons
    assert "Euler angles about the fixed axes x, y, z" in reason
    assert "0.58 px" in reason


def test_data_without_a_result_have_it_too_and_their_error_is_a_note(door: Path, tmp_path: Path) -> None:
    cell = ran(door / "09-pairs-inverse" / "data" / "robot", tmp_path)
    [reason] = cell.reasons
    assert reason.startswith("with the pattern's poses inverted")
    assert not cell.converged
    assert [(f.kind, f.severity) for f in cell.findings] == [("convention", "red"), ("engine", "note")]


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize(
    ("recording", "named"),
    [
        ("09-pairs-inverse", "the pattern's poses inverted"),
        ("23-stereo-no-minimum/shifted", "taken from 1 collection"),
        thorough("23-stereo-no-minimum/mirrored", "the images of 'right' mirrored back"),
    ],
)
def test_init_names_the_convention_of_what_cannot_be_calibrated(
    door: Path, tmp_path: Path, recording: str, named: str
) -> None:
    folder = tmp_path / "robot"
    folder.mkdir()
    (folder / "dataset.json").write_bytes((door / recording / "data" / "robot" / "dataset.json").read_bytes())
    with pytest.raises(InputError, match="cannot be calibrated: with ") as error:
        first_configuration(folder, tmp_path)
    assert named in str(error.value)
    assert "other way round (" not in str(error.value)


def with_copies(folder: Path) -> Path:
    """t2rgb with its collections 003 and 007 twice."""
    document = json.loads((DATASETS / "t2rgb" / "dataset.json").read_text())
    keys = list(document["collections"])
    for i, key in enumerate(("003", "007")):
        document["collections"][f"{len(keys) + i:03}"] = document["collections"][key]
    folder.mkdir()
    (folder / "dataset.json").write_text(json.dumps(document))
    return folder


@pytest.mark.parametrize("datasets", ["full", "changes", "none"])
def test_copies_are_left_out_and_change_nothing(tmp_path: Path, datasets: Any) -> None:
    folder = with_copies(tmp_path / "copied")
    cell = ran(folder, tmp_path / "output", evaluate="rgb-to-rgb:left_camera:right_camera", datasets=datasets)
    [warning] = [each for each in cell.findings if each.kind == "copies"]
    assert warning.collections == ("026", "027")
    assert warning.text in cell.warnings
    plain = ran(DATASETS / "t2rgb", tmp_path / "plain", evaluate="rgb-to-rgb:left_camera:right_camera")
    assert cell.rms_px == plain.rms_px
    assert cell.verdict == plain.verdict
    assert cell.details is not None
    assert plain.details is not None
    for one, other in zip(cell.details.transforms, plain.details.transforms, strict=True):
        assert np.allclose(one.trans, other.trans, atol=1e-12)


def test_copies_are_refused_where_asked(tmp_path: Path) -> None:
    refuse: Copies = "refuse"
    with pytest.raises(InputError, match=r"026 = 003, 027 = 007.*copies: leave-out"):
        load(System("robot", with_copies(tmp_path / "copied"), copies=refuse))
