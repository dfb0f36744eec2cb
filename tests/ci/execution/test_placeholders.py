import shlex

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base import InputError
from calibration.ci.execution.job import fill, split_command


def test_each_argument_by_itself() -> None:
    values = {"seed": "3", "output": "/a b/$(reboot); {seed}"}
    filled = fill(["run", "--seed={seed}", "{output}/x", "{{seed}}", "{{{seed}}}"], values, "command")
    # spaces, commands and placeholders in a value have no effect
    assert filled == ("run", "--seed=3", "/a b/$(reboot); {seed}/x", "{seed}", "{3}")


@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ("{sead}", "systems.a.command: there is no placeholder '{sead}': did you mean 'seed'? (known: seed, output"),
        ("{}", "there is no placeholder '{}'"),
        ("${HOME}", "there is no placeholder '{HOME}'"),
        ("a { b", "a single '{' in 'a { b': write {{ for a brace"),
        ("a } b", "a single '}'"),
    ],
)
def test_invalid_placeholders(argument: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        fill(["true", argument], {"seed": "1", "output": "/o"}, "systems.a.command")
    assert message in str(caught.value)


@given(st.lists(st.text()), st.text())
def test_doubled_braces_give_back_any_text(arguments: list[str], value: str) -> None:
    escaped = [argument.replace("{", "{{").replace("}", "}}") for argument in arguments]
    assert fill(escaped, {"x": value}, "c") == tuple(arguments)
    assert fill(["{x}"], {"x": value}, "c") == (value,)


def test_a_text_is_split_as_a_shell_would() -> None:
    assert split_command("rosrun a 'b c' \"d\"", "command") == ("rosrun", "a", "b c", "d")
    assert split_command(["a b", ""], "command") == ("a b", "")


@given(st.lists(st.text(st.characters(exclude_characters="\0")), min_size=1))
def test_split_inverts_join(arguments: list[str]) -> None:
    assert split_command(shlex.join(arguments), "command") == tuple(arguments)


@pytest.mark.parametrize("command", ["a 'b", "", "  ", [], ["a", 1], ["a\0"], "a\0b"])
def test_no_command(command: object) -> None:
    with pytest.raises(InputError, match=r"^command: "):
        split_command(command, "command")  # type: ignore[arg-type]
