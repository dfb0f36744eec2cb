"""The matrix: every cell once, the same whatever the order and the number of processes."""

import json
import math
import os
import signal
from dataclasses import replace
from pathlib import Path

import pytest

from calibration.base import ExitCode, InfrastructureError, InputError
from calibration.base.tables.rules import parse_rules
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.calibrate import Prepared, solve
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.engine.evaluation.table import Table
from calibration.engine.geometry.transforms import from_xyz_rpy
from calibration.pipeline.matrix import running_cell
from calibration.pipeline.matrix.cell_result import CellResult
from calibration.pipeline.matrix.loaded_system import LoadedSystem, check_rules, load
from calibration.pipeline.matrix.matrix import Matrix, run_matrix
from calibration.pipeline.report import write_results
from calibration.pipeline.results import PipelineResults
from calibration.pipeline.system import NoiseGrid, System
from tests.pipeline.conftest import DATASETS, RIWBOT, T2RGB


def files(folder: Path) -> dict[str, bytes]:
    """Every file below a folder; the times, which differ from run to run, taken out of the results."""
    found = {}
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        data = path.read_bytes()
        if path.name == "results.json":
            document = json.loads(data)
            for entry in document["cells"] + document["comparisons"]:
                entry["seconds"] = 0
            data = json.dumps(document).encode()
        if path.name == "comment.json":  # its last line has the time
            data = b"".join(line for line in data.splitlines(True) if b'"Time: ' not in line)
        if path.name != "junit.xml":
            found[str(path.relative_to(folder))] = data
    return found


def test_every_combination_is_a_cell_in_the_order_of_the_matrix(matrix: Matrix) -> None:
    cells = matrix.cells

    assert len(cells) == len(set(map(str, cells))) == len({cell.folder for cell in cells}) == 8
    assert [cell.system for cell in cells] == ["t2rgb"] * 4 + ["riwbot"] * 4


def test_the_same_bytes_with_any_number_of_processes(matrix: Matrix, tmp_path: Path) -> None:
    written = []
    for jobs in (1, 3):
        output = tmp_path / str(jobs)
        found = run_matrix(matrix, output, jobs)
        write_results(PipelineResults(found.cells, found.comparisons), output)
        written.append(files(output))

    assert len(written[0]) == 8 * 3 + 5
    assert written[0] == written[1]


def test_all_starts_lead_to_the_same_result(matrix: Matrix, tmp_path: Path) -> None:
    found = run_matrix(matrix, tmp_path, 2)

    assert all(cell.verdict == "pass" and cell.converged for cell in found.cells)
    for system in ("t2rgb", "riwbot"):
        cells = [cell for cell in found.cells if cell.system == system]
        assert len({cell.rms_px for cell in cells}) == 1
        truths = [cell.truth.translation_mm for cell in cells if cell.truth]
        assert len(truths) == 4
        assert max(truths) - min(truths) < 1e-3
        assert max(truths) < 1


def test_no_cell_is_lost_however_many_there_are(tmp_path: Path) -> None:
    matrix = Matrix((RIWBOT,), NoiseGrid((0.0,), (0.0,), tuple(range(30))))

    found = run_matrix(matrix, tmp_path, 2)

    assert [cell.seed for cell in found.cells] == list(range(30))


@pytest.mark.parametrize(
    ("rule", "system", "message"),
    [
        (
            {"column": "RMS", "max": 3},
            T2RGB,
            "t2rgb, rules for rgb-to-rgb:right_camera:left_camera: there is no column",
        ),
        ({"column": "RMS (pix)", "row": "Average", "max": 3}, T2RGB, "did you mean 'Averages'"),
        ({"column": "RMS (pix)", "row": "Averages", "max-increase": "10%"}, T2RGB, "there is no baseline"),
        (
            {"column": "X err (pix)", "max": 3},
            replace(RIWBOT, evaluate=None),
            "riwbot, rules for the reprojection errors: there is no column",
        ),
    ],
)
def test_rules_that_do_not_match_the_table_are_refused_before_the_first_cell(
    rule: dict[str, object], system: System, message: str, tmp_path: Path
) -> None:
    asked = replace(system, rules=parse_rules([rule], "calibration.yml"))
    with pytest.raises(InputError, match=message):
        run_matrix(Matrix((asked,), NoiseGrid()), tmp_path, 1)
    assert list(tmp_path.iterdir()) == []


def test_rules_may_name_rows_that_a_bad_guess_leaves_out() -> None:
    """Turned round, the camera sees nothing, so that its table has fewer rows, or none, before it is calibrated."""
    system = load(T2RGB)
    edge = system.dataset.sensors["right_camera"].edge
    turned = system.dataset.transforms[edge] @ from_xyz_rpy((0, 0, 0), (0, math.pi, 0))
    away = replace(system, dataset=system.dataset.with_transforms({edge: turned}))
    row = parse_rules([{"column": "RMS (pix)", "row": "004", "max": 3}], "calibration.yml")
    check_rules(row, away)
    check_rules(row, system)
    with pytest.raises(InputError, match="has no row '999'"):
        check_rules(parse_rules([{"column": "RMS (pix)", "row": "999", "max": 3}], "calibration.yml"), system)


def test_what_a_cell_leaves_reads_back(matrix: Matrix, tmp_path: Path) -> None:
    cell = run_matrix(matrix, tmp_path, 1).cells[0]

    assert cell.table is not None
    assert cell.dataset is not None
    assert (tmp_path / cell.table).read_text().splitlines()[-1].startswith(f"Averages,{cell.rms_px:.4f}")
    calibrated = read_dataset(tmp_path / cell.dataset)
    assert calibrated.version == "3.0"
    assert calibrated.keys == read_dataset(DATASETS / "t2rgb").keys


def test_other_methods_are_in_the_results(tmp_path: Path) -> None:
    found = run_matrix(Matrix((replace(RIWBOT, compare=("shah", "li")),), NoiseGrid()), tmp_path, 2)

    assert [c.method for c in found.comparisons] == ["shah", "li"]
    ours = found.cells[0].rms_px
    assert ours is not None
    assert all(c.rms_px is not None and ours < c.rms_px < 10 * ours for c in found.comparisons)


def test_a_method_that_depends_on_the_start_is_compared_from_every_start(matrix: Matrix) -> None:
    systems = tuple(replace(system, compare=("icp", "shah")) for system in matrix.systems)
    jobs = replace(matrix, systems=systems).comparisons

    starts = [cell.noise for cell in matrix.cells if cell.system == "t2rgb"]
    assert [(job.method, job.noise) for job in jobs if job.system == "t2rgb"] == [
        *(("icp", start) for start in starts),
        ("shah", None),
    ]
    assert len(jobs) == len({job.folder for job in jobs}) == 2 * (4 + 1)
    assert not {job.folder for job in jobs} & {cell.folder for cell in matrix.cells}


def test_a_method_that_does_not_apply_has_a_reason(tmp_path: Path) -> None:
    found = run_matrix(Matrix((replace(T2RGB, compare=("shah",)),), NoiseGrid()), tmp_path, 1)

    (comparison,) = found.comparisons
    assert comparison.error == ExitCode.BAD_INPUT
    assert "pattern" in comparison.reasons[0]
    assert found.cells[0].verdict == "pass"


def test_a_cell_that_fails_does_not_stop_the_others_unless_asked(
    matrix: Matrix, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing_from_far(prepared: Prepared, noise: StartingNoise) -> Calibration:
        if noise.translation > 0:
            raise InputError("planted")
        return solve(prepared, noise)

    monkeypatch.setattr(running_cell, "solve", failing_from_far)
    monkeypatch.setattr(LoadedSystem, "conventions", ())  # which would look for a cause in the data

    everything = run_matrix(matrix, tmp_path, 1)
    first_only = run_matrix(matrix, tmp_path, 1, fail_fast=True)

    assert [cell.verdict for cell in everything.cells] == ["pass", "pass", "fail", "fail"] * 2
    assert [cell.verdict for cell in first_only.cells] == ["pass", "pass", "fail"]
    assert everything.cells[2].reasons == ("planted",)
    assert PipelineResults(everything.cells).exit_code == ExitCode.BAD_INPUT


def test_each_job_is_reported_once(matrix: Matrix, tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []

    def done(count: int, total: int, _: CellResult) -> None:
        seen.append((count, total))

    run_matrix(matrix, tmp_path, 2, done=done)

    assert seen == [(i, 8) for i in range(1, 9)]


def test_a_dead_worker_is_reported(matrix: Matrix, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(running_cell, "solve", lambda *_: os.kill(os.getpid(), signal.SIGKILL))

    with pytest.raises(InfrastructureError, match="worker process died"):
        run_matrix(matrix, tmp_path, 2)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"dataset": DATASETS / "no_such"}, "no_such"),
        ({"evaluate": "rgb-to-rgb:right_camera:left_cam"}, "did you mean 'left_camera'"),
        ({"evaluate": "rgb-to-rgb"}, "rgb-to-rgb"),
        ({"truth": "no_such.json"}, "no_such.json"),
        ({"compare": ("sha",)}, "did you mean 'shah'"),
    ],
)
def test_bad_input_stops_before_anything_is_calibrated(
    tmp_path: Path, changes: dict[str, object], expected: str
) -> None:
    with pytest.raises(InputError, match=expected):
        run_matrix(Matrix((replace(T2RGB, **changes),), NoiseGrid()), tmp_path / "output", 1)  # type: ignore[arg-type]

    assert not (tmp_path / "output").exists()


def test_a_system_without_a_problem_leaves_the_reason_to_its_cells(matrix: Matrix) -> None:
    system = load(matrix.systems[0])
    everything = tuple(system.dataset.sensors)
    held = replace(system, options=replace(system.options, hold=everything))
    result, calibration = running_cell.calibrate_cell(matrix.cells[0], held)
    assert calibration is None
    assert "nothing to calibrate" in result.reasons[0]


def test_a_table_without_a_finite_rms_is_red(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a lens model has no inverse the points of a corner are no numbers; the corners' own RMS is finite."""
    real = running_cell.table_of

    def without_numbers(*arguments: object) -> Table | None:
        table = real(*arguments)  # type: ignore[arg-type]
        return table and replace(table, values=math.nan * table.values)

    monkeypatch.setattr(running_cell, "table_of", without_numbers)
    [cell] = run_matrix(Matrix((RIWBOT,), NoiseGrid()), tmp_path, 1).cells
    [red] = [each for each in cell.findings if each.severity == "red"]
    assert (cell.verdict, red.kind) == ("fail", "table")
