"""Text of a comment: verdict and tables, with untrusted text deactivated."""

import re
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from markdown_it import MarkdownIt

from calibration.base import InputError
from calibration.ci.github.comments import MAX_ROWS_OF_TABLE, MAX_TEXT_CHARACTERS, comment_text
from calibration.ci.report.report import Brief, BriefTable, read_brief

LINKS = {"run": "https://github.com/me/robot/actions/runs/1"}
TABLE = ("table", "thead", "tbody", "tr", "th", "td")
HOSTILE = st.one_of(
    st.text(),
    st.lists(
        st.sampled_from(
            [
                *("@team", "#1", "me/robot#3", "GH-2", "fixes #4", "https://evil.example", "www.evil.example"),
                *("mailto:a@b.example", "[x](https://evil.example)", "![x](//evil)", "<!--", "-->", "&lt;"),
                *("<script>", "</script>", "<img src=x onerror=alert(1)>", "`", "```\n", "|", "\\", "\n", "\r\n"),
                *("* ", "# ", "_", "1. ", "- ", "+ ", "---", "    ", "a", " ", "\u202e"),
            ]
        )
    ).map("".join),
)


def rendered(markdown: str) -> str:
    """Render as GitHub's Markdown, before it detects mentions, references and links in the text."""
    return MarkdownIt("commonmark", {"html": True}).enable(["table", "strikethrough"]).render(markdown)


@example("    |", "    |", "    |")
@example("", "0.     |", "")
@example("", "-      |", "1)     |")
@given(HOSTILE, HOSTILE, HOSTILE)
def test_nothing_that_a_stranger_wrote_is_active(sentence: str, reason: str, cell: str) -> None:
    table = BriefTable(("System", cell), ((cell, "1.0 px"), ("robot", cell)))
    brief = Brief(verdict="fail", sentence=sentence, reasons=(reason,), tables=(table,))
    html = rendered(comment_text(brief, cell[:50], {}))
    tags = {tag.strip("/").split()[0] for tag in re.findall(r"<([^>]*)>", html)}
    assert tags <= {"h3", "p", "ul", "ol", "li", "hr", "pre", "code", "br", *TABLE}
    text = re.sub(r"<[^>]*>", " ", html)
    assert not re.search(r"@\w|#\d|://|www\.|GH-\d", text, re.IGNORECASE)
    assert html.count("<tr>") == 3


def test_lines_follow_the_tables_as_text() -> None:
    brief = Brief(verdict="pass", sentence="", lines=("Findings: 0", "unit-tests: @team <b>312</b> tests passed"))
    items = re.findall(r"<li>(.*?)</li>", rendered(comment_text(brief, "", LINKS)))
    assert items == ["Findings: 0", "unit-tests: @\u200bteam &lt;b&gt;312&lt;/b&gt; tests passed"]


def test_a_comment_has_verdict_reasons_tables_and_links() -> None:
    table = BriefTable(("Start", "robot"), (("0 m, 0 rad", "0.2 px"),))
    brief = Brief(verdict="fail", sentence="1 of 1 cell failed", reasons=("robot: too far",), tables=(table,))
    text = comment_text(brief, "arm", LINKS, "0123456789abcdef")
    assert text.startswith(
        "### ❌ Calibration (arm): fail\n\n1 of 1 cell failed\n\n- robot: too far\n\n| Start | robot |"
    )
    assert text.endswith("\n[run](https://github.com/me/robot/actions/runs/1) · 0123456\n")
    assert comment_text(Brief(verdict="pass", sentence=""), "", {}).startswith("### ✅ Calibration: pass\n")
    undecided = Brief(verdict="undecided", sentence="1 of 1 cell undecided", about="Commit 0123456 of 2026-11-25")
    assert comment_text(undecided, "", {}).startswith(
        "### 🟡 Calibration: undecided\n\n1 of 1 cell undecided\n\nCommit 0123456 of 2026-11-25\n"
    )


def test_an_address_cannot_end_its_link_early() -> None:
    text = comment_text(Brief(verdict="pass", sentence=""), "", {"report": "https://a.example/x) [y](https://evil"})
    assert rendered(text).count("<a ") == 1


def test_truncation_is_stated() -> None:
    table = BriefTable(("Start",), (("x",),) * (MAX_ROWS_OF_TABLE + 3))
    brief = Brief(verdict="fail", sentence="", reasons=("why",) * 100, tables=(table,))
    text = comment_text(brief, "", {})
    assert text.count("- why\n") == 100
    assert "\nand 3 more\n" in text
    huge = BriefTable(("c",) * 30, (("y" * 200,) * 30,) * 40)
    text = comment_text(Brief(verdict="fail", sentence="", tables=(huge,)), "", LINKS)
    assert len(text) < MAX_TEXT_CHARACTERS + 300
    assert "*Truncated" in text
    assert text.endswith("[run](https://github.com/me/robot/actions/runs/1)\n")


def test_a_report_in_brief_is_read_as_it_was_written(tmp_path: Path) -> None:
    table = BriefTable(("Start", "robot"), (("0 m, 0 rad", "0.2 px"),))
    brief = Brief(verdict="fail", sentence="x", reasons=("a", "b"), tables=(table, table))
    (tmp_path / "comment.json").write_text(brief.text)
    assert read_brief(tmp_path / "comment.json") == brief


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("[]", "expected"),
        ("{", "this is no JSON"),
        ('{"schema": 1, "verdict": "maybe", "sentence": ""}', "verdict: found 'maybe'"),
        ('{"schema": 1, "verdict": "pass", "sentence": 3}', "sentence: found 3"),
        (
            '{"schema": 1, "verdict": "pass", "sentence": "", "tables": [{"columns": ["a"], "rows": [["b", "c"]]}]}',
            "a row that is not as long as its header",
        ),
        ('{"schema": 1, "schema": 1, "verdict": "pass", "sentence": ""}', "schema"),
        ("[" * 100_000, "this is no JSON"),
        (" " * (4 * 1024**2 + 1), "at most 4194304 was expected"),
    ],
)
def test_invalid_brief_reports_are_one_line(tmp_path: Path, content: str, expected: str) -> None:
    path = tmp_path / "comment.json"
    path.write_text(content)
    with pytest.raises(InputError) as error:
        read_brief(path)
    assert expected in str(error.value)
    assert len(str(error.value).replace(str(path), "")) < 300
