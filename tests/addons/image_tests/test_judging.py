"""Runs of tests judged by the files that they leave, without an engine."""

import hashlib
from dataclasses import replace
from pathlib import Path

import pytest

from calibration.addons.image_tests.results import RUN_CASE, JudgedRun, TestsOfEntry, judge_run, results_of_entry
from calibration.addons.image_tests.settings import ImageTests
from calibration.base import ExitCode
from calibration.ci.execution.job import Container
from calibration.ci.execution.outcome import ArtifactFile, ContainerOutcome, End, JobOutcome
from calibration.ci.report.junit import RepeatedFailure, repeated_failures

GREEN = '<testsuite name="s"><testcase classname="c" name="one" time="0.5"/><testcase name="two"/></testsuite>'
RED = '<testsuite><testcase name="one"><failure message="off by one"/></testcase><testcase name="two"/></testsuite>'
SKIPPED = '<testsuite><testcase name="one"><skipped/></testcase></testsuite>'
CTEST = """<Site><Testing>
<Test Status="passed"><Name>odometry</Name></Test>
<Test Status="failed"><Name>arm</Name><Results>
 <NamedMeasurement type="text/string" name="Exit Code"><Value>SEGFAULT</Value></NamedMeasurement>
 <NamedMeasurement type="text/string" name="Exit Value"><Value>0</Value></NamedMeasurement>
 <Measurement><Value>moving\nstill moving\n</Value></Measurement></Results></Test>
<Test Status="notrun"><Name>off</Name><Results>
 <NamedMeasurement type="text/string" name="Completion Status"><Value>Disabled</Value></NamedMeasurement>
</Results></Test></Testing></Site>"""


def judged(
    folder: Path,
    files: dict[str, str],
    reasons: tuple[str, ...] = (),
    code: ExitCode = ExitCode.PASS,
    end: End = End.EXITED,
    tests: ImageTests | None = None,
) -> JudgedRun:
    artifacts = []
    for name, text in files.items():
        path = folder / "artifacts" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        artifacts.append(ArtifactFile(name, "tests", len(text), hashlib.sha256(text.encode()).hexdigest()))
    log = folder / "logs" / "tests.log"
    log.parent.mkdir(parents=True, exist_ok=True)
    log.write_text("".join(f"line {number}\n" for number in range(100)))
    container = ContainerOutcome("tests", end, 0, log=log)
    outcome = JobOutcome("t", folder, (container,), tuple(artifacts), (), reasons, code, 2.5)
    return judge_run(tests or ImageTests("t"), outcome)


def failing_tests(runs: list[list[JudgedRun]]) -> tuple[RepeatedFailure, ...]:
    return repeated_failures([attempt.cases for attempt in run] for run in runs)


def entry(runs: list[list[JudgedRun]], folder: Path, **settings: float) -> TestsOfEntry:
    return results_of_entry(ImageTests("t", **settings), runs, failing_tests(runs), folder)  # type: ignore[arg-type]


def test_reports_of_several_tools_are_counted_together(tmp_path: Path) -> None:
    run = judged(tmp_path, {"reports/a.xml": GREEN, "reports/Test.xml": CTEST})
    assert (run.tally.passed, run.tally.failed, run.tally.skipped) == (3, 1, 1)
    [failure] = run.tally.failures
    assert (failure.name, failure.message) == ("arm", "SEGFAULT: still moving")
    assert not run.passes


def test_a_green_run_passes(tmp_path: Path) -> None:
    run = judged(tmp_path, {"reports/a.xml": GREEN})
    assert run.passes
    assert entry([[run]], tmp_path).verdict == "pass"


def test_a_failed_test_is_the_reason_and_not_the_exit_code(tmp_path: Path) -> None:
    run = judged(tmp_path, {"reports/a.xml": RED}, ("container 'tests' ended with exit code 1",), ExitCode.FAIL)
    assert entry([[run]], tmp_path).reasons == ["t: one failed: off by one"]


@pytest.mark.parametrize("files", [{}, {"reports/a.xml": SKIPPED}, {"reports/a.xml": "<testsuites/>"}])
def test_no_test_is_red_unless_allowed(tmp_path: Path, files: dict[str, str]) -> None:
    run = judged(tmp_path, files)
    assert not run.passes
    assert run.cases[-1].name == RUN_CASE
    assert "no test ran" in run.cases[-1].message
    assert run.last_lines[-1] == "line 99"
    assert judged(tmp_path, files, tests=ImageTests("t", allow_no_tests=True)).passes


@pytest.mark.parametrize("end", [End.SIGNALLED, End.OUT_OF_MEMORY, End.TIMED_OUT])
def test_a_process_that_crashes_or_hangs_is_red_with_its_last_lines(tmp_path: Path, end: End) -> None:
    code = ExitCode.INFRASTRUCTURE if end == End.TIMED_OUT else ExitCode.FAIL
    run = judged(tmp_path, {"reports/a.xml": GREEN}, ("container 'tests' was killed by SIGSEGV",), code, end)
    found = entry([[run]], tmp_path)
    assert (found.verdict, found.error) == ("fail", None)
    assert found.reasons == ["t failed: container 'tests' was killed by SIGSEGV"]
    assert len(found.runs[0].last_lines) == 20


def test_a_lost_engine_is_no_verdict_on_the_tests(tmp_path: Path) -> None:
    run = judged(tmp_path, {}, ("the engine does not answer",), ExitCode.INFRASTRUCTURE, End.LOST)
    assert entry([[run]], tmp_path).error == ExitCode.INFRASTRUCTURE


ENTITIES = '<!DOCTYPE a [<!ENTITY b "c">]><testsuite><testcase name="&b;"/></testsuite>'


@pytest.mark.parametrize(("text", "what"), [("", "no valid XML"), (ENTITIES, "entities"), ("<html/>", "<html>")])
def test_a_bad_report_beside_a_good_one_is_red_and_named(tmp_path: Path, text: str, what: str) -> None:
    run = judged(tmp_path, {"reports/good.xml": GREEN, "reports/sub/bad.xml": text})
    message = run.cases[-1].message
    assert message.startswith("reports/sub/bad.xml: ")
    assert what in message.replace("not valid", "no valid")
    assert str(tmp_path) not in message


def test_coverage_is_no_report_of_tests(tmp_path: Path) -> None:
    cobertura = '<?xml version="1.0"?><coverage line-rate="1"/>'
    run = judged(tmp_path, {"reports/a.xml": GREEN, "coverage/a/coverage.xml": cobertura, "coverage/gcov.json": "{}"})
    assert run.passes
    assert [path.name for path in run.coverage] == ["coverage.xml", "gcov.json"]


def test_a_test_that_has_the_name_of_the_run_is_another(tmp_path: Path) -> None:
    run = judged(tmp_path, {"reports/a.xml": f'<testsuite><testcase name="{RUN_CASE}"/></testsuite>'})
    assert [case.name for case in run.cases] == [f"{RUN_CASE} in a report", RUN_CASE]


def test_a_test_that_fails_sometimes_is_flaky_with_its_rate(tmp_path: Path) -> None:
    green, red = (
        judged(tmp_path, {"reports/a.xml": GREEN}),
        judged(tmp_path, {"reports/a.xml": RED.replace("one", "two")}),
    )
    runs = [[red], [green], [green], [green]]
    found = entry(runs, tmp_path)
    [flake] = found.failures
    assert (flake.name, flake.rate.failed, flake.rate.runs, flake.runs, flake.flaky) == ("two", 1, 4, (1,), True)
    assert found.reasons == ["t: two is flaky, failed 1 of 4: between 0.63 and 81 % of runs at 95 %: off by two"]
    assert entry(runs, tmp_path, max_flake_rate=0.25).verdict == "pass"
    assert entry(runs, tmp_path, max_flake_rate=0.2).verdict == "fail"


def test_a_retry_that_passes_is_a_flake_and_passes(tmp_path: Path) -> None:
    green, red = (
        judged(tmp_path, {"reports/a.xml": GREEN}),
        judged(tmp_path, {"reports/a.xml": RED.replace("one", "two")}),
    )
    found = entry([[red, green]], tmp_path)
    assert found.verdict == "pass"
    assert [test.name for test in found.tolerated] == ["two"]
    assert found.runs[0].retries == 1
    assert entry([[red, red]], tmp_path).reasons == ["t: two failed in each of 2 runs: off by two"]


def test_a_run_that_crashes_without_output_is_no_tolerated_flake(tmp_path: Path) -> None:
    crashed = judged(tmp_path, {"reports/a.xml": GREEN}, ("it was killed by SIGSEGV",), ExitCode.FAIL, End.SIGNALLED)
    silent, green = replace(crashed, last_lines=()), judged(tmp_path, {"reports/a.xml": GREEN})
    found = entry([[silent], [green]], tmp_path)
    assert found.verdict == "fail"
    [reason] = found.reasons
    assert reason.startswith("t is flaky, failed 1 of 2: ")


def test_a_crash_is_not_hidden_by_a_flaky_test(tmp_path: Path) -> None:
    run = judged(tmp_path, {"reports/a.xml": RED}, ("it was killed by SIGSEGV",), ExitCode.FAIL, End.SIGNALLED)
    assert [case.name for case in run.cases if case.state == "failed"] == ["one", RUN_CASE]


def test_a_test_that_always_fails_is_named_before_flakes(tmp_path: Path) -> None:
    both = '<testsuite><testcase name="a"><error/></testcase><testcase name="b"><error/></testcase></testsuite>'
    runs = [[judged(tmp_path, {"reports/a.xml": text})] for text in (both, both.replace('"a"', '"c"'))]
    assert [test.name for test in failing_tests(runs)] == ["a", "b", "c"]  # each failed whenever it ran


def test_a_command_and_a_tool_exclude_each_other() -> None:
    from calibration.base import InputError
    from calibration.base.records import read

    with pytest.raises(InputError, match="arguments"):
        read(ImageTests, {"command": "make test", "arguments": ["-v"]}, "tests.t", name="t")
    with pytest.raises(InputError, match="reports"):
        read(ImageTests, {"reports": ["/a/*.xml"]}, "tests.t", name="t")


def test_a_job_keeps_what_its_command_leaves() -> None:
    tests = ImageTests("t", reports=("{output}/x/*.xml",), container=Container(image="i", command=("run", "{output}")))
    [container] = tests.job("t").containers
    assert container.command == ("run", "/calibration/output")
    assert [(each.path, each.required) for each in container.artifacts] == [("/calibration/output/x/*.xml", False)]
