"""Settings and verdict of the tests, without running any."""

import json
from contextlib import closing
from pathlib import Path

import coverage
import pytest

from calibration.addons.coverage.coverage_py import (
    _option_of_team,
    bring_coverage,
    measuring,
    plain,
    team_settings,
    write_settings,
)
from calibration.addons.coverage.tests import (
    LOST_PROCESS,
    Measurement,
    Tests,
    _Unittest,
    measured_environment,
    measurement,
)
from calibration.base import InputError
from calibration.ci.report.junit import Tally

from .projects import TOKEN


@pytest.fixture(autouse=True)
def _no_measurement_around(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("COVERAGE_RCFILE", raising=False)


@pytest.mark.parametrize(
    ("file", "text"),
    [
        (".coveragerc", "[run]\nomit = gen/*\n  */vendor/*\nplugins = robot_plugin\n[report]\nexclude_also = \n  {}\n"),
        ("setup.cfg", "[coverage:run]\nomit = gen/*\n  */vendor/*\n[coverage:report]\nexclude_also = \n  {}\n"),
        ("pyproject.toml", "[tool.coverage]\nrun.omit=['gen/*', '*/vendor/*']\nreport.exclude_also=['{}']\n"),
    ],
)
def test_the_teams_settings_are_read_wherever_they_are(tmp_path: Path, file: str, text: str) -> None:
    (tmp_path / file).write_text(text.format("if ROBOT"))
    settings = team_settings(tmp_path)
    assert settings["run:omit"] == [str(tmp_path / "gen/*"), "*/vendor/*"]
    assert "if ROBOT" in settings["report:exclude_lines"]
    assert any("pragma" in expression for expression in settings["report:exclude_lines"])
    assert "report:exclude_also" not in settings


def test_without_settings_there_is_only_what_is_usual(tmp_path: Path) -> None:
    assert set(team_settings(tmp_path)) == {"report:exclude_lines", "report:partial_branches"}


def test_settings_of_a_plugin(tmp_path: Path) -> None:
    (tmp_path / ".coveragerc").write_text("[run]\nplugins = a.b\n[a.b]\nkey = value\n")
    settings = team_settings(tmp_path)
    assert (settings["run:plugins"], settings["a.b:key"]) == (["a.b"], "value")


@pytest.mark.parametrize("text", ["[run]\nbranch = perhaps\n", "[report]\nexclude_lines = (\n", "[run\n"])
def test_settings_that_are_none(tmp_path: Path, text: str) -> None:
    (tmp_path / ".coveragerc").write_text(text)
    with pytest.raises(InputError, match=r"coverage.py's settings: "):
        team_settings(tmp_path)


def test_a_setting_that_our_version_does_not_have() -> None:
    assert _option_of_team(coverage.Coverage(data_file=None, config_file=False), "run:no-such-setting") is None


def test_settings_are_written_as_they_are_read(tmp_path: Path) -> None:
    expressions = ["# no cover$", "; x", "(?s)a.b", "${HOME}|$PATH", "plain"]
    write_settings(
        tmp_path / "rc",
        {"run:branch": True, "run:source": ["/a b", "/c"], "report:exclude_lines": expressions, "p:key": "v"},
    )
    read = coverage.Coverage(config_file=str(tmp_path / "rc"), data_file=None)
    assert read.get_option("run:branch") is True
    assert read.get_option("run:source") == ["/a b", "/c"]
    found = read.get_option("report:exclude_lines")
    assert found == ["[#] no cover$", "[;] x", "(?s)a.b", "${HOME}|$PATH", "plain"]


def test_the_tests_get_no_token_and_no_input_of_ours() -> None:
    given = {
        "CODACY_PROJECT_TOKEN": TOKEN,
        "CODACY_API_TOKEN": TOKEN,
        "INPUT_PROJECT_TOKEN": TOKEN,
        "COVERAGE_PROCESS_CONFIG": "outer",
        "COVERAGE_FILE": "outer",
        "HOME": "/home/robot",
        "PYTHONPATH": "/team",
    }
    assert plain(given) == {"HOME": "/home/robot", "PYTHONPATH": "/team"}
    found = measuring(given, Path("/rc"), Path("/notes"), Path("/brought"))
    assert TOKEN not in str(found)
    assert found["PYTHONPATH"].split(":")[1:] == ["/team"]
    assert (Path(found["PYTHONPATH"].split(":")[0]) / "sitecustomize.py").is_file()
    assert found["COVERAGE_PROCESS_START"] == "/rc"
    assert "COVERAGE_FILE" not in found


def test_only_coverage_is_brought_along(tmp_path: Path) -> None:
    brought = bring_coverage(tmp_path)
    assert bring_coverage(tmp_path) == brought
    assert [path.name for path in brought.iterdir()] == ["coverage"]
    assert (brought / "coverage/__init__.py").is_file()


def test_the_settings_of_a_measurement(tmp_path: Path) -> None:
    team = {"run:concurrency": ["gevent"], "run:omit": ["*/gen/*"], "report:exclude_lines": ["x"]}
    found = measured_environment({}, team, ["/src", "robot"], tmp_path)
    read = coverage.Coverage(config_file=found["COVERAGE_PROCESS_START"], data_file=None)
    assert read.get_option("run:concurrency") == ["gevent", "multiprocessing"]
    assert read.get_option("run:source") == ["/src", "robot"]
    assert read.get_option("run:omit") == ["*/gen/*"]
    assert read.get_option("run:branch") is True
    assert read.get_option("run:parallel") is True


def test_what_a_measurement_has_left(tmp_path: Path) -> None:
    measured_environment({}, {}, [], tmp_path)
    assert measurement(tmp_path) == Measurement(())
    old, new = tmp_path / "python3.9", tmp_path / "python3.13"
    for number, (path, version) in enumerate([(new, "3.13.0"), (old, "3.9.18"), (tmp_path / "gone", "3.14.1")]):
        if path.name != "gone":
            path.touch()
        note = {"python": version, "executable": str(path), "coverage": "7"}
        (tmp_path / f"notes/{number}.json").write_text(json.dumps(note))
    (tmp_path / "notes/8.json").write_text('{"pyth')  # of a process that was killed
    (tmp_path / "notes/9.json").write_text("[]")
    problem = {"python": "3.6.1", "executable": "/usr/bin/python3", "problem": "SyntaxError: x\n::error::y"}
    (tmp_path / "notes/7.json").write_text(json.dumps(problem))
    with closing(coverage.CoverageData(basename=str(tmp_path / "data/.coverage.host.1"))) as data:
        data.add_arcs({"a.py": [(1, 2)]})
    (tmp_path / "data/.coverage.host.2").touch()  # of one that was killed, too
    expected = (
        "/usr/bin/python3 (3.6.1) cannot be measured, neither with a coverage.py of its own nor with ours: "
        "SyntaxError: x ::error::y; install it there (pip install coverage)"
    )
    assert measurement(tmp_path) == Measurement(
        (tmp_path / "data/.coverage.host.1",),
        str(new),
        (
            expected,
            LOST_PROCESS,
        ),
    )


@pytest.mark.parametrize(
    ("code", "tally", "problem"),
    [
        (0, None, None),
        (0, Tally(3, 0, 1), None),
        (1, Tally(2, 1, 0), "the tests failed: exit code 1, 1 of 3 failed"),
        (2, None, "the tests failed: exit code 2"),
        (0, Tally(2, 1, 0), "1 of 3 tests failed, though the exit code is 0"),
        (5, Tally(0, 0, 0), "no test ran"),
        (0, Tally(0, 0, 0), "no test ran"),
        (0, Tally(0, 0, 4), "no test ran (4 were skipped)"),
        (-9, None, "the tests were killed by SIGKILL"),
        (-200, Tally(1, 0, 0), "the tests were killed by signal 200"),
    ],
)
def test_what_is_a_pass(code: int, tally: Tally | None, problem: str | None) -> None:
    assert Tests("pytest", code, 1.0, tally).problem == problem


@pytest.mark.parametrize(
    ("lines", "tally"),
    [
        (["Ran 3 tests in 0.1s", "", "OK"], Tally(3, 0, 0)),
        (["Ran 1 test in 0.1s", "OK (skipped=1)"], Tally(0, 0, 1)),
        (["Ran 6 tests in 0.1s", "FAILED (failures=1, errors=2, skipped=1)"], Tally(2, 3, 1)),
        (["Ran 0 tests in 0.1s", "NO TESTS RAN"], Tally(0, 0, 0)),
        (["Ran 2 tests in 0.1s", "OK", "Ran 3 tests in 1s", "FAILED (failures=1)"], Tally(4, 1, 0)),
        (["OK (skipped=3)", "we Ran 3 tests in total"], None),
    ],
)
def test_unittest_is_counted(lines: list[str], tally: Tally | None) -> None:
    count = _Unittest()
    for line in lines:
        count.line(line)
    assert count.tally() == tally
