"""New findings: moved or reformatted code has none, a copy and a change do."""

from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from calibration.addons.analysis.copies import Compared, Copy, compare
from calibration.addons.analysis.results import CodeFinding
from tests.repositories import write

MARK = "eval("


def state(folder: Path, files: dict[str, str]) -> tuple[list[CodeFinding], Copy]:
    """A state of a repository in which every line with an ``eval(`` is a finding."""
    write(folder, files)
    findings = [
        CodeFinding(path, number, "x/eval", "security", "warning", "eval is used")
        for path, text in files.items()
        for number, line in enumerate(text.split("\n"), 1)
        if MARK in line
    ]
    return findings, Copy(folder, tuple(files))


def compared(folder: Path, before: dict[str, str], now: dict[str, str]) -> Compared:
    earlier, base = state(folder / "before", before)
    findings, copy = state(folder / "now", now)
    return compare(findings, copy, earlier, base, [*before, *now])


def test_a_line_that_moves_is_not_new(tmp_path: Path) -> None:
    found = compared(tmp_path, {"a.py": "x = eval(y)\n"}, {"a.py": "# more\n\nif z:\n    x = eval(y)\n"})
    assert not found.new
    assert not found.fixed
    assert [finding.line for finding in found.unchanged] == [4]


def test_a_line_that_moves_to_another_file_is_not_new(tmp_path: Path) -> None:
    found = compared(tmp_path, {"a.py": "x = eval(y)\n"}, {"b.py": "x = eval(y)\n"})
    assert not found.new
    assert not found.fixed


def test_a_line_that_a_formatter_breaks_is_not_new(tmp_path: Path) -> None:
    found = compared(tmp_path, {"a.py": "x = f('a', eval(y))\n"}, {"a.py": 'x = f(\n    "a",\n    eval(y),\n)\n'})
    assert not found.new
    assert not found.fixed


def test_a_second_copy_is_new(tmp_path: Path) -> None:
    found = compared(tmp_path, {"a.py": "x = eval(y)\n"}, {"a.py": "x = eval(y)\nx = eval(y)\n"})
    assert len(found.new) == len(found.unchanged) == 1


def test_another_line_of_the_rule_is_new_and_the_one_that_is_gone_fixed(tmp_path: Path) -> None:
    found = compared(tmp_path, {"a.py": "x = eval(y)\n"}, {"a.py": "def f(name):\n    return eval(name + '()')\n"})
    assert [finding.line for finding in found.new] == [2]
    assert [finding.line for finding in found.fixed] == [1]


def test_findings_in_unchanged_files_are_not_new(tmp_path: Path) -> None:
    findings, copy = state(tmp_path / "now", {"a.py": "x = eval(y)\n"})
    found = compare(findings, copy, [], Copy(tmp_path / "before", ()), [])
    assert not found.new
    assert found.unchanged == tuple(findings)


LINES = st.lists(st.sampled_from(["x = eval(y)", "eval(z)", "a = 1", "b = eval(f(c))", ""]), max_size=12)


@given(LINES, st.randoms(use_true_random=False))
def test_lines_in_another_order_bring_nothing_in(tmp_path_factory: object, lines: list[str], random: object) -> None:
    folder = tmp_path_factory.mktemp("order")  # type: ignore[attr-defined]
    moved = [f"    {line}" for line in lines]
    random.shuffle(moved)  # type: ignore[attr-defined]
    found = compared(folder, {"a.py": "\n".join(lines)}, {"a.py": "\n".join(moved)})
    assert not found.new
    assert not found.fixed
