"""Rules and limits: a failure is red, and names the value and its limit."""

from dataclasses import replace
from pathlib import Path

import pytest

from calibration.base import ExitCode, InputError
from calibration.base.tables.rules import parse_rules
from calibration.engine.diagnosis.limits import Limits
from calibration.pipeline.matrix.cell_result import CellResult, Deviation
from calibration.pipeline.matrix.matrix import judge_cells, judge_results
from calibration.pipeline.results import PipelineResults
from calibration.pipeline.system import System

TABLE = "Collection #,RMS (pix)\n000,0.5000\n001,0.7000\nAverages,0.6000\n"
CELL = CellResult(
    system="robot",
    method="calibration-ci",
    translation_noise=0.5,
    rotation_noise=0.0,
    seed=1,
    start="linear",
    loss="huber",
    converged=True,
    rms_px=0.6,
    table="robot/table.csv",
    dataset=None,
    truth=Deviation(0.5, 0.02),
    seconds=0.0,
)


@pytest.fixture
def output(tmp_path: Path) -> Path:
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / "table.csv").write_text(TABLE)
    return tmp_path


def judged(cell: CellResult, output: Path, rules: object = None, **limits: float) -> CellResult:
    rule_set = parse_rules(rules, "calibration.yml") if rules else None
    system = System("robot", Path("robot"), rules=rule_set, limits=Limits(**limits))
    return judge_cells([cell], [system], output)[0]


def test_within_rules_and_limits_it_passes(output: Path) -> None:
    rules = [{"column": "RMS (pix)", "row": "Averages", "max": 0.6}]

    assert judged(CELL, output, rules, rms_px=0.6, translation_mm=0.5, rotation_deg=0.02).verdict == "pass"
    assert judged(CELL, output).verdict == "pass"


def test_every_reason_is_listed(output: Path) -> None:
    rules = [{"column": "RMS (pix)", "row": "Averages", "max": 0.5, "every-max": 0.65}]

    cell = judged(CELL, output, rules, rms_px=0.5, translation_mm=0.4, rotation_deg=0.01)

    assert cell.verdict == "fail"
    assert len(cell.reasons) == 5
    assert "found 0.5 mm, expected at most 0.4 mm" in cell.reasons[1]


@pytest.mark.parametrize("value", [None, float("nan"), float("inf")])
def test_a_value_that_is_missing_or_not_finite_never_passes(output: Path, value: float | None) -> None:
    assert judged(replace(CELL, rms_px=value), output, rms_px=1).verdict == "fail"
    if value is not None:  # without a truth what moves a sensor is judged where it is found
        truth = Deviation(value, value)
        assert len(judged(replace(CELL, truth=truth), output, translation_mm=1, rotation_deg=1).reasons) == 2


def test_without_a_table_rules_fail(output: Path) -> None:
    cell = judged(replace(CELL, table=None), output, [{"column": "RMS (pix)", "max": 1}])

    assert cell.reasons == ("there is no table to judge",)


def test_an_unconverged_cell_stays_red_whatever_its_table(output: Path) -> None:
    cell = replace(CELL, converged=False, reasons=("a false minimum",))

    assert judged(cell, output, [{"column": "RMS (pix)", "max": 1}]).reasons == ("a false minimum",)
    assert judged(cell, output, [{"column": "RMS (pix)", "max": 1}]).verdict == "fail"


def test_an_error_keeps_its_exit_code(output: Path) -> None:
    cell = replace(CELL, converged=False, reasons=("no labels",), error=ExitCode.BAD_INPUT, table=None)

    assert judged(cell, output, [{"column": "RMS (pix)", "max": 1}]) == cell


def test_a_rule_that_names_no_column_of_the_table_is_bad_input(output: Path) -> None:
    with pytest.raises(InputError, match="RMS"):
        judged(CELL, output, [{"column": "RMSE", "max": 1}])


def test_joints_have_limits_of_their_own(output: Path) -> None:
    cell = replace(CELL, truth=Deviation(0.5, 0.02, joint_mm=0.03, joint_deg=0.004))

    assert judged(cell, output, joint_mm=0.03, joint_deg=0.004).verdict == "pass"
    assert judged(cell, output, joint_mm=0.02, joint_deg=0.003).reasons == (
        "joint translation error against the truth: found 0.03 mm, expected at most 0.02 mm",
        "joint rotation error against the truth: found 0.004 deg, expected at most 0.003 deg",
    )
    assert judged(CELL, output, joint_mm=1).reasons == (
        "joint translation error against the truth: found no value, expected at most 1 mm",
    )


def test_only_cells_of_the_given_systems_are_judged_again_and_no_other_method(output: Path) -> None:
    """Whatever was judged before."""
    before = replace(CELL, reasons=("judged before",))
    other, icp = replace(before, system="other"), replace(before, method="icp")
    system = System("robot", Path("robot"), limits=Limits(rms_px=0.5))

    found = judge_results(PipelineResults((before, other), (before, icp, other)), [system], output)

    assert len(found.cells[0].reasons) == 1
    assert "expected at most 0.5" in found.cells[0].reasons[0]
    assert found.cells[1] == other
    assert found.comparisons == (found.cells[0], icp, other)
