from pathlib import Path

from calibration.ci.github.service import GITHUB
from calibration.ci.workflow import Runner


def test_reads_the_runners_variables() -> None:
    runner = Runner.from_environment(
        {
            "GITHUB_ACTIONS": "true",
            "GITHUB_WORKSPACE": "/w",
            "GITHUB_OUTPUT": "/t/out",
            "GITHUB_STEP_SUMMARY": "/t/summary",
            "RUNNER_DEBUG": "1",
            "GITHUB_EVENT_NAME": "pull_request_target",
        }
    )
    assert runner == Runner(GITHUB, Path("/w"), Path("/t/out"), Path("/t/summary"), True, True)


def test_off_github_there_is_nothing() -> None:
    assert Runner.from_environment({}) == Runner()
    nothing = {"GITHUB_ACTIONS": "false", "GITHUB_OUTPUT": "", "RUNNER_DEBUG": "0", "GITHUB_EVENT_NAME": "push"}
    assert Runner.from_environment(nothing) == Runner()


def test_names_files_relative_to_the_workspace(github: Runner, workspace: Path, tmp_path: Path) -> None:
    assert github.relative(workspace / "a" / "b.csv") == "a/b.csv"
    assert github.relative(workspace / "a" / ".." / "b.csv") == "b.csv"
    assert github.relative(tmp_path / "b.csv") == str(tmp_path / "b.csv")
    assert Runner().relative("a/b.csv") == "a/b.csv"


def test_follows_a_linked_workspace(workspace: Path, tmp_path: Path) -> None:
    link = tmp_path / "link"
    link.symlink_to(workspace)
    assert Runner(workspace=link).relative(workspace / "b.csv") == "b.csv"
    assert Runner(workspace=workspace).relative(link / "b.csv") == "b.csv"
