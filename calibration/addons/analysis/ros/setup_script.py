"""setup.py as far as it can be read without running it: entry points, data files, packages."""

import ast
import re
import warnings
from collections.abc import Iterator
from configparser import ConfigParser
from configparser import Error as ConfigError
from dataclasses import dataclass

from calibration.addons.analysis.ros.tree import Tree

_ENTRY_POINT = re.compile(r"\s*([\w.-]+)\s*=\s*([\w.]+)\s*(?::\s*([\w.]+))?\s*(?:\[.*\])?\s*")


@dataclass(frozen=True)
class EntryPoint:
    """Executable that a package installs: a function of a module."""

    name: str
    module: str
    function: str
    path: str
    line: int


@dataclass(frozen=True)
class SetupScript:
    """setup.py and setup.cfg of a package."""

    path: str
    name: tuple[str, int] | None = None
    """Name and its line; None if it is not written."""
    entry_points: tuple[EntryPoint, ...] = ()
    strings: tuple[tuple[str, int], ...] = ()
    """All strings with their lines."""
    data_files: tuple[tuple[str, int], ...] = ()
    """Names of files in data_files that are written out, with their lines."""
    is_known: bool = True
    """Whether the file could be parsed."""


def parse_python(text: str) -> ast.Module | None:
    """Parse Python; None if it does not parse."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # invalid escapes in the strings of others
            return ast.parse(text)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return None


def read_setup(tree: Tree, folder: str) -> SetupScript | None:
    """Return what a folder's setup.py says; None if there is none."""
    path = f"{folder}/setup.py" if folder else "setup.py"
    if path not in tree.present:
        return None
    module = parse_python(tree.text(path))
    if module is None:
        return SetupScript(path, is_known=False)
    constants = {
        target.id: node.value.value
        for node in ast.walk(module)
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        for target in node.targets
        if isinstance(target, ast.Name)
    }
    name, entries, data = None, [], []
    for node in ast.walk(module):
        if isinstance(node, ast.keyword) and node.arg == "entry_points":
            entries = list(_entry_points(node.value, path))
        elif isinstance(node, ast.keyword) and node.arg == "data_files":
            data = list(_data_files(node.value))
        elif isinstance(node, ast.keyword) and node.arg == "name":
            text = constants.get(node.value.id) if isinstance(node.value, ast.Name) else _constant_text(node.value)
            name = (text, node.value.lineno) if text is not None else name
    strings = tuple(
        (node.value, node.lineno)
        for node in ast.walk(module)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    )
    return SetupScript(path, name, (*entries, *_entry_points_of_configuration(tree, folder)), strings, tuple(data))


def _constant_text(node: ast.expr) -> str | None:
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else None


def _entry_points(node: ast.expr, path: str) -> Iterator[EntryPoint]:
    """Yield the console scripts of a dictionary of entry points."""
    if not isinstance(node, ast.Dict):
        return
    for key, value in zip(node.keys, node.values, strict=True):
        if key is None or _constant_text(key) != "console_scripts" or not isinstance(value, ast.List | ast.Tuple):
            continue
        for each in value.elts:
            match = _ENTRY_POINT.fullmatch(_constant_text(each) or "")
            if match:
                yield EntryPoint(match[1], match[2], match[3] or "", path, each.lineno)


def _data_files(node: ast.expr) -> Iterator[tuple[str, int]]:
    """Yield the files that stand in lists of data_files, each ``(folder, [file, ...])``."""
    for each in ast.walk(node):
        if isinstance(each, ast.Tuple) and len(each.elts) == 2 and isinstance(each.elts[1], ast.List | ast.Tuple):
            for file in each.elts[1].elts:
                text = _constant_text(file)
                if text is not None:
                    yield text, file.lineno


def _entry_points_of_configuration(tree: Tree, folder: str) -> Iterator[EntryPoint]:
    """Yield the console scripts of setup.cfg."""
    path = f"{folder}/setup.cfg" if folder else "setup.cfg"
    parser = ConfigParser(interpolation=None)
    try:
        parser.read_string(tree.text(path))
        text = parser.get("options.entry_points", "console_scripts", fallback="")
    except (ConfigError, ValueError):
        return
    lines = tree.text(path).split("\n")
    for each in text.split("\n"):
        match = _ENTRY_POINT.fullmatch(each)
        if match:
            at = next((number for number, line in enumerate(lines, 1) if each.strip() == line.strip()), 1)
            yield EntryPoint(match[1], match[2], match[3] or "", path, at)
