"""What follows from a calibration is made once for all cells that have the same one, and for no other."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.dataset.reading import read_dataset
from calibration.errors import InputError
from calibration.estimation.calibrate import calibrate
from calibration.estimation.options import Options
from calibration.estimation.starting_noise import StartingNoise
from calibration.pipeline.matrix.cell import Cell
from calibration.pipeline.matrix.latest import Latest, same
from calibration.pipeline.matrix.matrix import load
from calibration.pipeline.matrix.running_cell import run_cell
from tests.pipeline.conftest import DATASETS, T2RGB

NOISES = [StartingNoise(0.1, 0.1, seed) for seed in (1, 2, 3)]


def test_starts_that_the_data_make_lead_to_the_same_calibration_to_the_last_bit() -> None:
    dataset = read_dataset(DATASETS / "t2rgb")
    one, other = (calibrate(dataset, Options(), noise) for noise in NOISES[:2])
    assert same(one, other)
    assert not same(one, calibrate(dataset, Options(loss="linear"), NOISES[0]))
    values = one.solution.values
    moved = (np.nextafter(values[0], 9.0), *values[1:])
    assert not same(one, replace(one, solution=replace(one.solution, values=moved)))
    assert not same(one, replace(one, notes=("something was held",)))


def test_it_is_made_again_for_another_calibration_other_options_and_after_an_error() -> None:
    dataset, made, latest = read_dataset(DATASETS / "t2rgb"), [], Latest[int]()

    def make() -> int:
        made.append(1)
        return len(made)

    def fail() -> int:
        raise InputError("planted")

    one, other = (calibrate(dataset, Options(loss=loss)) for loss in ("huber", "linear"))
    with pytest.raises(InputError):
        latest.of(one, Options(), fail)
    assert [latest.of(one, Options(), make), latest.of(calibrate(dataset), Options(), make)] == [1, 1]
    assert latest.of(one, Options(start="given"), make) == 2
    assert latest.of(other, Options(start="given"), make) == 3
    assert latest.of(one, Options(), make) == 4


@pytest.mark.parametrize("start", ["linear", "given"])
def test_cells_together_leave_what_each_leaves_alone(start: str, tmp_path: Path) -> None:
    together = load(T2RGB)
    for noise in NOISES:
        cell = Cell("t2rgb", noise, start)  # type: ignore[arg-type]
        found = [run_cell(cell, system, tmp_path / name) for name, system in (("a", together), ("b", load(T2RGB)))]
        assert replace(found[0], seconds=0) == replace(found[1], seconds=0)
        assert found[0].seed == noise.seed
        files = [{p.name: p.read_bytes() for p in (tmp_path / name / cell.folder).iterdir()} for name in ("a", "b")]
        assert files[0] == files[1]
        assert len(files[0]) == 2
