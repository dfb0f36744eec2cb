from pathlib import Path
from typing import Any

import click
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.commands import parameters


@pytest.mark.parametrize("text", ["true", "True", "YES", "yes", "1", " true "])
def test_true(text: str) -> None:
    assert parameters.boolean(text) is True


@pytest.mark.parametrize("text", ["false", "FALSE", "No", "0"])
def test_false(text: str) -> None:
    assert parameters.boolean(text) is False


@pytest.mark.parametrize("text", ["", "on", "2", "maybe", "truee"])
def test_neither_true_nor_false(text: str) -> None:
    with pytest.raises(click.BadParameter, match="is neither true nor false"):
        parameters.boolean(text)


@pytest.mark.parametrize(
    ("read", "text", "value"),
    [
        (parameters.number, "-1.5", -1.5),
        (parameters.number, " 2\n", 2.0),
        (parameters.non_negative, "0", 0.0),
        (parameters.integer, "-3", -3),
        (parameters.count, "1", 1),
        (parameters.text, " a b \n", "a b"),
        (parameters.path, "a b/c", Path("a b/c")),
        (parameters.TEXT_LIST, " a b ,\n\nc,", ("a b", "c")),
        (parameters.list_of(parameters.number), "0,-0.5\n1", (0.0, -0.5, 1.0)),
        (parameters.list_of(parameters.non_negative), "0, 0.5", (0.0, 0.5)),
        (parameters.INTEGER_LIST, "3,7", (3, 7)),
        (parameters.PATH_LIST, "a\nb c\n", (Path("a"), Path("b c"))),
        (parameters.TEXT_LIST, "", ()),
        (parameters.TEXT_LIST, " ,\r\n", ()),
        (parameters.INTEGER_LIST, (3, 7), (3, 7)),
    ],
)
def test_values(read: Any, text: str, value: object) -> None:
    assert read(text) == value


@pytest.mark.parametrize(
    ("read", "text"),
    [
        (parameters.number, "x"),
        (parameters.number, ""),
        (parameters.number, "nan"),
        (parameters.number, "inf"),
        (parameters.number, "1e999"),
        (parameters.non_negative, "-0.1"),
        (parameters.integer, "1.0"),
        (parameters.integer, ""),
        (parameters.count, "0"),
        (parameters.list_of(parameters.number), "1,x"),
        (parameters.list_of(parameters.non_negative), "1,-1"),
        (parameters.INTEGER_LIST, "1;2"),
    ],
)
def test_wrong_values(read: Any, text: str) -> None:
    with pytest.raises(click.BadParameter, match=r"is not a|is below"):
        read(text)


@given(st.lists(st.text(st.characters(blacklist_characters=",\r\n"), min_size=1).map(str.strip).filter(bool)))
def test_lists_read_back_from_either_separator(items: list[str]) -> None:
    assert parameters.TEXT_LIST(",".join(items)) == tuple(items)
    assert parameters.TEXT_LIST("\n".join(items)) == tuple(items)


@pytest.mark.parametrize(
    ("arguments", "value"),
    [
        ([], False),
        (["--flag"], True),
        (["--flag", "--other", "x"], True),
        (["--flag", "no"], False),
        (["--flag=TRUE"], True),
        (["--flag", "0", "--other", "x"], False),
    ],
)
def test_boolean_option(arguments: list[str], value: bool) -> None:
    @click.command
    @parameters.boolean_option("--flag", help="A flag.")
    @click.option("--other")
    def command(flag: bool, other: str | None) -> bool:
        return flag

    with command.make_context("command", arguments) as context:
        assert command.invoke(context) is value
