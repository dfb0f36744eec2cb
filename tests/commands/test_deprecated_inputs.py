"""Tests of inputs of actions that calibration.yml replaces, or that have another name now."""

import json
import re
from pathlib import Path

import pytest

from calibration.__main__ import main, run_action

T2RGB = str(Path(__file__).resolve().parents[2] / "datasets" / "t2rgb")


@pytest.fixture(autouse=True)
def action(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    for name, value in {"GITHUB_ACTIONS": "true", "GITHUB_ACTION_PATH": "/actions", "INPUT_PARALLEL": ""}.items():
        monkeypatch.setenv(name, value)


def told(output: str) -> list[str]:
    return re.findall("^::warning title=deprecated input::(.*)$", output, re.MULTILINE)


def test_old_inputs_work_and_each_says_once_what_to_write(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    given = {"DATASET": T2RGB, "JOBS": "1", "HOLD": "left_camera, pattern_1", "SEED_LIST": "3, 7", "OUTPUT": "out"}
    for name, value in given.items():
        monkeypatch.setenv(f"INPUT_{name}", value)
    monkeypatch.setenv("INPUT_RULES", "rules.yml")
    Path("rules.yml").write_text("rules: [{column: 'RMS (pix)', row: Averages, max: 3}]\n")
    run_action("calibrate-matrix")
    lines = told(capsys.readouterr().out)
    assert lines[0] == "input 'jobs' is deprecated: write parallel"
    assert [json.loads(line.partition("calibration.yml ")[2]) for line in lines[1:]] == [
        {"noise": {"seed-list": [3, 7]}},
        {"systems": {"NAME": {"hold": ["left_camera", "pattern_1"]}}},
        {"systems": {"NAME": {"rules": "what the file has"}}},
    ]


def test_a_cell_of_the_workflow_says_nothing_and_its_plan_all(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("GITHUB_ACTION_PATH")
    monkeypatch.setenv("INPUT_DATASETS", T2RGB)
    for name, value in {
        "EVALUATE": "single-rgb",
        "ANALYSE": "false",
        "PROMOTE": "false",
        "MAY_PROMOTE": "true",
    }.items():
        monkeypatch.setenv(f"INPUT_{name}", value)
    assert run_action("plan-matrix") == 0
    lines = told(capsys.readouterr().out)
    assert lines[0] == "input 'promote' is deprecated: write may-promote"
    assert [re.findall(r"input '(.*?)'", line) for line in lines[1:]] == [["datasets"], ["evaluate"]]
    monkeypatch.delenv("INPUT_DATASETS")
    monkeypatch.setenv("INPUT_DATASET", "nowhere")
    assert run_action("calibrate-matrix") == 2
    assert told(capsys.readouterr().out) == []


def test_the_command_line_takes_both_names_and_tells_of_none(capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("--parallel", "--jobs"):
        assert main(["calibrate-matrix", "--dataset", "nowhere", name, "1", "--hold", "a"]) == 2
    with_help = capsys.readouterr()
    assert told(with_help.out) == []
    main(["calibrate-matrix", "--help"])
    assert "--jobs" not in capsys.readouterr().out
