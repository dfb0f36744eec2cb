"""The stage analyse: its verdict is part of the pipeline's, its results have a folder of their own."""

import json
from pathlib import Path

import pytest

from calibration.base import ExitCode, InputError
from calibration.ci.workflow import Runner
from calibration.commands.run import RunSettings, run
from tests.repositories import git

CONFIGURATION = "systems: {robot: {dataset: robot}}\n"
CODE = "def f():\n    return missing\n"


def repository(folder: Path, section: str) -> Path:
    """Write a repository with a finding, and return its configuration."""
    folder.mkdir()
    (folder / "calibration.yml").write_text(CONFIGURATION + section)
    (folder / "naming.py").write_text(CODE)
    for arguments in (["init", "-q"], ["add", "-A"]):
        git(folder, *arguments)
    return folder / "calibration.yml"


def analysed(folder: Path, section: str) -> tuple[ExitCode, dict[str, object]]:
    config = repository(folder, section)
    code = run(RunSettings(config=config, output=folder / "output", only=("analyse",)), Runner())
    return code, json.loads((folder / "output" / "results.json").read_text())


def test_a_limit_that_is_exceeded_is_red_and_says_why(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, results = analysed(tmp_path / "robot", "analysis: {tools: [ruff], max-total: [error=0]}\n")
    assert (code, results["verdict"]) == (ExitCode.FAIL, "fail")
    assert results["analysis"] == {
        "findings": 1,
        "new": None,
        "folder": "static-analysis",
        "reasons": ["static analysis: all findings (error): found 1, expected at most 0"],
        "verdict": "fail",
    }
    assert capsys.readouterr().out.splitlines()[-1].startswith("fail: 1 finding in the code")
    assert (tmp_path / "robot" / "output" / "static-analysis" / "findings.sarif").exists()


def test_findings_within_the_limits_pass(tmp_path: Path) -> None:
    code, results = analysed(tmp_path / "robot", "analysis: {tools: [ruff]}\n")
    assert (code, results["verdict"]) == (ExitCode.PASS, "pass")


def test_without_the_section_there_is_no_such_stage(tmp_path: Path) -> None:
    config = repository(tmp_path / "robot", "")
    assert run(RunSettings(config=config, output=tmp_path / "output", only=("analyse",)), Runner()) != ExitCode.PASS
    assert not (tmp_path / "output" / "static-analysis").exists()


def test_a_wrong_setting_names_its_key(tmp_path: Path) -> None:
    config = repository(tmp_path / "robot", "analysis: {tools: [rufff]}\n")
    with pytest.raises(InputError, match=r"tools: found 'rufff'.*did you mean 'ruff'"):
        run(RunSettings(config=config, output=tmp_path / "output", only=("analyse",)), Runner())
