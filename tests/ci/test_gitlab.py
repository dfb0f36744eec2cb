"""GitLab CI, by recorded variables of its pipelines and a stand-in of its API."""

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

from calibration.__main__ import main
from calibration.base import InputError
from calibration.ci.gitlab import GITLAB, add_to_code_quality
from calibration.ci.services import event_of, service_of
from calibration.ci.workflow import Annotation, Level, Runner, annotate, group, set_outputs
from tests.ci.github.stand_in import TOKEN, GitHub, stand_in
from tests.lint.yaml_lines import PROJECT

PUSH = {
    "GITLAB_CI": "true",
    "CI_PIPELINE_SOURCE": "push",
    "CI_COMMIT_SHA": "c" * 40,
    "CI_COMMIT_BRANCH": "main",
    "CI_COMMIT_BEFORE_SHA": "b" * 40,
    "CI_DEFAULT_BRANCH": "main",
    "CI_PROJECT_ID": "31",
    "CI_PROJECT_URL": "https://gitlab.example/team/robot",
    "CI_PIPELINE_ID": "1234567890",
    "CI_PIPELINE_URL": "https://gitlab.example/team/robot/-/pipelines/1234567890",
    "CI_JOB_NAME": "calibration",
}
MERGE_REQUEST = PUSH | {
    "CI_PIPELINE_SOURCE": "merge_request_event",
    "CI_COMMIT_BRANCH": "",
    "CI_COMMIT_BEFORE_SHA": "0" * 40,
    "CI_MERGE_REQUEST_IID": "7",
    "CI_MERGE_REQUEST_PROJECT_ID": "31",
    "CI_MERGE_REQUEST_SOURCE_PROJECT_ID": "31",
    "CI_MERGE_REQUEST_SOURCE_BRANCH_SHA": "",
    "CI_MERGE_REQUEST_DIFF_BASE_SHA": "d" * 40,
}
FORK = MERGE_REQUEST | {"CI_PROJECT_ID": "99", "CI_MERGE_REQUEST_SOURCE_PROJECT_ID": "99"}
"""A pipeline of a merge request in the fork that it comes from."""


class GitLabApi(GitHub):
    """Notes on merge request 7 of project 31."""

    def answer(self, method: str, path: str, body: Any, token: str | None) -> tuple[int, object, dict[str, str]]:
        if path == "/user":
            known = token == f"Bearer {TOKEN}"
            return (200, {"username": "bot"}, {}) if known else (401, {"message": "401 Unauthorized"}, {})
        rest = re.fullmatch(r"/projects/31/merge_requests/7/notes(?:/(\d+))?(\?.*)?", path)
        if rest is None or method == "PATCH":
            return 404, {"message": "404 Not found"}, {}
        name = f"comments/{rest[1]}" if rest[1] else "7/comments"
        answer = super().answer(method, f"/repos/{self.repository}/issues/{name}{rest[2] or ''}", body, token)
        if method == "POST" and answer[0] == 201:
            self.comments[-1]["author"] = {"username": "bot"}
        return answer


@pytest.fixture
def step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Run in a job of a merge request; return the checkout."""
    for name in ("GITHUB_ACTIONS", "GITHUB_OUTPUT", "GITHUB_STEP_SUMMARY"):
        monkeypatch.delenv(name, raising=False)
    for name, value in _job(tmp_path).items():
        monkeypatch.setenv(name, value)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def _job(checkout: Path) -> Mapping[str, str]:
    files = {"CALIBRATION_DOTENV": str(checkout / "o.env"), "CALIBRATION_CODE_QUALITY": str(checkout / "q.json")}
    return MERGE_REQUEST | files | {"CI_PROJECT_DIR": str(checkout)}


@pytest.fixture
def api(step: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[GitLabApi]:
    with stand_in(GitLabApi) as found:
        monkeypatch.setenv("CI_API_V4_URL", found.url)
        monkeypatch.setenv("GITLAB_TOKEN", TOKEN)
        yield found


def test_pipelines_of_pushes_and_merge_requests() -> None:
    assert service_of(PUSH) is GITLAB
    assert GITLAB.origin(PUSH) == ("https://gitlab.example/team/robot", "c" * 40)
    pushed, asked = event_of(PUSH), event_of(MERGE_REQUEST)
    assert (pushed.branch, pushed.pull_request_commit, pushed.by_stranger) == ("main", None, None)
    assert pushed.bases == ("b" * 40, "refs/remotes/origin/main")
    assert (asked.branch, asked.pull_request_commit, asked.by_stranger) == (None, "c" * 40, None)
    assert asked.bases == ("d" * 40, "refs/remotes/origin/main")
    merged = event_of(MERGE_REQUEST | {"CI_MERGE_REQUEST_SOURCE_BRANCH_SHA": "e" * 40})
    assert merged.pull_request_commit == "e" * 40


def test_a_fork_is_a_stranger_and_comments_only_where_a_member_started_it() -> None:
    assert event_of(FORK).by_stranger
    assert event_of(FORK).without_comment
    by_member = event_of(FORK | {"CI_PROJECT_ID": "31"})
    assert by_member.by_stranger
    assert by_member.without_comment is None


def test_a_job_leaves_a_verdict_and_findings(step: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("t.csv").write_text("k,v\na,5\n")
    assert main(["introspect-csv", "--file", "t.csv", "--column", "v", "--max", "3"]) == 1
    assert "CALIBRATION_VERDICT=fail\n" in (step / "o.env").read_text()
    [finding] = json.loads((step / "q.json").read_text())
    assert finding["location"] == {"path": "t.csv", "lines": {"begin": 2}}
    assert finding["severity"] == "major"
    out, err = capsys.readouterr()
    assert err.startswith("error: t.csv:2: v, a: found 5")
    assert "::" not in out


def test_findings_are_told_apart_and_stay_when_lines_move(step: Path) -> None:
    runner = Runner.from_environment()
    two = [Annotation("same", Level.WARNING, "a.py", line) for line in (3, 9)]
    annotate(runner, [*two, Annotation("without a file")])
    annotate(runner, [Annotation("other", Level.NOTICE, step / "b.py")])
    entries = json.loads((step / "q.json").read_text())
    assert [entry["severity"] for entry in entries] == ["minor", "minor", "info"]
    assert [entry["location"]["path"] for entry in entries] == ["a.py", "a.py", "b.py"]
    assert len({entry["fingerprint"] for entry in entries}) == 3
    moved = step / "moved.json"
    add_to_code_quality(moved, runner, [Annotation("same", Level.WARNING, "a.py", 4)])
    assert json.loads(moved.read_text())[0]["fingerprint"] == entries[0]["fingerprint"]
    moved.write_text("{}")
    with pytest.raises(InputError, match=r"moved\.json"):
        add_to_code_quality(moved, runner, [])


def test_an_output_of_several_lines_sets_no_other_variable(step: Path) -> None:
    set_outputs(Runner.from_environment(), {"worst-rms-px": 0.5, "exports": "a\nCI_TOKEN=b", "long": "x" * 9000})
    lines = (step / "o.env").read_text().splitlines()
    assert [line.partition("=")[0] for line in lines] == [
        f"CALIBRATION_{each}" for each in ("WORST_RMS_PX", "EXPORTS", "LONG")
    ]
    assert len(lines[2]) < 600


def test_sections_fold_and_have_names_of_their_own(step: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runner = Runner.from_environment()
    for title in ("a\ntitle", "b"):
        with group(runner, title):
            runner.log("x")
    form = r"\x1b\[0Ksection_start:\d+:(\w+)\[collapsed=true\]\r\x1b\[0K(.*)\nx\n\x1b\[0Ksection_end:\d+:\1\r\x1b\[0K\n"
    found = re.findall(form, capsys.readouterr().out)
    assert [title for _, title in found] == ["a title", "b"]
    assert found[0][0] != found[1][0]


def test_one_note_is_kept_and_deleted(api: GitLabApi, step: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    marked = "<!-- calibration-ci calibration/ run 1.1 -->\nof somebody"
    api.add(marked)["author"] = {"username": "somebody"}
    assert main(["comment"]) == 0
    monkeypatch.setenv("CI_PIPELINE_ID", "1234567891")
    brief = {"schema": 1, "verdict": "fail", "sentence": "/merge !1 $5 ~bug", "about": "/close"}
    (step / "output").mkdir()
    (step / "output" / "comment.json").write_text(json.dumps(brief))
    assert main(["comment"]) == 0
    assert len(api.comments) == 2
    note = api.bodies()[1]
    assert "Calibration: fail" in note
    assert f"[run]({PUSH['CI_PIPELINE_URL']}) · ccccccc" in note
    assert not re.search(r"^\s*/|!\d|\$\d|~\w", note, re.MULTILINE)
    assert main(["comment", "--mode", "delete"]) == 0
    assert api.bodies() == [marked]


def test_a_note_needs_a_token_with_rights(
    api: GitLabApi, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    api.answers = [(403, {"message": "403 Forbidden"}, {})]
    assert main(["comment"]) == 2
    assert "scope api" in capsys.readouterr().err
    monkeypatch.setenv("GITLAB_TOKEN", "wrong")
    assert main(["comment"]) == 2
    monkeypatch.setenv("CI_API_V4_URL", f"{api.url}/elsewhere")
    assert main(["comment"]) == 2
    monkeypatch.delenv("GITLAB_TOKEN")
    assert main(["comment"]) == 2
    assert "GITLAB_TOKEN" in capsys.readouterr().err
    for name, value in PUSH.items():
        monkeypatch.setenv(name, value)
    monkeypatch.delenv("CI_MERGE_REQUEST_IID")
    assert main(["comment"]) == 0  # a push has no merge request


def test_the_component_names_the_files_that_are_written() -> None:
    spec, jobs = yaml.safe_load_all((PROJECT / "templates" / "calibration.yml").read_text())
    job = jobs["calibration"]
    reports, variables = job["artifacts"]["reports"], job["variables"]
    assert reports["dotenv"] == variables["CALIBRATION_DOTENV"]
    assert reports["codequality"] == variables["CALIBRATION_CODE_QUALITY"]
    assert reports["junit"] == f"{variables['CALIBRATION_OUTPUT']}/junit.xml"
    used = set(re.findall(r"\$\[\[ inputs\.(\w+) \]\]", json.dumps(jobs)))
    assert used == set(spec["spec"]["inputs"])
