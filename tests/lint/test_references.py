"""Names in docstrings of `calibration/` exist, and every table of `evaluate` is described where users look for it."""

import ast
import re
from pathlib import Path

from calibration.base.records import flat_fields
from calibration.engine.evaluation.specification import TABLE_KINDS
from calibration.pipeline.system import System

from .yaml_lines import PROJECT

PACKAGE = PROJECT / "calibration"
ENTRY = re.compile(r"^- ``.*(?:\n  .*)*", re.MULTILINE)
"""Entry of a list of modules in the docstring of a package."""
LISTED = re.compile(r"(?:^- |[;,] )``([a-z_0-9]+)``")
DOTTED = re.compile(r"`~?(calibration(?:\.\w+)+)`(?!`)")


def test_packages_list_modules_that_exist() -> None:
    found = [
        (file, name)
        for file in PACKAGE.rglob("__init__.py")
        for entry in ENTRY.findall(file.read_text())
        for name in LISTED.findall(entry)
    ]
    assert len(found) > 50
    assert [
        f"{file}: {name}"
        for file, name in found
        if not (file.with_name(f"{name}.py").exists() or file.with_name(name).is_dir())
    ] == []


def test_dotted_names_lead_to_what_is_defined() -> None:
    found = [(file, name) for file in PACKAGE.rglob("*.py") for name in DOTTED.findall(file.read_text())]
    assert len(found) > 50
    assert [f"{file}: {name}" for file, name in found if not defined(name.split("."))] == []


def test_every_table_is_in_the_help_and_on_the_page() -> None:
    texts = [flat_fields(System)["evaluate"].help, (PROJECT / "docs" / "calibration-yml.md").read_text()]
    for name, kind in TABLE_KINDS.items():
        form = ":".join((name, *kind.needs))
        assert name.startswith("inter-collection-") or all(form in text for text in texts), form


def defined(parts: list[str]) -> bool:
    """Whether a name leads to a package, a module, or to something inside one."""
    file = next(file for count in range(len(parts), 0, -1) if (file := module(parts[:count])) is not None)
    inside = parts[len(file.relative_to(PROJECT).with_suffix("").parts) - (file.name == "__init__.py") :]
    return set(inside) <= names(file.read_text())


def module(parts: list[str]) -> Path | None:
    """Return the file of a module or package; None if it does not exist."""
    path = PROJECT.joinpath(*parts)
    return next((file for file in (path.with_suffix(".py"), path / "__init__.py") if file.exists()), None)


def names(text: str) -> set[str]:
    """Return all names that a module defines, assigns or imports, in its classes too."""
    found = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found.add(node.id)
        elif isinstance(node, ast.alias):
            found.add(node.asname or node.name)
    return found


def test_contributing_names_what_exists() -> None:
    text = (PROJECT / "CONTRIBUTING.md").read_text()
    code = "\n".join(file.read_text() for root in ("calibration", "tests") for file in (PROJECT / root).rglob("*.py"))
    constants = set(re.findall(r"`([A-Z][A-Z_]{3,})`", text))
    paths = set(re.findall(r"`((?:[a-z_]+/)+[a-z_]*(?:\.\w+)?)`", text))
    assert len(constants) > 10
    assert len(paths) > 30
    assert [name for name in constants if not re.search(rf"^ *{name}\b", code, re.MULTILINE)] == []
    assert [path for path in paths if not any((root / path).exists() for root in (PROJECT, PACKAGE))] == []
