import io

import pytest

from calibration.ci.workflow import Runner, group, stop_commands
from tests.ci.workflow.conftest import printed


def test_group(github: Runner, laptop: Runner) -> None:
    for runner in (github, laptop):
        with group(runner, "a\ntitle"):
            runner.log("inside")
    assert printed(github) == "::group::a title\ninside\n::endgroup::\n"
    assert printed(laptop) == "a title\ninside\n"


def test_a_group_ends_when_its_content_fails(github: Runner) -> None:
    with pytest.raises(ZeroDivisionError), group(github, "t"):
        raise ZeroDivisionError
    assert printed(github).endswith("::endgroup::\n")


def obeyed(log: str) -> list[str]:
    """Return the commands that the runner would obey in a log."""
    token, commands = None, []
    for line in log.splitlines():
        if token is None and line.startswith("::stop-commands::"):
            token = line.removeprefix("::stop-commands::")
        elif token is not None and line == f"::{token}::":
            token = None
        elif token is None and line.startswith("::"):
            commands.append(line)
    return commands


def test_foreign_output_commands_nothing(github: Runner) -> None:
    with stop_commands(github):
        github.log("::add-mask::a\n::endgroup::\n::stop-commands::x\n::x::\n::error::no")
    github.log("::error::yes")
    assert obeyed(printed(github)) == ["::error::yes"]


def test_commands_are_obeyed_again_after_output_without_a_line_end(github: Runner) -> None:
    with stop_commands(github):
        github.stdout.write("half a line")
    github.log("::error::yes")
    assert obeyed(printed(github)) == ["::error::yes"]


def test_commands_are_obeyed_again_after_a_failure(github: Runner) -> None:
    with pytest.raises(ZeroDivisionError), stop_commands(github):
        raise ZeroDivisionError
    github.log("::error::yes")
    assert obeyed(printed(github)) == ["::error::yes"]


def test_tokens_are_random(github: Runner) -> None:
    for _ in range(2):
        with stop_commands(github):
            pass
    tokens = [line for line in printed(github).splitlines() if line.startswith("::stop-commands::")]
    assert len(set(tokens)) == 2
    assert all(len(token) > 40 for token in tokens)


def test_another_stream(github: Runner) -> None:
    stream = io.StringIO()
    with stop_commands(github, stream):
        print("::error::no", file=stream)
    assert printed(github) == ""
    assert obeyed(stream.getvalue()) == []


def test_off_github_nothing_is_added(laptop: Runner) -> None:
    with stop_commands(laptop):
        laptop.log("x")
    assert printed(laptop) == "x\n"
