"""Command ``coverage-upload`` with a repository, tests, and a stand-in of Codacy, including its errors."""

import ctypes
import hashlib
import json
import os
import secrets
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from defusedxml.ElementTree import parse

from calibration.__main__ import COMMANDS, main, run_action
from calibration.addons import coverage
from calibration.addons.coverage.coverage_upload import CoverageSettings
from calibration.base.addons import LazyCommand
from tests.addons.coverage import projects
from tests.addons.coverage.projects import NAMING, TOKEN, robot
from tests.processes import runs
from tests.repositories import commit, git, write

NAME = "coverage-upload"
SCHEMA = json.loads(Path(coverage.__file__ or "").with_name("results.schema.json").read_text())
XML = """<coverage line-rate="1"><class filename="robot/naming.py"><lines>
<line number="1" hits="1"/><line number="2" hits="1"/><line number="3" hits="0"/>
<line number="4" hits="1"/><line number="7" hits="1"/><line number="8" hits="0"/></lines></class></coverage>"""


@pytest.fixture(autouse=True)
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a repository, outside of GitHub, with a coverage report outside of it."""
    for name in [
        name for name in os.environ if name.startswith(("GITHUB_", "INPUT_", "RUNNER_", "CODACY_", "COVERAGE_"))
    ]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")  # so that remaining files are the command's
    command = LazyCommand("calibration.addons.coverage.coverage_upload:command", "")
    monkeypatch.setitem(COMMANDS, NAME, command)  # type: ignore[index]
    root = robot(tmp_path / "p")
    write(tmp_path, {"c.xml": XML})
    monkeypatch.chdir(root)
    return root


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[projects.Codacy]:
    """Run a stand-in of Codacy that the environment names, with a token."""
    with projects.codacy() as service:
        monkeypatch.setenv("CODACY_API_BASE_URL", service.url)
        monkeypatch.setenv("CODACY_PROJECT_TOKEN", f"{TOKEN}\n")
        yield service


@pytest.fixture
def on_github(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Set the event of a GitHub runner."""

    def tell(name: str, body: dict[str, Any], **variables: str) -> None:
        (tmp_path / "event.json").write_text(json.dumps(body))
        for variable, value in {
            "GITHUB_ACTIONS": "true",
            "GITHUB_EVENT_NAME": name,
            "GITHUB_EVENT_PATH": str(tmp_path / "event.json"),
            "GITHUB_OUTPUT": str(tmp_path / "outputs"),
            "GITHUB_STEP_SUMMARY": str(tmp_path / "step.md"),
            **variables,
        }.items():
            monkeypatch.setenv(variable, value)

    return tell


def upload(*arguments: str, reports: str | None = "../c.xml") -> int:
    """Upload a report, by default the one beside the repository; the token stays in the environment."""
    given = [] if reports is None else ["--reports", reports]
    given += [] if "--service" in arguments else ["--service", "codacy"]
    before = dict(os.environ)
    try:
        return main([NAME, *given, *arguments])
    finally:
        os.environ.update(before)


def test_a_report_is_uploaded(server: projects.Codacy, root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert upload("--output", "out", "--badge", "out/badge.svg") == 0
    head = git(root, "rev-parse", "HEAD")
    [asked] = server.asked
    assert asked.path == f"/2.0/coverage/{head}/python?partial=false"
    assert asked.body == (
        b'{"fileReports":[{"filename":"robot/naming.py","coverage":{"1":1,"2":1,"3":0,"4":1,"7":1,"8":0}}]}'
    )
    assert asked.headers["project-token"] == TOKEN
    out, err = capsys.readouterr()
    assert out.endswith("pass: 66.6 % (4 of 6) of the lines are run; uploaded to codacy (out/results.json)\n")
    assert err == ""
    results = json.loads(Path("out/results.json").read_text())
    jsonschema.validate(results, SCHEMA)
    assert results["commit"] == head
    assert results["upload"] == {"service": "codacy", "state": "uploaded", "reason": ""}
    assert Path("out/summary.md").read_text().startswith("## Coverage of the tests: pass")
    assert parse("out/junit.xml").getroot().get("failures") == "0"
    assert "coverage: 66%" in Path("out/badge.svg").read_text()
    assert all(TOKEN not in file.read_text() for file in Path("out").iterdir())


def test_tests_are_run_and_their_coverage_uploaded(
    server: projects.Codacy, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    assert (
        upload(
            "--run", "python3 -m pytest -q -p no:cacheprovider", "--output", "out", "--source", "robot", reports=None
        )
        == 0
    )
    assert b'"robot/naming.py","coverage":{"1":1,"2":1,"3":0,"4":1,"7":1,"8":0}' in server.asked[0].body
    results = json.loads(Path("out/results.json").read_text())
    jsonschema.validate(results, SCHEMA)
    assert results["tests"]["passed"] == 1
    assert results["branches"] == {"covered": 1, "total": 2, "percent": 50.0}
    assert parse("out/tests.xml").getroot().find(".//testcase").get("name") == "test_joined"
    assert "1 passed" in Path("out/tests.log").read_text()
    assert TOKEN not in capsys.readouterr().out + Path("out/tests.log").read_text()
    assert git(Path(), "status", "--porcelain") == ""
    assert results["functions"] == {"covered": 1, "total": 2, "percent": 50.0}
    # A job without tests uploads the same report.
    assert upload("--source", "robot", reports="out/lcov.info") == 0
    assert server.asked[1].body == server.asked[0].body


def test_tests_that_fail_are_the_verdict_and_the_report_is_uploaded_all_the_same(
    server: projects.Codacy, root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    commit(root, {"tests/test_naming.py": "from robot.naming import split\ndef test(): assert split('a') == 'b'\n"})
    code = upload("--run", "pytest -q -p no:cacheprovider", "--interpreter", sys.executable, reports=None)
    assert code == 1
    assert len(server.asked) == 1
    out, err = capsys.readouterr()
    assert out.endswith("fail: the tests failed: exit code 1, 1 of 1 failed; uploaded to codacy\n")
    assert "error: tests/test_naming.py:2: tests.test_naming.test: AssertionError: assert ['a'] == 'b'" in err


def test_tests_that_fail_before_anything_is_measured(
    server: projects.Codacy, capsys: pytest.CaptureFixture[str]
) -> None:
    write(Path(), {"run": "#!/bin/sh\nexit 3\n"})
    Path("run").chmod(0o755)
    assert upload("--run", "./run", "--output", "out", reports=None) == 1
    assert upload("--run", "./run", reports="none.xml") == 1  # nor is a report required then
    assert server.asked == []
    out = capsys.readouterr().out
    assert out.count("fail: the tests failed: exit code 3; not uploaded (nothing was measured)") == 2
    assert "no coverage: none.xml: a data file of coverage.py, Cobertura XML, LCOV or JSON of gcov was expected" in out
    jsonschema.validate(json.loads(Path("out/results.json").read_text()), SCHEMA)


def test_tests_that_measure_themselves(server: projects.Codacy, capsys: pytest.CaptureFixture[str]) -> None:
    write(Path(), {"run": f"#!/bin/sh\ncat > c.xml <<'X'\n{XML}\nX\n", "idle": "#!/bin/sh\n"})
    for name in ("run", "idle"):
        Path(name).chmod(0o755)
    assert upload("--run", "./run", reports="c.xml") == 0
    assert len(server.asked) == 1
    os.utime("c.xml", (1, 1))
    assert upload("--run", "./idle", reports="c.xml") == 2
    assert "c.xml: it is older than this run of the tests" in capsys.readouterr().err
    assert upload("--run", "./idle", reports=None) == 2
    assert "the tests passed, but no coverage was measured: no Python was started" in capsys.readouterr().err


@pytest.mark.thorough(but_first=4)
@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["--minimum", "66"], 0, "pass"),
        (
            ["--minimum", "66.67"],
            1,
            "fail: lines that are run: found 66.6 % (4 of 6), expected at least 66.67 %",
        ),
        (["--goal", "70"], 0, "pass"),
        (["--minimum-functions", "50"], 0, "pass"),
        (
            ["--minimum-functions", "51"],
            1,
            "fail: functions that are run: found 50.0 % (1 of 2), expected at least 51 %",
        ),
        (
            ["--base", "HEAD~1", "--minimum-functions-change", "51"],
            1,
            "fail: functions of the change that are run: found 5",
        ),
        (["--base", "HEAD", "--minimum-change", "100"], 0, "pass"),  # nothing has changed
        (
            ["--base", "HEAD~1", "--minimum-change", "50"],
            1,
            "fail: lines of the change that are run: found 33.3 % (1 of 3), ex",
        ),
        (["--base", "HEAD~1", "--minimum-change", "33"], 0, "pass"),
    ],
)
def test_limits(root: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], code: int, said: str) -> None:
    commit(root, {"robot/naming.py": NAMING.replace('return ""', "return ''").replace("split(", "cut(")})
    assert upload("--service", "none", *arguments) == code
    out, err = capsys.readouterr()
    assert out.splitlines()[-1].startswith(said)
    if "HEAD~1" in arguments:
        assert "warning: robot/naming.py:3: no test runs line 3 of this change" in err
        assert "warning: robot/naming.py:8: no test runs line 8 of this change" in err


@pytest.mark.parametrize("attribute", ["-diff", "binary"])
def test_a_change_whose_lines_git_does_not_tell_is_refused(
    root: Path, capsys: pytest.CaptureFixture[str], attribute: str
) -> None:
    """Else a change could except itself from minimum-change."""
    commit(root, {"robot/naming.py": NAMING.replace("split(", "cut("), ".gitattributes": f"*.py {attribute}\n"})
    assert upload("--service", "none", "--base", "HEAD~1", "--minimum-change", "50") == 2
    assert "robot/naming.py: its changed lines are not known" in capsys.readouterr().err


def test_on_github(
    server: projects.Codacy, root: Path, tmp_path: Path, on_github: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    base = git(root, "rev-parse", "HEAD")
    commit(root, {"robot/naming.py": NAMING.replace("name.split", "name.rsplit")})
    body = {"pull_request": {"head": {"sha": "c" * 40, "repo": {"full_name": "a/b"}}, "base": {"sha": base}}}
    body["pull_request"]["base"]["repo"] = {"full_name": "a/b"}  # type: ignore[assignment]
    on_github("pull_request", body, GITHUB_SHA="d" * 40, GITHUB_WORKSPACE=str(root))
    assert upload("--badge", "badge.svg") == 0
    assert server.asked[0].path.startswith(f"/2.0/coverage/{'c' * 40}/")
    out = capsys.readouterr().out
    assert out.startswith("::add-mask::")
    assert TOKEN not in "\n".join(line for line in out.splitlines() if not line.startswith("::add-mask::"))
    assert "::warning file=robot/naming.py,line=8,title=not covered::no test runs line 8 of this change" in out
    outputs = dict(line.split("=", 1) for line in (tmp_path / "outputs").read_text().splitlines())
    assert outputs == {
        "verdict": "pass",
        "line-rate": "66.66",
        "branch-rate": "",
        "function-rate": "50.0",
        "change-rate": "0.0",
        "change-function-rate": "0.0",
        "pseudo-tested": "",
        "pseudo-tested-change": "",
        "files-below-goal": "0",
        "uploaded": "uploaded",
        "commit": "c" * 40,
        "results": "",
        "summary": "",
        "badge": "badge.svg",
    }
    assert (tmp_path / "step.md").read_text().startswith("## Coverage of the tests: pass")


FORK = {
    "pull_request": {"head": {"sha": "c" * 40, "repo": {"full_name": "fork/b"}}, "base": {"repo": {"full_name": "a/b"}}}
}


@pytest.mark.parametrize(
    ("name", "body", "actor", "arguments", "reason"),
    [
        ("pull_request", FORK, "someone", [], "it is a pull request from a fork, which is given no secrets"),
        ("push", {}, "dependabot[bot]", [], "Dependabot started it"),
        ("push", {}, "someone", ["--if-token-missing", "skip"], "there is no token"),
    ],
)
def test_skipped_where_there_can_be_no_token(
    tmp_path: Path,
    on_github: Any,
    capsys: pytest.CaptureFixture[str],
    name: str,
    body: dict[str, Any],
    actor: str,
    arguments: list[str],
    reason: str,
) -> None:
    on_github(name, body, GITHUB_SHA="d" * 40, GITHUB_ACTOR=actor, CODACY_PROJECT_TOKEN="")  # a missing secret is empty
    assert upload(*arguments) == 0
    assert f"::notice title=Coverage of the tests::not uploaded: {reason}" in capsys.readouterr().out
    assert "uploaded=skipped" in (tmp_path / "outputs").read_text()
    assert upload("--final", *arguments, reports=None) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith(f"skipped: {reason}")


def test_no_token_where_there_should_be_one(on_github: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert upload("--run", "touch ran") == 2
    assert not Path("ran").exists()  # reported before the tests run
    assert "error: CODACY_PROJECT_TOKEN is not set, nor CODACY_API_TOKEN" in capsys.readouterr().err
    on_github("push", {}, GITHUB_SHA="d" * 40, GITHUB_ACTOR="someone")
    assert upload() == 2


def test_the_upload_fails(
    server: projects.Codacy, tmp_path: Path, on_github: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    on_github("push", {}, GITHUB_SHA="d" * 40)
    server.answer(401, json.dumps({"error": f"bad token {TOKEN}"}))
    assert upload("--output", "out") == 3
    out = capsys.readouterr().out
    assert "answered 401 (bad token ***): check the token" in out
    assert "uploaded=failed" in (tmp_path / "outputs").read_text()
    results = json.loads(Path("out/results.json").read_text())
    assert results["verdict"] == "pass"
    assert results["upload"]["state"] == "failed"
    assert TOKEN not in Path("out/results.json").read_text() + Path("out/summary.md").read_text()
    server.answer(400, '{"error": "x"}')
    assert upload("--minimum", "100") == 1  # the verdict takes precedence
    server.answer(400, '{"error": "x"}')
    assert upload("--final", reports=None) == 3


def test_only_the_end_of_the_upload_is_notified(server: projects.Codacy, capsys: pytest.CaptureFixture[str]) -> None:
    assert upload("--final", "--commit", "E" * 40, reports=None) == 0
    [asked] = server.asked
    assert (asked.path, asked.body) == (f"/2.0/commit/{'e' * 40}/coverageFinal", b"{}")
    assert capsys.readouterr().out.endswith(f"uploaded: no more uploads for {'e' * 40}\n")
    assert upload("--final", "--service", "none", reports=None) == 0
    assert upload("--partial") == 0
    assert server.asked[1].path.endswith("?partial=true")
    assert len(server.asked) == 2


THIEF = """
import hashlib, os, re, sys
SECRET = re.compile(rb"planted-[0-9a-f]{32}")
ABOVE, pid = [], os.getpid()
while pid > 1:
    pid = int(re.search(r"PPid:\\s*([0-9]+)", open(f"/proc/{pid}/status").read())[1])
    ABOVE.append(pid)

def look(path, ranges=((0, 1 << 16),)):
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        for begin, end in ranges:
            try:
                data = os.pread(descriptor, end - begin, begin) if begin else os.read(descriptor, end)
            except OSError:
                continue
            if sys.argv[1] in [hashlib.sha256(found).hexdigest() for found in SECRET.findall(data)]:
                print("STOLEN from", path)
    except OSError as error:
        print("refused", path, error.strerror)

for pid in filter(str.isdigit, os.listdir("/proc")):
    look(f"/proc/{pid}/environ")
parent = ABOVE[0]
for folder in ("fd", "task"):
    try:
        for name in os.listdir(f"/proc/{parent}/{folder}"):
            look(f"/proc/{parent}/{folder}/{name}" + ("/environ" if folder == "task" else ""))
    except OSError:
        print("refused", folder)
try:
    lines = open(f"/proc/{parent}/maps").read().splitlines()
except OSError:
    print("refused maps")
else:
    spans = [[int(part, 16) for part in line.split()[0].split("-")] for line in lines if " rw" in line]
    look(f"/proc/{parent}/mem", spans)
os.utime("../c.xml")  # as if it wrote its report
"""


def without_ptrace() -> None:
    """Drop the capability of root outside of a container that no protection of a process resists."""
    ctypes.CDLL(None).prctl(24, 19, 0, 0, 0)  # PR_CAPBSET_DROP, CAP_SYS_PTRACE


@pytest.mark.thorough(but_first=1)
@pytest.mark.skipif(sys.platform != "linux", reason="/proc is Linux's")
@pytest.mark.parametrize("action", [False, True])
def test_the_tests_cannot_steal_the_token(server: projects.Codacy, tmp_path: Path, root: Path, action: bool) -> None:
    token = f"planted-{secrets.token_hex(16)}"
    write(tmp_path, {"thief.py": THIEF})
    run = f"{sys.executable} {tmp_path / 'thief.py'} {hashlib.sha256(token.encode()).hexdigest()}"
    if action:  # as the runner does
        step = f'exec bash "{Path(__file__).parents[3] / "actions/bootstrap.sh"}" {NAME}'
        command = ["bash", "--noprofile", "--norc", "-e", "-o", "pipefail", "-c", step]
        given = {"INPUT_PROJECT_TOKEN": token, "INPUT_RUN": run, "INPUT_REPORTS": "../c.xml"}
        given |= {"INPUT_API_URL": server.url, "INPUT_PYTHON": sys.executable, "INPUT_SERVICE": "codacy"}
    else:
        command = [sys.executable, "-m", "calibration", NAME, "--run", run, "--reports", "../c.xml"]
        command += ["--api-url", server.url, "--service", "codacy"]
        given = {"CODACY_PROJECT_TOKEN": token, "PYTHONPATH": str(Path(__file__).parents[3])}
    done = subprocess.run(
        command,
        cwd=root,
        env={"PATH": os.environ["PATH"], **given},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        preexec_fn=without_ptrace,
        check=False,
    )
    assert "STOLEN" not in done.stdout
    assert done.stdout.count("refused") > 3
    assert [asked.headers["project-token"] for asked in server.asked] == [token]


def test_an_accounts_token_and_codacys_own_variables(server: projects.Codacy, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CODACY_PROJECT_TOKEN")
    monkeypatch.setenv("CODACY_API_TOKEN", TOKEN)
    monkeypatch.setenv("CODACY_ORGANIZATION_PROVIDER", "gh")
    monkeypatch.setenv("CODACY_USERNAME", "team")
    monkeypatch.setenv("CODACY_PROJECT_NAME", "robot")
    assert upload("--commit", "e" * 40) == 0
    assert upload("--commit", "e" * 40, "--repository", "other", "--language", "Cython") == 0
    assert [asked.path for asked in server.asked] == [
        f"/2.0/gh/team/robot/commit/{'e' * 40}/coverage/python?partial=false",
        f"/2.0/gh/team/other/commit/{'e' * 40}/coverage/cython?partial=false",
    ]
    assert server.asked[0].headers["api-token"] == TOKEN


def test_a_dry_run_shows_the_requests(capsys: pytest.CaptureFixture[str]) -> None:
    assert upload("--dry-run", "--output", "out", "--commit", "e" * 40, "--final") == 0
    out = capsys.readouterr().out
    url = "https://api.codacy.com/2.0"
    assert f"1 python file: 97 bytes of JSON would be sent to {url}/coverage/{'e' * 40}/python?partial=true" in out
    assert f"final request: 2 bytes of JSON would be sent to {url}/commit/{'e' * 40}/coverageFinal" in out
    assert len(Path("out/upload-1.json").read_bytes()) == 97
    assert json.loads(Path("out/results.json").read_text())["upload"]["state"] == "dry-run"
    assert upload("--service", "none", "--output", "out") == 0
    assert not Path("out/upload-1.json").exists()  # left by the earlier run


@pytest.mark.parametrize("option", ["--project-token", "--api-token"])
def test_a_token_on_the_command_line_is_refused(capsys: pytest.CaptureFixture[str], option: str) -> None:
    assert upload(option, TOKEN) == 2
    out, err = capsys.readouterr()
    assert "found on the command line, where every process reads it: put it into the environment variable COD" in err
    assert TOKEN not in out + err


def test_as_an_action_the_inputs_go_before_the_environment(
    server: projects.Codacy, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("INPUT_REPORTS", "\n../c.xml\n")
    monkeypatch.setenv("INPUT_PROJECT_TOKEN", "from-the-input")
    monkeypatch.setenv("INPUT_PARTIAL", "true")
    monkeypatch.setenv("INPUT_MINIMUM", "")
    monkeypatch.setenv("INPUT_SERVICE", "codacy")
    assert run_action(NAME) == 0
    assert server.asked[0].headers["project-token"] == "from-the-input"
    assert server.asked[0].path.endswith("?partial=true")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--service", "codecov"], "'codecov' is not one of 'codacy', 'none'"),
        (["--if-token-missing", "ignore"], "'ignore' is not one of 'fail', 'skip'"),
        (["--partial", "--final"], "partial and final are both given"),
        (["--interpreter", "python3"], "interpreter is given without tests"),
        (["--minimum", "101"], "options: minimum: found 101.0, expected a number from 0 to 100"),
        (["--minimum", "nan"], "'nan' is not a finite number"),
        (["--commit", "main"], "commit: found 'main', expected a hash of 40 hexadecimal digits"),
        (["--directory", "none"], "none: there is no such folder"),
        (["--source", "none"], "source: none: no source file was found there"),
        (["--base", "nowhere"], "base nowhere: no such commit is in this checkout"),
        (["--minimum-change", "80"], "there is no base to compare with"),
        (["--minimum-functions-change", "80"], "there is no base to compare with"),
        (["--max-pseudo-tested", "0"], "pseudo-tested: found all without tests"),
        (
            ["--run", "x", "--max-pseudo-tested", "0", "--pseudo-tested", "change"],
            "pseudo-tested: found change, expected all",
        ),
        (
            ["--run", "x", "--max-pseudo-tested-change", "0", "--pseudo-tested", "none"],
            "expected change or all for its limit",
        ),
        (["--run", "x", "--max-pseudo-tested-change", "0"], "there is no base to compare with"),
        (["--run", "pytest", "--pseudo-tested", "all", "--pseudo-tested-budget", "soon"], "budget: found 'soon', exp"),
        (["--run", "pytest", "--timeout", "soon"], "timeout: found 'soon', expected a time such as 90s"),
        (["--run", "no-such-program"], "there is no program 'no-such-program'"),
        (["--api-url", "http://example.org"], "api-url: found 'http://example.org', expected https"),
        (["--exclude", "**/naming.py"], "no executable line was found: the reports contain no file that counts"),
    ],
)
def test_errors_are_reported(
    server: projects.Codacy, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    assert upload(*arguments) == 2
    err = capsys.readouterr().err
    assert message in err
    assert len(err.splitlines()) == 1
    assert server.asked == []


@pytest.mark.parametrize(
    ("report", "message"),
    [
        ("*.xml", "*.xml: no file matches this pattern"),
        ("none.xml", "none.xml: a data file of coverage.py, Cobertura XML, LCOV or JSON of gcov was expected"),
        ("robot/naming.py", "robot/naming.py: found none of the known forms"),
        (
            "foreign.info",
            "that counts (source, exclude); in reports, but no file that git tracks: /usr/include/x.h",
        ),
    ],
)
def test_reports_that_are_none(capsys: pytest.CaptureFixture[str], report: str, message: str) -> None:
    write(Path(), {"foreign.info": "SF:/usr/include/x.h\nDA:1,1\nend_of_record\n"})
    assert upload("--service", "none", reports=report) == 2
    assert message in capsys.readouterr().err


def test_neither_tests_nor_reports(capsys: pytest.CaptureFixture[str]) -> None:
    assert upload(reports=None) == 2
    assert "neither run nor reports is given" in capsys.readouterr().err


def test_a_folder_within_the_repository(server: projects.Codacy, root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = {"packages/arm/src/arm.py": NAMING, "packages/arm/reports/c.xml": XML.replace("robot/naming", "src/arm")}
    commit(root, package)
    monkeypatch.chdir("/")
    directory = str(root / "packages/arm")
    assert upload("--directory", directory, "--source", "src", reports="reports/*.xml") == 0
    assert b'{"filename":"packages/arm/src/arm.py",' in server.asked[0].body
    assert b"robot/naming" not in server.asked[0].body


def test_results_of_an_earlier_run_are_removed_first(capsys: pytest.CaptureFixture[str]) -> None:
    assert upload("--service", "none", "--output", "out") == 0
    assert upload("--service", "none", "--output", "out", "--source", "none") == 2
    assert list(Path("out").iterdir()) == []
    Path("out/results.json").mkdir()
    capsys.readouterr()
    assert upload("--service", "none", "--output", "out") == 3
    assert "out/results.json: an earlier result cannot be removed" in capsys.readouterr().err


def test_names_that_try_to_command_the_runner(root: Path, on_github: Any, capsys: pytest.CaptureFixture[str]) -> None:
    evil = "::error::evil,x.py"
    commit(root, {evil: "a = 1\n"})
    on_github("push", {}, GITHUB_SHA="d" * 40)
    write(
        Path(),
        {"c.info": "SF:/usr/::warning::evil\nDA:1,1\nend_of_record\nSF:robot/naming.py\nDA:1,1\nend_of_record\n"},
    )
    assert upload("--service", "none", "--base", "HEAD~1", reports="c.info") == 0
    obeyed, stopped = [], None
    for line in capsys.readouterr().out.splitlines():
        if stopped is None and line.startswith("::stop-commands::"):
            stopped = line.removeprefix("::stop-commands::")
        elif stopped is not None and line == f"::{stopped}::":
            stopped = None
        elif stopped is None and line.startswith("::"):
            obeyed.append(line)
    assert obeyed == [
        "::warning file=%3A%3Aerror%3A%3Aevil%2Cx.py,line=1,title=not covered::no test runs line 1 of this change"
    ]


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_stops_the_tests(root: Path, number: signal.Signals) -> None:
    test = "import os, time\ndef test():\n    print('pid', os.getpid(), flush=True)\n    time.sleep(60)\n"
    commit(root, {"tests/test_naming.py": test})
    code = (
        "import sys; from calibration import __main__ as m; "
        "m.COMMANDS['coverage-upload'] = m.LazyCommand('calibration.addons.coverage.coverage_upload:command', ''); "
        "sys.exit(m.main())"
    )
    run = "pytest -s -q -p no:cacheprovider"
    arguments = [NAME, "--run", run, "--interpreter", sys.executable, "--service", "none", "--output", "out"]
    with subprocess.Popen(
        [sys.executable, "-c", code, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        pid = next(int(line.split()[-1]) for line in process.stdout if " pid " in line)
        process.send_signal(number)
        assert f"error: stopped by {number.name}" in process.stderr.read()
    assert process.returncode == 128 + number
    assert not runs(pid)
    assert not Path("out/results.json").exists()


def test_without_a_service_nothing_is_uploaded(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([NAME, "--reports", "../c.xml"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "pass: 66.6 % (4 of 6) of the lines are run"


@pytest.mark.parametrize("option", ["--partial", "--final", "--dry-run", ""])
def test_options_of_a_service_without_the_service_are_errors(
    option: str,
    server: projects.Codacy,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    root: Path,
) -> None:
    if option:
        monkeypatch.delenv("CODACY_PROJECT_TOKEN")
    assert main([NAME, "--reports", "../c.xml", *filter(None, [option])]) == 2
    name = option.removeprefix("--") or "project-token"
    assert f"error: {name} is given without a service: add service: codacy" in capsys.readouterr().err
    assert server.asked == []


def test_no_secret_in_the_representation_of_the_settings() -> None:
    assert TOKEN not in repr(CoverageSettings(project_token=TOKEN, api_token=TOKEN))
