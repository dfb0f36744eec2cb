"""Repeated runs: of our engine equal to the last bit; flaky, cut short, and refused ones."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

from calibration.__main__ import main
from calibration.base import CalibrationError, ExitCode, InfrastructureError
from calibration.ci.report import Outcome
from calibration.ci.workflow import Runner
from calibration.pipeline.matrix.matrix import Matrix, judge_results, run_matrix
from calibration.pipeline.repetition.repetition import MaxSpread, Repetition, Repetitions, poses_of_run
from calibration.pipeline.repetition.running import repeat_stages, repeated
from calibration.pipeline.results import PipelineResults
from calibration.pipeline.running import PipelineRun
from calibration.pipeline.system import NoiseGrid
from tests.actions.write_inputs import schema_file
from tests.pipeline.conftest import RIWBOT
from tests.pipeline.test_promotion import SPECIFICATION

ARM = f"systems: {{arm: {{dataset: {RIWBOT.dataset.resolve()}}}}}\n"


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "calibration.yml").write_text(ARM)
    return tmp_path


def results_in(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "results.json").read_text())
    jsonschema.validate(found, json.loads(schema_file("repeated-results").read_text()))
    return found


def failing_in(*numbers: int) -> Callable[..., PipelineResults]:
    """Return a judge that fails the cells of these runs."""
    calls = 0

    def judge(results: PipelineResults, *rest: Any) -> PipelineResults:
        nonlocal calls
        calls += 1
        judged = judge_results(results, *rest)
        return judged.with_each_cell(lambda cell: cell.failing("a race") if calls in numbers else cell)

    return judge


def test_our_engine_is_equal_to_the_last_bit_in_all_runs(
    repository: Path, small: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    limits = "limits: {translation-mm: 50, rotation-deg: 5}"
    simulation = f"{{system: {small}, motion: generate:4, minimum-collections: 3, {limits}}}"
    (repository / "calibration.yml").write_text(f"{ARM}simulation: {{fresh: {simulation}}}\nrepeat: 2\n")
    assert main(["run"]) == 0

    found = results_in(repository / "output")
    assert (found["spreads"], found["differences"], found["failures"], found["reasons"]) == ([], [], [], [])
    first, second = found["runs"]
    assert first["outputs"] == second["outputs"]
    assert all(first["outputs"][stage] for stage in ("collect", "calibrate", "introspect"))
    assert found["equal"] > 5
    assert [each["name"] for each in found["times"]] == ["collect", "calibrate", "introspect", "whole run"]
    for name in ("run-1", "run-2"):
        assert json.loads((repository / "output" / name / "results.json").read_text())["cells"]
        assert f'href="{name}/report.html"' in (repository / "output" / "report.html").read_text()
    assert re.search(r"^standard deviation .*\d", capsys.readouterr().out, re.MULTILINE)


@pytest.mark.parametrize(
    ("options", "code"), [([], 1), (["--max-flake-rate", "0.3"], 1), (["--max-flake-rate", "0.34"], 0)]
)
def test_a_flaky_cell_is_red_unless_its_rate_is_allowed(
    repository: Path, monkeypatch: pytest.MonkeyPatch, options: list[str], code: int
) -> None:
    monkeypatch.setattr("calibration.pipeline.stages.judge_results", failing_in(2))
    assert main(["calibrate-matrix", "--config", "calibration.yml", "--repeat", "3", *options]) == code

    found = results_in(repository / "output")
    [failure] = found["failures"]
    assert (failure["rate"]["failed"], failure["rate"]["runs"], failure["runs"]) == (1, 3, [2])
    assert [(each["runs"], each["stage"]) for each in found["differences"]] == [([2], "introspect")]
    assert len(found["reasons"]) == code
    assert (repository / "output" / "run-2" / "results.json").exists()


def test_a_cell_that_always_fails_is_not_flaky(repository: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("calibration.pipeline.stages.judge_results", failing_in(1, 2))
    assert main(["run", "--repeat", "2", "--max-flake-rate", "1"]) == 1
    assert "failed in each of 2 runs: a race" in results_in(repository / "output")["reasons"][0]


@pytest.mark.parametrize(("failing", "count"), [((), 1), ((2,), 0)])
def test_what_follows_from_the_verdict_is_done_once_after_a_pass_of_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing: tuple[int, ...], count: int
) -> None:
    promoted: list[Path] = []

    def promote(run: PipelineRun) -> PipelineRun:
        promoted.append(run.output)
        return run

    monkeypatch.setattr("calibration.pipeline.stages.promote_stage", promote)
    monkeypatch.setattr("calibration.pipeline.stages.judge_results", failing_in(*failing))
    run = PipelineRun(Matrix((RIWBOT,), NoiseGrid()), tmp_path, Runner(), image=SPECIFICATION)
    code, _ = repeat_stages(run, ("calibrate", "introspect", "promote"), Repetitions(repeat=2))
    assert (code, promoted) == (0 if count else 1, [tmp_path / "run-2"] * count)


def test_transforms_of_software_are_those_of_its_dataset(tmp_path: Path) -> None:
    found = run_matrix(Matrix((RIWBOT,), NoiseGrid()), tmp_path, 1)
    of_engine = poses_of_run(PipelineResults(found.cells), tmp_path, {})
    without_details = tuple(replace(cell, details=None) for cell in found.cells)
    of_software = poses_of_run(PipelineResults(without_details), tmp_path, found.datasets)
    shared = of_engine.keys() & of_software.keys()
    assert shared
    for name in shared:
        np.testing.assert_allclose(of_engine[name], of_software[name], atol=1e-9)


def test_a_collection_is_repeated(repository: Path, small: Path) -> None:
    asked = ["collect-data-sim", "--system", str(small), "--motion", "generate:3", "--repeat", "2"]
    loose = ["--max-translation-mm", "50", "--max-rotation-deg", "5", "--minimum-collections", "3"]
    assert main([*asked, *loose, "--output", "out"]) == 0
    found = results_in(repository / "out")
    assert found["differences"] == []
    assert found["runs"][0]["outputs"]["collect"]
    assert (repository / "out" / "run-2" / "dataset.json").exists()
    assert main([*asked, *loose, "--output", "out"]) == 2  # the datasets are kept, as a single one is
    assert (repository / "out" / "run-1" / "results.json").exists()


@pytest.mark.parametrize("number", ["0", "-1", "1001", "1000000000", "2.5", "x"])
def test_a_number_of_runs_out_of_bounds_is_bad_input(
    repository: Path, capsys: pytest.CaptureFixture[str], number: str
) -> None:
    assert main(["run", "--repeat", number]) == 2
    assert number in capsys.readouterr().err
    (repository / "calibration.yml").write_text(f"{ARM}repeat: {number}\n")
    assert main(["run"]) == 2
    assert "calibration.yml: repeat: found" in capsys.readouterr().err
    assert not (repository / "output").exists()


def test_bad_input_leaves_nothing(repository: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (repository / "calibration.yml").write_text("systems: {arm: {dataset: nowhere}}\n")
    assert main(["run", "--repeat", "3"]) == 2
    assert "nowhere" in capsys.readouterr().err
    assert not (repository / "output").exists()


def test_scenarios_and_the_workflow_are_not_repeated(
    repository: Path, small: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (repository / "calibration.yml").write_text(f"{ARM}repeat: 2\n")
    assert main(["plan-matrix", "--config", "calibration.yml"]) == 2
    assert "repeat: found 2" in capsys.readouterr().err
    scenarios = ["--scenario-set", "set.yml", "--scenarios", "2", "--output", "out"]
    assert main(["collect-data-sim", "--system", str(small), *scenarios, "--repeat", "2"]) == 2
    assert "repeat:" in capsys.readouterr().err


GOOD = Repetition(folder=Path(), verdict="pass", sentence="well", outcomes=(Outcome(name="arm"),))


def once(*ends: BaseException | None, **content: Any) -> Callable[[Path], Repetition]:
    """Return work that ends so in its first runs."""
    left = list(ends)

    def run(folder: Path) -> Repetition:
        folder.mkdir(parents=True)
        if left and (error := left.pop(0)) is not None:
            raise error
        return replace(GOOD, folder=folder, **content)

    return run


class BuildFailedError(CalibrationError):
    exit_code = ExitCode.FAIL


@pytest.mark.parametrize(
    ("end", "why"),
    [
        (KeyboardInterrupt(), "it was stopped"),
        (InfrastructureError("no space left"), "no space left"),
        (OSError(28, "No space left on device"), "No space left on device"),
    ],
)
def test_what_ends_a_run_leaves_the_runs_before_it(tmp_path: Path, end: BaseException, why: str) -> None:
    with pytest.raises(type(end)):
        repeated(Repetitions(repeat=5), tmp_path, Runner(), "title", once(None, None, end))
    found = results_in(tmp_path)
    assert [run["cut_short"] for run in found["runs"]] == [None, None, why]
    assert found["verdict"] == "fail"
    assert found["reasons"][:2] == [f"run 3 was cut short: {why}", "2 of 5 runs were not made"]
    assert [each["runs"] for each in found["times"]] == [2]


def test_a_disk_that_is_full_for_the_report_too_raises_the_first_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise InfrastructureError("the report cannot be written")

    monkeypatch.setattr("calibration.ci.report.report.write_atomically", full)
    with pytest.raises(InfrastructureError, match="the disk is full"):
        repeated(
            Repetitions(repeat=2), tmp_path, Runner(), "title", once(None, InfrastructureError("the disk is full"))
        )


def test_a_step_that_fails_in_one_run_is_flaky_and_the_others_follow(tmp_path: Path) -> None:
    found, report = repeated(
        Repetitions(repeat=3), tmp_path, Runner(), "title", once(None, BuildFailedError("apt: 404"))
    )
    assert [run.cut_short for run in found.runs] == [None, "apt: 404", None]
    assert (found.exit_code, report.exit_code) == (ExitCode.FAIL, ExitCode.FAIL)
    assert found.failures[0].runs == (2,)


def test_fewer_runs_leave_no_results_of_more(tmp_path: Path) -> None:
    for runs in (3, 2):
        for number in range(1, runs + 1):
            (tmp_path / f"run-{number}").mkdir(exist_ok=True)
        repeated(Repetitions(repeat=runs), tmp_path, Runner(), "title", lambda folder: replace(GOOD, folder=folder))
        (tmp_path / "run-3" / "results.json").touch()
    repeated(Repetitions(repeat=2), tmp_path, Runner(), "title", lambda folder: replace(GOOD, folder=folder))
    assert not (tmp_path / "run-3" / "results.json").exists()


@pytest.mark.parametrize(
    ("limit", "passes", "verdict"), [(0.1, False, "fail"), (0.8, False, "undecided"), (0.8, True, "undecided")]
)
def test_a_spread_has_a_verdict_as_other_limits(tmp_path: Path, limit: float, passes: bool, verdict: str) -> None:
    values = iter((1.0, 2.0))

    def run(folder: Path) -> Repetition:
        return replace(GOOD, folder=folder, numbers={("arm: RMS", "px"): next(values)})

    settings = Repetitions(repeat=2, max_spread=MaxSpread(rms_px=limit))
    found, report = repeated(settings, tmp_path, Runner(), "title", run, passes)
    assert found.verdict == report.verdict == verdict
    assert found.exit_code == (0 if passes else 1)


def test_a_spread_of_what_no_run_has_is_undecided(tmp_path: Path) -> None:
    settings = Repetitions(repeat=2, max_spread=MaxSpread(rms_px=1))
    found, _ = repeated(settings, tmp_path, Runner(), "title", once())
    assert (found.verdict, found.exit_code, found.unjudged) == ("undecided", ExitCode.FAIL, ("px",))


def test_a_fail_without_a_reason_of_its_own_counts(tmp_path: Path) -> None:
    found, _ = repeated(
        Repetitions(repeat=2),
        tmp_path,
        Runner(),
        "title",
        once(verdict="fail", outcomes=(), error=ExitCode.INFRASTRUCTURE),
    )
    assert (found.verdict, found.exit_code) == ("fail", ExitCode.INFRASTRUCTURE)
