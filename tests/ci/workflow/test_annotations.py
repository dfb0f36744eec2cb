from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.ci.github.service import escape_data, escape_property, workflow_command
from calibration.ci.workflow import Annotation, Level, Runner, annotate, report_error
from tests.ci.workflow.conftest import complained, printed


def unescape(text: str, *, is_property: bool) -> str:
    """Undo the escapes one after the other, as the runner does."""
    for code, character in [("%0D", "\r"), ("%0A", "\n")] + [("%3A", ":"), ("%2C", ",")] * is_property:
        text = text.replace(code, character)
    return text.replace("%25", "%")


@given(st.text())
def test_escaping_is_undone_by_the_runner(text: str) -> None:
    assert unescape(escape_data(text), is_property=False) == text
    assert unescape(escape_property(text), is_property=True) == text


@given(st.text(alphabet="%0DA235C\r\n:,"))
def test_escaped_text_stays_in_its_place(text: str) -> None:
    assert not set(escape_data(text)) & set("\r\n")
    assert not set(escape_property(text)) & set("\r\n:,")


def test_workflow_command() -> None:
    assert workflow_command("error", "50% of\nit", file="a,b:c.csv", line=3, title=None) == (
        "::error file=a%2Cb%3Ac.csv,line=3::50%25 of%0Ait"
    )
    assert workflow_command("endgroup") == "::endgroup::"


def test_on_github_annotations_are_commands(github: Runner, workspace: Path) -> None:
    annotate(github, [Annotation("too large", file=workspace / "a.csv", line=4, title="x: y")])
    annotate(github, [Annotation("hm", Level.WARNING)])
    assert printed(github) == "::error file=a.csv,line=4,title=x%3A y::too large\n::warning::hm\n"
    assert complained(github) == ""


@pytest.mark.parametrize("character", ["\x1b", "\x07", "\u2028", "\u2029", "\x85", "\x0b", "\u202e"])
def test_no_part_of_an_annotation_commands_a_terminal(github: Runner, character: str) -> None:
    text = f"a{character}b"
    annotate(github, [Annotation(text, file=text, line=4, title=text)])
    assert character not in printed(github)
    assert printed(github).count(character.encode("unicode_escape").decode()) == 3


def test_no_part_of_an_annotation_commands_the_runner(github: Runner) -> None:
    annotate(github, [Annotation("##[error]a", file="##[error]a", title="##[error]a")])
    assert printed(github) == "::error file=## [error]a,title=## [error]a::## [error]a\n"


@pytest.mark.parametrize(("count", "commands"), [(8, 8), (9, 9), (10, 10), (300, 10)])
def test_on_github_at_most_ten_are_printed(github: Runner, count: int, commands: int) -> None:
    annotate(github, [Annotation(f"number {number}") for number in range(count)])
    lines = printed(github).splitlines()
    assert len(lines) == commands
    if count > 9:
        assert lines[:9] == [f"::error::number {number}" for number in range(9)]
        assert lines[9].startswith(f"::error::and {count - 9} more")


def test_each_level_has_its_own_ten(github: Runner) -> None:
    annotate(github, [Annotation("e")] * 12 + [Annotation("w", Level.WARNING)] * 2)
    assert printed(github).count("::error::") == 10
    assert printed(github).count("::warning::") == 2


def test_off_github_annotations_are_plain_lines(laptop: Runner) -> None:
    annotate(
        laptop,
        [
            Annotation("too\nlarge", file="a.csv", line=4),
            Annotation("odd", Level.WARNING, file="a.csv"),
            Annotation("nowhere", line=7),
        ],
    )
    assert complained(laptop) == "error: a.csv:4: too large\nwarning: a.csv: odd\nerror: nowhere\n"
    assert printed(laptop) == ""


def test_off_github_none_is_left_out(laptop: Runner) -> None:
    annotate(laptop, [Annotation("x")] * 50)
    assert len(complained(laptop).splitlines()) == 50


def test_report_error(github: Runner, laptop: Runner) -> None:
    for runner in (github, laptop):
        report_error(runner, "a.csv: is\nwrong: 100%")
        assert complained(runner) == "error: a.csv: is wrong: 100%\n"
    assert printed(github) == "::error::a.csv: is wrong: 100%25\n"
    assert printed(laptop) == ""
