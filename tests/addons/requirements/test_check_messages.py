"""The command check-messages and the stage judge: exit codes, files, annotations; the examples of the page run."""

import json
import re
import shutil
from pathlib import Path

import pytest
import yaml
from defusedxml.ElementTree import parse

from calibration.__main__ import main
from calibration.base import ExitCode, InputError
from calibration.ci.workflow import Runner
from calibration.commands.run import RunSettings, run
from tests.addons.requirements.messages import bag_file, drive

PAGE = Path(__file__).parents[3] / "docs" / "requirements.md"
CONFIG = """\
systems: {robot: {dataset: robot}}
requirements:
  bag: robot.bag
  topics:
    /scan:
      max-gap: 50ms
      min-rate: 5
  hpl:
    - "globally: no /cmd_vel {linear.x > 0.6}"
    - "globally: /bumper causes /cmd_vel"
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    bag_file(tmp_path, "bag", drive)
    (tmp_path / "calibration.yml").write_text(CONFIG)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_what_is_not_met_is_red_with_stamps_and_values(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check-messages", "--output", "out"]) == ExitCode.FAIL
    results = json.loads((folder / "out/results.json").read_text())
    found = {each["name"]: each for each in results["requirements"]}
    assert [each["status"] for each in found.values()] == ["met", "not met", "not met", "vacuous"]
    assert (results["verdict"], results["not_met"], results["vacuous"]) == ("fail", 2, 1)
    [witness] = found["globally: no /cmd_vel {linear.x > 0.6}"]["witnesses"]
    assert witness == {"topic": "/cmd_vel", "stamp": 1700000009.0, "after": 9.0, "values": {"linear.x": "0.9"}}
    assert "fail: 2 of 4 requirements not met, 1 vacuous" in capsys.readouterr().out


def test_junit_has_a_case_for_each_and_a_vacuous_one_is_skipped(folder: Path) -> None:
    main(["check-messages", "--output", "out"])
    cases = list(parse(folder / "out/junit.xml").iter("testcase"))
    assert len(cases) == 4
    assert [[part.tag for part in case] for case in cases] == [[], ["failure"], ["failure"], ["skipped"]]


def test_annotations_are_at_the_lines_of_the_requirements(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    main(["check-messages"])
    found = re.findall(
        r"^::(error|warning) file=[^,]*calibration.yml,line=(\d+)", capsys.readouterr().out, re.MULTILINE
    )
    assert sorted(found) == [("error", "6"), ("error", "9"), ("warning", "10")]


@pytest.mark.parametrize(
    ("arguments", "text", "found"),
    [
        ((), "systems: {}\n", "no section 'requirements'"),
        ((), "requirements: {hpl: ['globally: no /x']}\n", "found no bag"),
        ((), "requirements: {hpl: ['globally: no']}\n", "found no bag"),
        (("--bag", "robot.bag"), "requirements: {hpl: ['globally: no']}\n", "line 1, column 11"),
        (("--bag", "missing.bag"), "requirements: {hpl: ['globally: no /x']}\n", "missing.bag: found no such file"),
        (("--bag", "calibration.yml"), "requirements: {hpl: ['globally: no /x']}\n", "expected a bag"),
        (("--bag", "robot.bag"), "requirements: {topics: {/scan: {min-rate: 5, max-rate: 4}}}\n", "max-rate"),
        (("--bag", "robot.bag"), "requirements: {topics: {/scan: {fields: {x: {min: 5, max: 4}}}}}\n", "max"),
        (("--bag", "robot.bag"), "requirements: {topics: {/scan: {}}}\n", "at least one requirement"),
    ],
)
def test_wrong_input_is_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], text: str, found: str
) -> None:
    (folder / "calibration.yml").write_text(text)
    assert main(["check-messages", *arguments]) == ExitCode.BAD_INPUT
    [line] = capsys.readouterr().err.splitlines()
    assert found in line


def stage(folder: Path, *only: str) -> tuple[ExitCode, dict[str, object]]:
    settings = RunSettings(config=folder / "calibration.yml", output=folder / "output", only=only)
    return run(settings, Runner()), json.loads((folder / "output/results.json").read_text())


def test_the_stage_is_part_of_the_verdict_and_of_the_results(folder: Path) -> None:
    code, results = stage(folder, "judge")
    assert (code, results["verdict"]) == (ExitCode.FAIL, "fail")
    found = results["requirements"]
    assert isinstance(found, dict)
    assert (found["requirements"], found["not_met"], len(found["vacuous"]), found["verdict"]) == (4, 2, 1, "fail")
    assert all("at 9.000 s" in reason or "/scan: gap" in reason for reason in found["reasons"])
    assert (folder / "output/requirements/junit.xml").exists()


def test_requirements_that_are_met_are_green(folder: Path) -> None:
    (folder / "calibration.yml").write_text(CONFIG.replace("50ms", "150ms").replace("0.6", "1"))
    code, results = stage(folder, "judge")
    assert (code, results["verdict"]) == (ExitCode.PASS, "pass")


@pytest.mark.parametrize("text", re.findall(r"```yaml\n(requirements:.*?)```", PAGE.read_text(), re.DOTALL))
def test_the_examples_of_the_page_are_met_by_a_robot_that_drives(text: str, folder: Path) -> None:
    (folder / "recorded").mkdir()
    shutil.move(folder / "robot.bag", folder / "recorded/drive.bag")
    (folder / "calibration.yml").write_text(text)
    arguments = [] if "bag" in yaml.safe_load(text)["requirements"] else ["--bag", "recorded/drive.bag"]
    assert main(["check-messages", "--output", "out", *arguments]) == ExitCode.PASS


def test_the_bag_that_a_simulation_records_is_judged(folder: Path) -> None:
    (folder / "calibration.yml").write_text(CONFIG.replace("robot.bag", "simulation:drive"))
    place = folder / "output/collected/drive/messages"
    place.mkdir(parents=True)
    with pytest.raises(InputError, match=r"simulation.drive records: add 'record: {}'"):
        stage(folder, "judge")
    shutil.move(folder / "robot.bag", place)
    assert stage(folder, "judge")[0] == ExitCode.FAIL
    assert main(["check-messages"]) == ExitCode.BAD_INPUT
    assert main(["check-messages", "--bag", str(place / "robot.bag")]) == ExitCode.FAIL
