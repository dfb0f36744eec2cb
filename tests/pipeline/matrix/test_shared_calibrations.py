"""What follows from a calibration is made once for all cells that have the same one, and for no other."""

from dataclasses import replace
from pathlib import Path

import pytest

from calibration.engine.estimation.solve.options import Options
from calibration.engine.estimation.start.starting_noise import StartingNoise
from calibration.pipeline.matrix.cell import Cell
from calibration.pipeline.matrix.matrix import load
from calibration.pipeline.matrix.running_cell import run_cell
from tests.pipeline.conftest import T2RGB

NOISES = [StartingNoise(size, size, seed) for size, seed in ((0.0, 1), (0.1, 2), (0.3, 3))]


@pytest.mark.parametrize("start", ["linear", "given"])
def test_cells_together_leave_what_each_leaves_alone(start: str, tmp_path: Path) -> None:
    system = replace(T2RGB, options=Options(start=start))  # type: ignore[arg-type]
    together, many, iterations = load(system), set(), set()
    for noise in NOISES:
        cell = Cell("t2rgb", noise, system.options.start)
        found = [run_cell(cell, loaded, tmp_path / name) for name, loaded in (("a", together), ("b", load(system)))]
        many.add(id(together.finished.of(together.calibrator.calibrate(noise), pytest.fail)))
        assert replace(found[0], seconds=0) == replace(found[1], seconds=0)
        assert found[0].seed == noise.seed
        assert found[0].details is not None
        iterations.add(found[0].details.iterations)
        files = [{p.name: p.read_bytes() for p in (tmp_path / name / cell.folder).iterdir()} for name in ("a", "b")]
        assert files[0] == files[1]
        assert len(files[0]) == 2
    assert len(many) == 1
    assert len(iterations) == (1 if start == "linear" else 3)
