import io

import pytest

from calibration.base import ExitCode, InfrastructureError, InputError
from calibration.ci.github.service import GITHUB
from calibration.ci.image.build_request import (
    MAX_LAST_LINES,
    MAX_LINE_CHARACTERS,
    BuildFailedError,
    BuildLog,
    build_problem,
)
from calibration.ci.image.builders import BuildKitOutput
from calibration.ci.workflow import Runner

OLD = """#1 [internal] load build definition from Dockerfile
#1 transferring dockerfile: 32B done
#5 [1/3] FROM docker.io/library/debian:bookworm
#6 [2/3] RUN echo one; sleep 1
#7 [other 1/1] RUN echo elsewhere
#6 0.312 one
#7 0.313 elsewhere
#6 DONE 1.0s
#8 [3/3] RUN echo two;  exit 3
#7 0.400 again
#8 0.201 two
#8 ERROR: executor failed running [/bin/sh -c echo two;  exit 3]: exit code: 3
------
 > [3/3] RUN echo two;  exit 3:
#8 0.201 two
------
executor failed running [/bin/sh -c echo two;  exit 3]: exit code: 3
"""
NEW = """#0 building with "default" instance using docker driver
#5 [1/2] FROM docker.io/library/debian:bookworm
#6 [2/2] RUN exit 4
#6 ERROR: process "/bin/sh -c exit 4" did not complete successfully: exit code: 4
------
ERROR: failed to solve: process "/bin/sh -c exit 4" did not complete successfully: exit code: 4
"""
EARLY = """#1 [internal] load build definition from Dockerfile
#1 ERROR: failed to read dockerfile: open /tmp/x: no such file or directory
"""


@pytest.fixture
def runner() -> Runner:
    return Runner(GITHUB, stdout=io.StringIO())


def make(runner: Runner, *secrets: str) -> BuildLog:
    return BuildLog(runner, lambda done, total, line, important=False: runner.log(f"[{done}/{total}] {line}"), secrets)


def written(runner: Runner) -> list[str]:
    assert isinstance(runner.stdout, io.StringIO)
    return runner.stdout.getvalue().splitlines()


def test_lines_are_shown_when_they_are_complete(runner: Runner) -> None:
    log = make(runner)
    log.output("one\ntw")
    assert written(runner) == ["    one"]
    log.output("o\n\n10%\r50%\r100%\r\nend")
    log.end_line()
    assert written(runner) == ["    one", "    two", "    100%", "    end"]


def test_output_contains_no_workflow_commands_and_no_secrets(runner: Runner) -> None:
    log = make(runner, "hunter2-hunter2")
    log.step(1, 2, "RUN curl -H 'token: hunter2-hunter2'")
    log.output("\x1b[91mred\x1b[0m \x1b]0;title\x07 ##[error] hunter2-hunter2\n")
    text = "\n".join(written(runner))
    assert "hunter2" not in text + log.step_name
    assert "red" in text
    assert "\x1b" not in text
    assert "##[" not in text


def test_only_the_last_lines_of_the_step_are_kept(runner: Runner) -> None:
    log = make(runner)
    log.output("before\n")
    log.step(2, 3, "RUN  make \n all")
    assert log.step_name == "step 2 of 3, RUN make all"
    log.output("".join(f"{i}\n" for i in range(100)) + "x" * 10_000 + "\n")
    assert list(log.last_lines)[:-1] == [str(i) for i in range(100 - MAX_LAST_LINES + 1, 100)]
    assert len(log.last_lines[-1]) == MAX_LINE_CHARACTERS


def test_a_line_without_end_is_not_kept_for_ever(runner: Runner) -> None:
    log = make(runner)
    for _ in range(200):
        log.output("x" * 1000)
    assert 1 < len(written(runner)) < 10


def test_a_terminal_has_a_bar_and_no_output(runner: Runner) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    terminal = Runner(stdout=Terminal())
    log = make(terminal)
    log.output("one\n")
    assert written(terminal) == []
    assert list(log.last_lines) == ["one"]


@pytest.mark.parametrize(
    ("text", "step", "problem", "lines"),
    [
        (OLD, "step 3 of 3, RUN echo two; exit 3", "exit code 3", ["two"]),
        (NEW, "step 2 of 2, RUN exit 4", "exit code 4", []),
        (EARLY, "", "failed to read dockerfile: open /tmp/x: no such file or directory", []),
        ("unknown flag: --progress\nSee 'docker build --help'.\n", "", "unknown flag: --progress", None),
        ("#1 [1/1] RUN x\nError response from daemon: dockerfile parse error line 2\n", "", "Error response", None),
    ],
)
def test_errors_of_buildkit(runner: Runner, text: str, step: str, problem: str, lines: list[str] | None) -> None:
    log = make(runner)
    reader = BuildKitOutput(log)
    for line in text.splitlines():
        reader.read(line)
    assert reader.failed_step == step
    assert reader.problem.startswith(problem)
    if lines is not None:
        assert list(log.last_lines) == lines


@pytest.mark.parametrize(
    ("message", "kind"),
    [
        ("exit code 3", BuildFailedError),
        ("COPY failed: file not found in build context", BuildFailedError),
        ("dockerfile parse error line 2: unknown instruction: FORM", BuildFailedError),
        ("write /var/lib/docker/x: no space left on device", InfrastructureError),
        ("failed to create endpoint x on network bridge: could not find bridge docker0", InfrastructureError),
        ("Get https://r/v2/: dial tcp: lookup r: no such host", InfrastructureError),
        ("toomanyrequests: You have reached your pull rate limit", InfrastructureError),
        ("manifest for x:1 not found: manifest unknown: manifest unknown", InputError),
        ("pull access denied for x, repository does not exist", InputError),
    ],
)
def test_whose_fault_it_is(runner: Runner, message: str, kind: type) -> None:
    log = make(runner)
    log.output("last words")
    error = build_problem("robot", "step 1 of 2, RUN x", message, log)
    assert type(error) is kind
    assert message in str(error)
    if isinstance(error, BuildFailedError):
        assert error.exit_code == ExitCode.FAIL
        assert error.lines == ("last words",)
        assert str(error) == f"image robot: step 1 of 2, RUN x: {message}; its last line: last words"


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (
            ["main.cpp:3:1: error: unknown type name 'x'", "1 error generated.", "make: *** [all] Error 1"],
            "its first error: main.cpp:3:1: error: unknown type name 'x'; its last line: make: *** [all] Error 1",
        ),
        (["Reading package lists...", "E: Unable to locate package x"], "its last line: E: Unable to locate package x"),
        (
            ["ERROR: No matching distribution found for x", "[notice] a new release of pip"],
            "its first error: ERROR: No matching distribution found for x; its last line: [notice] a",
        ),
        (
            ["CMake Error at CMakeLists.txt:3 (find_package):", "-- Configuring incomplete, errors occurred!"],
            "its first error: CMake Error at CMakeLists.txt:3 (find_package):; its last line: -- Configuring",
        ),
        (["no errors so far", "done"], "its last line: done"),
    ],
)
def test_the_error_above_the_last_line_is_quoted(runner: Runner, lines: list[str], said: str) -> None:
    log = make(runner)
    log.output("\n".join(lines))
    assert f"exit code 1; {said}" in str(build_problem("robot", "step 1 of 2, RUN x", "exit code 1", log))
