"""The stage test as a job of the reusable workflow: planned by calibration.yml, and gathered into its verdict."""

from dataclasses import replace
from pathlib import Path

import pytest

from calibration.addons.image_tests import results
from calibration.addons.requirements.results import JudgedMessages
from calibration.base import ExitCode, InputError
from calibration.pipeline.configuration import read_configuration
from calibration.pipeline.gathering import Cost, Needs, gather, report_of_run
from calibration.pipeline.report import write_results
from calibration.pipeline.results import PipelineResults, StageResults
from calibration.pipeline.system import NoiseGrid
from calibration.pipeline.workflow_plan import JobInputs, WorkflowPlan, plan_jobs

JOB = "test-image"
PLAN = WorkflowPlan(stages=(JOB,))
NEEDS = Needs({"plan": "success", JOB: "success"})
GREEN = results.Tested(passed=3, failed=0, folder="tests")
RED = replace(GREEN, failed=1, reasons=("tests: own: Robot.test_still: found 1 of 2",))
TESTS = "tests: {own: {command: [run], image: robot}}\n"
REQUIREMENTS = "requirements: {bag: drive.bag, nodes: [/robot]}\n"
IMAGE = "image: {name: ghcr.io/me/robot, base: debian, push: true, promote: [stable]}\n"


def planned(folder: Path, text: str, *jobs: str) -> WorkflowPlan:
    path = folder / "calibration.yml"
    path.write_text(f"systems: {{robot: {{dataset: robot}}}}\n{text}")
    configuration = read_configuration(path)
    return plan_jobs(configuration, configuration.systems, NoiseGrid(), JobInputs(jobs=jobs), by_path=False)


def test_a_stage_of_calibration_yml_is_a_job(tmp_path: Path) -> None:
    both = planned(tmp_path, TESTS + REQUIREMENTS)
    assert [job for job, runs in both.jobs.items() if runs] == ["calibrate", JOB, "check-messages"]
    assert (both.tests_in_image, both.image) == (False, False)
    built = planned(tmp_path, TESTS + IMAGE)
    assert (built.tests_in_image, built.image, built.promote) == (True, True, ("stable",))
    judged = planned(tmp_path, TESTS + REQUIREMENTS + IMAGE, "check-messages")
    assert (judged.stages, judged.tests_in_image, judged.image) == (("check-messages",), False, False)
    with pytest.raises(InputError, match="nothing for test-image to do: the configuration has no section tests"):
        planned(tmp_path, REQUIREMENTS, JOB)


def test_what_the_tests_found_is_in_the_verdict_of_the_run(tmp_path: Path) -> None:
    for found, code in ((GREEN, ExitCode.PASS), (RED, ExitCode.FAIL)):
        write_results(PipelineResults(of_stages=StageResults(tests=found)), tmp_path / JOB)
        outcome = "success" if found is GREEN else "failure"
        gathered = gather(replace(NEEDS, results={"plan": "success", JOB: outcome}), PLAN, tmp_path)
        report = report_of_run(gathered, Cost(()), tmp_path / "output")
        assert (report.exit_code, report.reasons) == (code, found.reasons)
        assert found.sentence in report.sentence
        assert f"Tests in the image: {JOB}/tests/summary.md" in report.markdown()
        assert gathered.results.of_stages.all == (replace(found, folder=f"{JOB}/tests"),)


def test_tests_that_leave_no_result_are_red_and_what_they_say_of_other_stages_does_not_count(tmp_path: Path) -> None:
    judged = JudgedMessages(requirements=1, not_met=0, folder="requirements")
    write_results(PipelineResults(of_stages=StageResults(requirements=judged)), tmp_path / JOB)
    gathered = gather(NEEDS, PLAN, tmp_path)
    assert gathered.results.of_stages.all == ()
    assert gathered.problems == ("the job test-image left no result: see its log",)
    assert gathered.exit_code == ExitCode.FAIL
