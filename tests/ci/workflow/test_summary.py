import html
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from markdown_it import MarkdownIt

from calibration.base import InfrastructureError, code_block, escape_markdown, markdown_table, visible
from calibration.ci.workflow import Runner, add_summary
from calibration.ci.workflow.runner import MAX_SUMMARY_BYTES


def written(runner: Runner) -> str:
    assert runner.summary_file is not None
    return runner.summary_file.read_text()


def unescape(text: str) -> str:
    def character(match: re.Match[str]) -> str:
        return "\n" if match[0] == "<br>" else match[1] or html.unescape(match[0])

    return re.sub(r"<br>|&[a-z]+;|&#\d+;|\\(.)", character, text)


@given(st.text(st.characters(blacklist_characters="\r")))
def test_escaping_is_undone_by_markdown(text: str) -> None:
    assert unescape(escape_markdown(text)) == visible(text)


HOSTILE = ["a|b", "`x`", "<script>", "[x](http://y)", "**b**", "a\nb", "\\|", "\\", "$x$", "&lt;", "#", "~~x~~", "a_b"]


@pytest.mark.parametrize("cell", HOSTILE)
def test_a_renderer_shows_the_cell_as_it_is(cell: str) -> None:
    table = markdown_table(["h", "i"], [[cell, "last"]])
    rendered = MarkdownIt("commonmark", {"html": True}).enable(["table", "strikethrough"]).render(table)
    cells = re.findall(r"<td>(.*?)</td>", rendered, re.DOTALL)
    assert [html.unescape(text.replace("<br>", "\n")) for text in cells] == [cell, "last"]


def test_table() -> None:
    assert markdown_table(["a", "b"], [["1", "x|y"], ["2", ""]]) == (
        "| a | b |\n| --- | --- |\n| 1 | x&#124;y |\n| 2 |  |\n"
    )


def test_code_block_cannot_be_left() -> None:
    assert code_block("x") == "```\nx\n```\n"
    assert code_block("a\n```\nb\n````\n") == "`````\na\n```\nb\n````\n`````\n"


def test_summaries_are_appended(github: Runner) -> None:
    add_summary(github, "# one\n")
    add_summary(github, "two")
    assert written(github) == "# one\ntwo\n"


def test_a_long_summary_is_cut_at_a_line_and_says_so(github: Runner) -> None:
    add_summary(github, "first\n")
    add_summary(github, "ä line of text\n" * 100_000)
    text = written(github)
    assert MAX_SUMMARY_BYTES - 100 < len(text.encode()) <= MAX_SUMMARY_BYTES
    *lines, note = text.rstrip().split("\n")
    assert "cut" in note
    assert set(lines) == {"first", "ä line of text", ""}


def test_a_long_line_is_cut_between_characters(github: Runner) -> None:
    add_summary(github, "ä" * MAX_SUMMARY_BYTES)
    assert len(written(github).encode()) <= MAX_SUMMARY_BYTES
    assert "cut" in written(github)


def test_nothing_is_added_to_a_full_summary(github: Runner) -> None:
    for _ in range(3):
        add_summary(github, "x" * MAX_SUMMARY_BYTES)
    assert len(written(github).encode()) <= MAX_SUMMARY_BYTES


def test_exactly_the_limit_is_not_cut(github: Runner) -> None:
    add_summary(github, "x" * (MAX_SUMMARY_BYTES - 1))
    assert len(written(github)) == MAX_SUMMARY_BYTES
    assert "cut" not in written(github)


def test_without_a_runner_nothing_is_written() -> None:
    add_summary(Runner(), "text")


def test_a_file_that_cannot_be_written_is_an_infrastructure_error(tmp_path: Path) -> None:
    with pytest.raises(InfrastructureError, match=f"{tmp_path}: the step's summary cannot be written"):
        add_summary(Runner(summary_file=tmp_path), "text")


def test_only_what_begins_a_text_begins_a_list() -> None:
    assert escape_markdown("seed 1. 2) - 3.") == "seed 1. 2) - 3."
    assert [escape_markdown(text) for text in ("1. a", " 12) b", "- c", "7.")] == [
        "1\\. a",
        " 12\\) b",
        "\\- c",
        "7\\.",
    ]
