"""The commands plan-matrix and gather-results, as the workflow's jobs run them."""

import json
import time
from pathlib import Path

import jsonschema
import pytest

from calibration.__main__ import main, run_action
from calibration.ci.report.report import Brief, read_brief
from calibration.pipeline.report import write_results
from calibration.pipeline.results import SCHEMA_FILE, PipelineResults
from tests.pipeline.test_gathering import ONE, TWO, result

CONFIGURATION = """
noise: {translation: [0, 0.5], rotation: [0.3], seeds: 2}
systems: {robot: {dataset: robot}, arm: {dataset: arm}}
"""


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("GITHUB_ACTIONS", "GITHUB_OUTPUT", "GITHUB_STEP_SUMMARY"):
        monkeypatch.delenv(name, raising=False)


def outputs(path: Path) -> dict[str, str]:
    return dict(line.split("=", 1) for line in path.read_text().splitlines())


def plan(monkeypatch: pytest.MonkeyPatch, **inputs: str) -> dict[str, str]:
    """Run plan-matrix as the workflow does, and return its outputs."""
    file = Path("outputs")
    file.unlink(missing_ok=True)
    monkeypatch.setenv("GITHUB_OUTPUT", str(file))
    monkeypatch.setenv("INPUT_PLAN_FILE", "left/calibration~plan/plan.json")
    for name, value in inputs.items():
        monkeypatch.setenv(f"INPUT_{name.upper()}", value)
    assert run_action("plan-matrix") == 0
    return outputs(file)


def test_the_plan_of_a_configuration(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    Path("calibration.yml").write_text(CONFIGURATION)
    found = plan(monkeypatch, config="", translation_noise="", noise_inside_cells="false")
    assert list(json.loads(found["cells"])) == [
        f"{system}, {t} m, 0.3 rad" for system in ("robot", "arm") for t in ("0", "0.5")
    ]
    assert json.loads(Path("left/calibration~plan/plan.json").read_text())["seeds"] == [1, 2]
    out = capsys.readouterr().out
    assert "calibrate: yes" in out
    assert "  arm, 0.5 m, 0.3 rad" in out


def test_inputs_override_the_configuration(monkeypatch: pytest.MonkeyPatch) -> None:
    Path("calibration.yml").write_text(CONFIGURATION)
    found = plan(
        monkeypatch,
        noise_inside_cells="no",
        systems="arm",
        translation_noise="0.1, 0.1",
        rotation_noise="0",
        seed_list="7,3,7",
    )
    [cell] = json.loads(found["cells"]).values()
    assert (cell["system"], cell["translation-noise"], cell["rotation-noise"]) == ("arm", "0.1", "0")
    assert json.loads(Path("left/calibration~plan/plan.json").read_text())["seeds"] == [7, 3]


def test_datasets_in_the_place_of_a_configuration(monkeypatch: pytest.MonkeyPatch) -> None:
    found = plan(monkeypatch, datasets="data/robot\ndata/my arm", seeds="3")
    assert [(cell["dataset"], cell["slug"]) for cell in json.loads(found["cells"]).values()] == [
        ("data/robot", "robot_0m_0rad"),
        ("data/my arm", "myarm_0m_0rad"),
    ]


def test_unit_tests_need_no_configuration(monkeypatch: pytest.MonkeyPatch) -> None:
    found = plan(monkeypatch, tests="pytest -q")
    assert found["unit-tests"] == "true"
    assert found["calibrate"] == "false"
    Path("calibration.yml").write_text(CONFIGURATION)
    assert plan(monkeypatch)["calibrate"] == "true"
    assert plan(monkeypatch, jobs="unit-tests")["calibrate"] == "false"


def test_an_analysis_needs_no_configuration(monkeypatch: pytest.MonkeyPatch) -> None:
    found = plan(monkeypatch, analyse="true")
    assert (found["static-analysis"], found["calibrate"]) == ("true", "false")
    Path("calibration.yml").write_text(CONFIGURATION)
    assert plan(monkeypatch)["calibrate"] == "true"
    assert plan(monkeypatch, jobs="static-analysis")["calibrate"] == "false"


def test_a_section_analysis_is_a_job(monkeypatch: pytest.MonkeyPatch) -> None:
    Path("calibration.yml").write_text(CONFIGURATION)
    assert plan(monkeypatch)["static-analysis"] == "false"
    Path("calibration.yml").write_text(f"{CONFIGURATION}\nanalysis: {{}}\n")
    assert plan(monkeypatch)["static-analysis"] == "true"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "calibration.yml: a pipeline configuration (calibration init writes one) was expected"),
        (["--config", "a.yml", "--datasets", "b"], "config and datasets exclude each other"),
        (["--seeds", "2", "--seed-list", "1"], "seeds and seed-list exclude each other"),
        (["--datasets", "b", "--systems", "c"], "systems: there is no 'c' (known: b)"),
        (["--datasets", "b", "--jobs", "unit-tests"], "nothing for unit-tests to do"),
        (["--datasets", "b", "--translation-noise", "-1"], "'-1' is below 0"),
        (["--datasets", "b", "--minute-rate", "-0.1"], "'-0.1' is below 0"),
        (["--datasets", "b", "--minute-rate", "nan"], "'nan' is not a finite number"),
        (["--datasets", "b", "--minute-rate", "0,006"], "'0,006' is not a finite number"),
        (["--datasets", "b", "--minute-rate", "6e3"], "minute-rate: found 6000.0, expected"),
    ],
)
def test_what_cannot_be_planned_is_bad_input(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["plan-matrix", *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_names_of_systems_command_nothing(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    plan(monkeypatch, datasets="a/::set-output name=x::y")
    lines = capsys.readouterr().out.splitlines()
    [token] = [line.removeprefix("::stop-commands::") for line in lines if line.startswith("::stop-commands::")]
    [named] = [i for i, line in enumerate(lines) if "set-output" in line]
    assert lines.index(f"::stop-commands::{token}") < named < lines.index(f"::{token}::")


def gather(monkeypatch: pytest.MonkeyPatch, results: dict[str, str], planned: dict[str, str]) -> int:
    jobs = {"plan": {"result": "success", "seconds": planned.get("seconds")}}
    jobs |= {job: {"result": outcome, "seconds": None} for job, outcome in results.items()}
    inputs = {"NEEDS": json.dumps(jobs, indent=2), "FOLDER": "left", "OUTPUT": "of all"}
    for name, value in {**inputs, "PLAN_SHA256": planned["plan-sha256"]}.items():
        monkeypatch.setenv(f"INPUT_{name}", value)
    monkeypatch.setenv("GITHUB_OUTPUT", "gathered")
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", "summary.md")
    Path("summary.md").unlink(missing_ok=True)
    return run_action("gather-results")


@pytest.fixture
def planned(monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """Return the plan of two cells, of which both have left a result that passes."""
    inputs = {"translation_noise": "0.5,0", "rotation_noise": "0.3", "tests": "pytest", "minute_rate": "0.006"}
    inputs["noise_inside_cells"] = "no"
    found = plan(monkeypatch, datasets="robot", **inputs)
    for cell, job in zip(json.loads(found["cells"]).values(), (ONE, TWO), strict=True):
        write_results(PipelineResults((result(job),)), Path("left", f"calibration~{cell['slug']}"))
        Path("left", f"calibration~{cell['slug']}", "job-seconds.txt").write_text("61\n")
    return {**found, "seconds": "7"}


def ago(seconds: int) -> str:
    return str(int(time.time()) - seconds)


def test_one_table_and_one_verdict(
    planned: dict[str, str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert gather(monkeypatch, {"calibrate": "success", "unit-tests": "success"}, planned) == 0
    summary = Path("summary.md").read_text()
    assert summary.startswith("## Calibration: pass: 2 cells calibrated\n")
    assert "| calibrate | success | 2 | 122 | 4 | 0.024 |" in summary
    assert summary.count("| Start | robot |") == 1
    assert outputs(Path("gathered"))["verdict"] == "pass"
    assert json.loads(Path("of all/results.json").read_text())["cost"]["jobs"][0]["seconds"] == 7
    files = {"results.json", "cells.csv", "junit.xml", "summary.md", "badge.svg", "comment.json", "report.html"}
    assert {path.name for path in Path("of all").iterdir()} == files
    assert "calibration: pass" in Path("of all/badge.svg").read_text()
    assert capsys.readouterr().out.splitlines()[-1] == ("pass: 2 cells calibrated (of all/results.json)")


def test_what_other_jobs_say_in_brief_is_in_the_comment(
    planned: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = Path("left", "calibration~unit-tests")
    folder.mkdir(parents=True)
    brief = Brief(verdict="pass", sentence="90 % of the lines are run", lines=("12 tests passed, 0 failed",))
    (folder / "comment.json").write_text(brief.text)
    assert gather(monkeypatch, {"calibrate": "success", "unit-tests": "success"}, planned) == 0
    lines = read_brief(Path("of all/comment.json")).lines
    assert {"unit-tests: 90 % of the lines are run", "unit-tests: 12 tests passed, 0 failed"} <= set(lines)
    assert any("billed minutes" in line for line in lines)
    Path("left", "unit-tests", "comment.json").write_text("{")
    assert gather(monkeypatch, {"calibrate": "success", "unit-tests": "success"}, planned) == 0


def test_a_failed_job_beside_good_cells(
    planned: dict[str, str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    assert gather(monkeypatch, {"calibrate": "success", "unit-tests": "failure"}, planned) == 1
    assert outputs(Path("gathered"))["verdict"] == "fail"
    out, summary = capsys.readouterr().out, Path("summary.md").read_text()
    assert "::error title=Calibration::the job unit-tests failed: see its log" in out
    assert "| unit-tests | failure |" in summary
    assert summary.startswith("## Calibration: fail: 2 cells calibrated; ")  # the verdict is that of everything
    assert out.splitlines()[-1].startswith("fail: ")
    found = json.loads(Path("of all/results.json").read_text())
    assert (found["verdict"], found["reasons"]) == ("fail", ["the job unit-tests failed: see its log"])


def test_a_failed_job_gives_the_reasons_of_its_own_results(
    planned: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    reason = "lines that are run: found 50.0 % (1 of 2), expected at least 60 % (minimum)"
    Path("left", "calibration~unit-tests").mkdir(parents=True)
    Path("left", "calibration~unit-tests", "results.json").write_text(
        json.dumps({"schema": 1, "verdict": "fail", "reasons": [reason]})
    )
    assert gather(monkeypatch, {"calibrate": "success", "unit-tests": "failure"}, planned) == 1
    assert json.loads(Path("of all/results.json").read_text())["reasons"] == [f"unit-tests: {reason}"]


def test_results_of_an_earlier_run_do_not_stay(planned: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    assert gather(monkeypatch, {"calibrate": "success", "unit-tests": "success"}, planned) == 0
    monkeypatch.setenv("INPUT_NEEDS", json.dumps({"plan": {"result": "failure"}}))
    Path("gathered").unlink()
    assert run_action("gather-results") == 1
    found = json.loads(Path("of all", "results.json").read_text())
    assert (found["cells"], found["verdict"]) == ([], "fail")
    said = outputs(Path("gathered"))
    assert [said[name] for name in ("verdict", "success-rate", "billed-minutes", "cost")] == ["fail", "", "0", ""]


def test_what_the_run_costs(planned: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    """The plan 7 s, two cells 61 s each, the tests unknown, and this job since a minute and more."""
    monkeypatch.setenv("INPUT_BEGAN", ago(100))
    assert gather(monkeypatch, {"calibrate": "success", "unit-tests": "success"}, planned) == 0
    found = outputs(Path("gathered"))
    assert (found["billed-minutes"], found["cost"]) == ("7", "0.042")
    document = json.loads(Path("of all/results.json").read_text())
    jsonschema.validate(document, json.loads(SCHEMA_FILE.read_text()))
    assert document["cost"]["complete"] is False
    assert [job["billed_minutes"] for job in document["cost"]["jobs"]] == [1, 2, 2, None, 2]
    assert "| unit-tests | success | 1 | ? | ? | ? |" in Path("summary.md").read_text()


@pytest.mark.parametrize("began", ["", "soon", "-1", "9" * 5000, "99999999999", "1", "$(date)"])
def test_a_wrong_clock_is_not_red(began: str, planned: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("INPUT_BEGAN", began)
    assert gather(monkeypatch, {"calibrate": "success", "unit-tests": "success"}, planned) == 0
    assert "| verdict | this job | 1 | ? | ? | ? |" in Path("summary.md").read_text()


IMAGE = """
image: {name: ghcr.io/me/robot, base: debian, push: true, promote: [stable]}
noise: {translation: [0.5, 0], rotation: [0.3]}
systems: {robot: {dataset: robot, software: {command: calibrate}}}
"""


@pytest.mark.parametrize(("head", "pushes"), [("me/robot", "true"), ("stranger/robot", "false")])
def test_only_the_teams_own_change_pushes_its_image(head: str, pushes: str, monkeypatch: pytest.MonkeyPatch) -> None:
    Path("calibration.yml").write_text(IMAGE)
    Path("event.json").write_text(json.dumps({"pull_request": {"head": {"repo": {"full_name": head, "fork": True}}}}))
    variables = {"ACTIONS": "true", "EVENT_NAME": "pull_request", "EVENT_PATH": "event.json", "REPOSITORY": "me/robot"}
    for name, value in variables.items():
        monkeypatch.setenv(f"GITHUB_{name}", value)
    assert plan(monkeypatch)["push"] == pushes


@pytest.mark.parametrize("calibrates", ["success", "failure"])
def test_a_promotion_comes_after_a_verdict_that_is_pass(calibrates: str, monkeypatch: pytest.MonkeyPatch) -> None:
    Path("calibration.yml").write_text(IMAGE)
    found = plan(monkeypatch)
    assert found["promote"] == '["stable"]'
    for cell, job in zip(json.loads(found["cells"]).values(), (ONE, TWO), strict=True):
        write_results(PipelineResults((result(job),)), Path("left", f"calibration~{cell['slug']}"))
    code = gather(monkeypatch, {"image": "success", "calibrate-in-image": calibrates}, found)
    assert (code == 0) is ("| promote | to come |" in Path("summary.md").read_text()) is (calibrates == "success")


def test_needs_that_are_none_are_bad_input(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["gather-results", "--needs", "x", "--folder", "."]) == 2
    assert "needs: an object with every job" in capsys.readouterr().err


def test_results_that_the_unit_tests_have_forged_are_not_read(
    planned: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    slug = next(iter(json.loads(planned["cells"]).values()))["slug"]
    for path in ("", slug, f"calibration~{slug}"):
        write_results(PipelineResults((result(ONE, rms_px=0.0001),)), Path("left/calibration~unit-tests", path))
    assert gather(monkeypatch, {"calibrate": "success", "unit-tests": "success"}, planned) == 0
    assert [cell["rms_px"] for cell in json.loads(Path("of all/results.json").read_text())["cells"]] == [
        result(ONE).rms_px,
        result(TWO).rms_px,
    ]


def test_a_plan_that_another_job_has_replaced_is_refused(
    planned: dict[str, str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = Path("left/calibration~plan/plan.json")
    path.write_text(path.read_text().replace('"unit_tests":true', '"unit_tests":false'))
    assert gather(monkeypatch, {"calibrate": "success", "unit-tests": "failure"}, planned) == 2
    assert "another plan" in capsys.readouterr().err


def test_a_plan_that_is_the_only_artifact_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """Download-artifact makes no folder for a single one."""
    found = plan(monkeypatch, tests="pytest -q")
    Path("left/calibration~plan/plan.json").rename("left/plan.json")
    assert gather(monkeypatch, {"unit-tests": "success"}, found) == 0
    Path("left/plan.json").unlink()
    assert gather(monkeypatch, {"unit-tests": "success"}, found) == 2
