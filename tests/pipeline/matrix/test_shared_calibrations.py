"""What follows from a calibration is made once for all cells that have the same one, and for no other."""

from dataclasses import replace
from pathlib import Path

import pytest

from calibration.engine.diagnosis.diagnose import diagnose
from calibration.engine.estimation.options import Options
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.pipeline.matrix import running_cell
from calibration.pipeline.matrix.cell_result import Cell
from calibration.pipeline.matrix.loaded_system import load
from calibration.pipeline.matrix.running_cell import run_cell
from tests.pipeline.conftest import T2RGB

NOISES = [StartingNoise(size, size, seed) for size, seed in ((0.0, 1), (0.1, 2), (0.3, 3))]


@pytest.mark.parametrize("start", ["linear", "given"])
def test_cells_together_leave_what_each_leaves_alone(
    start: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    system = replace(T2RGB, options=Options(start=start))  # type: ignore[arg-type]
    cells = [Cell("t2rgb", noise, system.options.start) for noise in NOISES]
    diagnosed: list[object] = []
    monkeypatch.setattr(running_cell, "diagnose", lambda *given: diagnosed.append(given) or diagnose(*given))  # type: ignore[func-returns-value]
    shared = load(system)
    together = [run_cell(cell, shared, tmp_path / "a") for cell in cells]
    assert len(diagnosed) == 1
    alone = [run_cell(cell, load(system), tmp_path / "b") for cell in cells]
    assert len(diagnosed) == 1 + len(cells)
    iterations = set()
    for cell, found, expected in zip(cells, together, alone, strict=True):
        assert replace(found, seconds=0) == replace(expected, seconds=0)
        assert found.seed == cell.noise.seed
        assert found.details is not None
        iterations.add(found.details.iterations)
        files = [{p.name: p.read_bytes() for p in (tmp_path / name / cell.folder).iterdir()} for name in ("a", "b")]
        assert files[0] == files[1]
        assert len(files[0]) == 2
    assert len(iterations) == (1 if start == "linear" else 3)
