"""The sweep: which matrices it runs, how its cells are judged, and what it leaves."""

from dataclasses import replace
from pathlib import Path

import pytest

from calibration.base import InfrastructureError, InputError
from calibration.base.tables.rules import parse_rules
from calibration.engine.diagnosis.limits import Limits
from calibration.pipeline.containers import SOFTWARE_METHOD, Software, software_from
from calibration.pipeline.convergence import sweep
from calibration.pipeline.convergence.sweep import run_sweep, sweep_matrices
from calibration.pipeline.matrix.cell_result import OUR_METHOD, CellResult
from calibration.pipeline.matrix.matrix import Matrix
from calibration.pipeline.system import NoiseGrid, System
from tests.pipeline.conftest import T2RGB

from .cells import cell

ROOMY = replace(T2RGB, limits=Limits(rms_px=100.0))


def software(image: str = "robot:1") -> Software:
    return software_from({"image": image, "command": "calibrate {start} {output}"}, Path(), "software")


def matrix(system: System = T2RGB, noise: NoiseGrid | None = None) -> Matrix:
    return Matrix((system,), noise or NoiseGrid((0.0,), (0.0, 1.0), (1,)))


def rules(maximum: float) -> System:
    entry = {"rules": [{"column": "RMS (pix)", "row": "Averages", "max": maximum}]}
    return replace(T2RGB, rules=parse_rules(entry, "rules"))


def test_software_starts_from_the_guess_and_other_methods_are_left_out() -> None:
    system = replace(T2RGB, software=software(), compare=("shah",))
    given, linear = sweep_matrices(matrix(system), ("given", "linear"))
    assert (given.systems[0].options.start, list(given.software), given.comparisons) == ("given", ["t2rgb"], [])
    assert (linear.systems[0].options.start, linear.software, linear.comparisons) == ("linear", {}, [])


def test_software_needs_a_given_start_and_an_image() -> None:
    with pytest.raises(InputError, match="the software of t2rgb starts from the guess: add given"):
        sweep_matrices(matrix(replace(T2RGB, software=software())), ("linear",))
    bare = replace(software(), container=replace(software().container, image=""))
    with pytest.raises(InputError, match=r"systems\.t2rgb\.software: missing image"):
        sweep_matrices(matrix(replace(T2RGB, software=bare)), ("given",))


def test_a_given_start_is_lost_where_the_linear_one_is_not_and_no_file_is_left(tmp_path: Path) -> None:
    seen: list[tuple[int, int, str | None]] = []

    def done(number: int, total: int, found: CellResult) -> None:
        seen.append((number, total, found.start))
        assert not [
            path for path in tmp_path.rglob("*") if path.suffix in (".csv", ".pcd", ".jpg")
        ]  # thousands of cells

    matrices = sweep_matrices(matrix(), ("given", "linear"))
    cells = run_sweep(matrices, tmp_path, jobs=1, done=done)
    assert [(c.start, c.rotation_noise, c.verdict) for c in cells] == [
        ("given", 0.0, "pass"),
        ("given", 1.0, "fail"),
        ("linear", 0.0, "pass"),
        ("linear", 1.0, "pass"),
    ]
    assert cells[1].reasons
    assert seen == [(1, 4, "given"), (2, 4, "given"), (3, 4, "linear"), (4, 4, "linear")]
    assert list(tmp_path.iterdir()) == []


def test_an_interrupted_sweep_continues_unless_its_options_change(tmp_path: Path) -> None:
    def interrupt(number: int, _total: int, _found: CellResult) -> None:
        if number == 3:
            raise KeyboardInterrupt

    matrices = sweep_matrices(matrix(), ("given", "linear"))
    with pytest.raises(KeyboardInterrupt):
        run_sweep(matrices, tmp_path / "out", jobs=1, done=interrupt)
    at_once = run_sweep(matrices, tmp_path / "fresh", jobs=1)
    seen: list[CellResult] = []
    found = run_sweep(matrices, tmp_path / "out", jobs=1, done=lambda *step: seen.append(step[2]))
    assert [replace(cell, seconds=0) for cell in found] == [replace(cell, seconds=0) for cell in at_once]
    assert found[:3] == seen[:3]  # with the times of the first run
    assert list((tmp_path / "out").iterdir()) == []

    with pytest.raises(KeyboardInterrupt):
        run_sweep(matrices, tmp_path / "out", jobs=1, done=interrupt)
    strict = sweep_matrices(matrix(replace(T2RGB, limits=Limits(translation_mm=1e-6))), ("given", "linear"))
    assert {cell.verdict for cell in run_sweep(strict, tmp_path / "out", jobs=1)} == {"fail"}


def test_rules_and_limits_of_the_system_decide(tmp_path: Path) -> None:
    one = NoiseGrid()
    for system, verdict in (
        (rules(100.0), "pass"),
        (rules(1e-6), "fail"),
        (ROOMY, "pass"),
        (replace(T2RGB, limits=Limits(translation_mm=1e-6)), "fail"),
    ):
        [found] = run_sweep(sweep_matrices(matrix(system, one), ("linear",)), tmp_path, jobs=1)
        assert found.verdict == verdict
    assert "translation error" in found.reasons[0]


def test_a_rule_that_does_not_fit_the_table_is_an_error_and_leaves_nothing(tmp_path: Path) -> None:
    wrong = replace(T2RGB, rules=parse_rules({"rules": [{"column": "RMS (px)", "max": 1}]}, "rules"))
    with pytest.raises(InputError, match="RMS"):
        run_sweep(sweep_matrices(matrix(wrong), ("linear",)), tmp_path, jobs=1)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_made_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InfrastructureError, match="cannot be written"):
        run_sweep(sweep_matrices(matrix(), ("linear",)), tmp_path / "file", jobs=1)


def same(cells: list[CellResult], system: System) -> list[str]:
    return [c.verdict for c in sweep._of_the_same_optimum(cells, [replace(system, name="arm")])]


def test_without_rules_and_limits_the_rms_is_that_of_the_best_start() -> None:
    cells = [cell(0, 0, rms_px=0.5), cell(1, 0, rms_px=0.505), cell(2, 0, rms_px=0.52), cell(2, 1, converged=False)]
    assert same(cells, T2RGB) == ["pass", "pass", "fail", "fail"]
    assert same(cells, ROOMY) == ["pass", "pass", "pass", "fail"]
    assert same(cells, rules(1.0)) == ["pass", "pass", "pass", "fail"]


def test_the_best_is_of_the_same_method_and_of_what_converged() -> None:
    theirs = [cell(t, 0, rms_px=rms, method=SOFTWARE_METHOD) for t, rms in ((0, 0.9), (1, 1.8))]
    ours = [cell(0, 0, rms_px=0.1, method=OUR_METHOD)]
    assert same(theirs + ours, T2RGB) == ["pass", "fail", "pass"]
    better = replace(cell(0, 0, converged=False), rms_px=0.01)
    assert same([better, cell(1, 0, rms_px=0.5)], T2RGB) == ["fail", "pass"]


def test_a_perfect_fit_leaves_room_for_the_last_digit() -> None:
    assert same([cell(0, 0, rms_px=0.0), cell(1, 0, rms_px=0.0001)], T2RGB) == ["pass", "pass"]


def test_what_nothing_judges_does_not_pass() -> None:
    cells = [cell(0, 0, rms_px=None, method=SOFTWARE_METHOD)]
    [found] = sweep._of_the_same_optimum(cells, [replace(T2RGB, name="arm")])
    assert found.verdict == "fail"
    assert "no criterion for convergence" in found.reasons[0]
    held_against_our_optimum = replace(cells[0], dataset="dataset.json")
    assert same([held_against_our_optimum], T2RGB) == ["pass"]
