"""The floors of `calibration/`: each imports only those that its row in the table of CONTRIBUTING.md names."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from .yaml_lines import PROJECT

PACKAGE = PROJECT / "calibration"

ROW = re.compile(r"^\| `(\w+)` \| [^|]* \| ([^|]*) \|$", re.MULTILINE)


def floors() -> dict[str, set[str]]:
    """The floors of the table, with those that each may import."""
    rows = ROW.findall((PROJECT / "CONTRIBUTING.md").read_text())
    return {name: set(re.findall(r"`(\w+)`", allowed)) for name, allowed in rows}


def imported_modules(file: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the line and the parts of the name of each module of ours that a file imports, in functions too."""
    for node in ast.walk(ast.parse(file.read_bytes())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == PACKAGE.name:
            for name in node.names:
                yield node.lineno, [*(node.module or "").split("."), name.name][1:]
        elif isinstance(node, ast.Import):
            for name in node.names:
                if name.name.startswith(f"{PACKAGE.name}."):
                    yield node.lineno, name.name.split(".")[1:]


def test_the_table_names_every_floor() -> None:
    assert set(floors()) == {folder.name for folder in PACKAGE.iterdir() if (folder / "__init__.py").is_file()}


def test_the_top_level_has_few_names() -> None:
    names = {path.name for path in PACKAGE.iterdir()} - {"__pycache__", "py.typed"}
    assert len(names) <= 9


@pytest.mark.parametrize("floor", floors())
def test_a_floor_imports_only_those_that_its_row_names(floor: str) -> None:
    allowed = {floor, *floors()[floor]}
    found = [
        f"{file.relative_to(PROJECT)}:{line}: {'.'.join(parts)}"
        for file in sorted((PACKAGE / floor).rglob("*.py"))
        for line, parts in imported_modules(file)
        if parts[0] in floors() and parts[0] not in allowed
    ]
    assert found == []


def test_no_addon_imports_another_one() -> None:
    found = [
        f"{file.relative_to(PROJECT)}:{line}: {'.'.join(parts)}"
        for addon in (PACKAGE / "addons").iterdir()
        for file in sorted(addon.rglob("*.py"))
        for line, parts in imported_modules(file)
        if parts[0] == "addons" and parts[1:2] != [addon.name]
    ]
    assert found == []
