from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base import InfrastructureError
from calibration.ci.workflow import Runner, set_outputs


def parse(text: str) -> dict[str, str]:
    """Read a file of outputs as the runner does."""
    lines = iter(text.split("\n")[:-1])
    values = {}
    for line in lines:
        equals, heredoc = line.find("="), line.find("<<")
        if equals >= 0 and (heredoc < 0 or equals < heredoc):
            values[line[:equals]] = line[equals + 1 :]
        else:
            name, delimiter = line.split("<<", 1)
            body = []
            while (line := next(lines)) != delimiter:
                body.append(line)
            values[name] = "\n".join(body)
    return values


def written(runner: Runner) -> dict[str, str]:
    assert runner.output_file is not None
    return parse(runner.output_file.read_bytes().decode())


def test_values_are_written_as_later_steps_expect_them(github: Runner) -> None:
    set_outputs(github, {"verdict": "pass", "count": 3, "share": 0.5, "red": False, "list": [1, "a\nb"], "none": ""})
    set_outputs(github, {"path": Path("a b/c.json")})
    assert written(github) == {
        "verdict": "pass",
        "count": "3",
        "share": "0.5",
        "red": "false",
        "list": '[1, "a\\nb"]',
        "none": "",
        "path": "a b/c.json",
    }


@given(value=st.text(st.characters(blacklist_categories=["Cs"])))
def test_any_text_reads_back(tmp_path_factory: pytest.TempPathFactory, value: str) -> None:
    runner = Runner(output_file=tmp_path_factory.mktemp("x") / "output")
    set_outputs(runner, {"before": "1", "value": value, "after": "2"})
    assert written(runner) == {"before": "1", "value": value, "after": "2"}


def test_a_value_cannot_set_another_output(github: Runner) -> None:
    set_outputs(github, {"value": "x\nverdict=pass\nEOF\nverdict=pass"})
    assert list(written(github)) == ["value"]


def test_delimiters_differ(github: Runner) -> None:
    set_outputs(github, {"a": "1\n2", "b": "1\n2"})
    assert github.output_file is not None
    delimiters = [line.split("<<")[1] for line in github.output_file.read_text().splitlines() if "<<" in line]
    assert len(set(delimiters)) == 2


@pytest.mark.parametrize("value", ["a\nb", "a\r\nb", "a\rb", "a\n", "\r"])
def test_every_kind_of_line_end_is_fenced(github: Runner, value: str) -> None:
    set_outputs(github, {"value": value})
    assert github.output_file is not None
    assert github.output_file.read_text().startswith("value<<")


@pytest.mark.parametrize("name", ["", "1a", "a b", "a=b", "a\nb", "a<<b", "ä"])
def test_names_are_checked(github: Runner, name: str) -> None:
    with pytest.raises(ValueError, match="not the name"):
        set_outputs(github, {name: "x"})


def test_no_number_that_is_not_finite(github: Runner) -> None:
    with pytest.raises(ValueError, match="JSON compliant"):
        set_outputs(github, {"x": float("nan")})


def test_without_a_runner_nothing_is_written() -> None:
    set_outputs(Runner(), {"verdict": "pass"})


def test_a_file_that_cannot_be_written_is_an_infrastructure_error(tmp_path: Path) -> None:
    with pytest.raises(InfrastructureError, match=f"{tmp_path}: the step's outputs cannot be written"):
        set_outputs(Runner(output_file=tmp_path), {"verdict": "pass"})
