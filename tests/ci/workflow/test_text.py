import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base import aligned, did_you_mean, markdown_table, one_line, shorten, without_escapes


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("plain", "plain"),
        ("two\nlines", "two lines"),
        ("a  \r\n\n  b", "a b"),
        ("a\u2028b", "a b"),
        ("\x1b[31mred", "\\x1b[31mred"),
        ("##[add-mask]x", "## [add-mask]x"),
        ("right\u202eleft", "right\\u202eleft"),
        ("half \ud800", "half \\ud800"),
        ("°µ ok", "°µ ok"),
    ],
)
def test_one_line(text: str, line: str) -> None:
    assert one_line(text) == line


@given(st.text())
def test_one_line_never_breaks_and_never_commands(text: str) -> None:
    line = one_line(text)
    assert len(line.splitlines()) <= 1
    assert "##[" not in line
    assert not any(ord(character) < 32 and character != "\t" for character in line)
    line.encode()


@pytest.mark.parametrize(
    ("text", "plain"),
    [
        ("\x1b]2;/ws/src/arm.launch http://robot:11311\x07[INFO] up", "[INFO] up"),  # roslaunch
        ("\x1b]0;title\x1b\\up", "up"),
        ("\x1b[1;31m[ERROR]\x1b[0m \x1b[38:5:1mred\x1b[K", "[ERROR] red"),
        ("\x1b(Bplain\x1b=\x1b7", "plain"),
        ("\x1b]0;without an end", "\x1b]0;without an end"),
    ],
)
def test_sequences_for_terminals_are_removed(text: str, plain: str) -> None:
    assert without_escapes(text) == plain


def test_shorten() -> None:
    assert shorten("12345", 5) == "12345"
    assert shorten("123456", 5) == "1234…"


def test_did_you_mean() -> None:
    assert did_you_mean("colum", ["row", "column"]) == ": did you mean 'column'?"
    assert did_you_mean("xyz", ["row", "column"]) == ""


def test_a_table_commands_nothing_in_its_header_and_its_cells() -> None:
    assert aligned(("a\n::error::x", "b"), [("c", "##[error]d")]) == "a ::error::x  b\nc             ## [error]d"


def test_a_cell_is_shortened() -> None:
    name = "x" * 100_000
    assert max(map(len, aligned((name, "b"), [("c", name)]).splitlines())) < 500
    assert len(markdown_table((name, "b"), [("c", name)])) < 1000


@pytest.mark.parametrize("character", "\u061c\u200b\u200e\u200f\u2060\u2066\ufeff\U000e0041")
def test_characters_that_mislead_are_escaped_in_tables_too(character: str) -> None:
    assert character not in aligned((character,), [(character,)]) + markdown_table((character,), [(character,)])
