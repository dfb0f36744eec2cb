"""Tracked files of one state of a repository, their XML with the line of every element, YAML and Python.

Python is read by its syntax tree and never run: calls, imports, and names that are assigned once.
"""

import ast
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar
from xml.etree.ElementTree import Element

import yaml
from defusedxml import DefusedXmlException
from defusedxml.ElementTree import ParseError, XMLParser

LINE_KEY = "{calibration}line"
"""Key of an element's line, which cannot be an attribute of a document."""

SOURCE_SUFFIXES, HEADER_SUFFIXES = (".cpp", ".cc", ".cxx", ".c"), (".h", ".hpp", ".hh", ".hxx")
CPP_SUFFIXES = (*SOURCE_SUFFIXES, *HEADER_SUFFIXES)
MAX_ELEMENT_DEPTH = 100
"""Limit of elements inside one another; readers of elements are recursive."""


class _Parser(XMLParser):
    """XML parser that stores the line of every element, and refuses what is nested too deeply."""

    _depth = 0

    def _end(self, tag: str) -> Element:
        self._depth -= 1
        element: Element = super()._end(tag)  # type: ignore[misc]
        return element

    def _start(self, tag: str, attributes: Sequence[str]) -> Element:
        self._depth += 1
        if self._depth > MAX_ELEMENT_DEPTH:
            raise ValueError(f"more than {MAX_ELEMENT_DEPTH} elements are inside one another")
        element: Element = super()._start(tag, attributes)  # type: ignore[misc]
        element.set(LINE_KEY, str(self.parser.CurrentLineNumber))
        return element


def parse_xml(data: bytes) -> Element | None:
    """Return the root of a document; None if it is not valid XML, declares entities, or is nested too deeply."""
    try:
        parser: Any = _Parser()
        parser.feed(data)
        root: Element = parser.close()
    except (DefusedXmlException, ParseError, ValueError, LookupError):  # LookupError: an unknown encoding
        return None
    return root


def line_of(element: Element) -> int:
    """Return the line of an element, from 1."""
    return int(element.get(LINE_KEY, "1"))


def attributes_of(element: Element) -> dict[str, str]:
    """Return the attributes that the document gives an element."""
    return {name: value for name, value in element.items() if name != LINE_KEY}


def parents(path: str) -> list[str]:
    """Return the folders that contain a path, the innermost first; the root is an empty string."""
    return ["" if str(each) == "." else str(each) for each in PurePosixPath(path).parents]


class Tree:
    """Tracked files by their paths, with ``/``; the text of those that were copied."""

    def __init__(self, root: Path, present: Iterable[str], opaque: Iterable[str] = ()) -> None:
        """Take the files.

        Args:
            root: folder of the copy.
            present: all tracked files, also those that were not copied.
            opaque: symbolic links and submodules, below which anything may exist.
        """
        self.root = root
        self.present = frozenset(present)
        self.opaque = frozenset(opaque)
        self._texts: dict[str, str] = {}

    @cached_property
    def files(self) -> tuple[str, ...]:
        """Files whose text can be read, sorted."""
        return tuple(path for path in sorted(self.present) if (self.root / path).is_file())

    @cached_property
    def folders(self) -> frozenset[str]:
        """Folders that have tracked files."""
        return frozenset(folder for path in self.present for folder in parents(path))

    def data(self, path: str) -> bytes:
        """Return the bytes of a file; none if it was not copied."""
        try:
            return (self.root / path).read_bytes()
        except OSError:
            return b""

    def text(self, path: str) -> str:
        """Return the text of a file; empty if it was not copied."""
        if path not in self._texts:
            self._texts[path] = self.data(path).decode("utf-8", "replace")
        return self._texts[path]

    def has(self, path: str) -> bool:
        """Whether a file or folder is tracked, or may exist below a link or a submodule."""
        return (
            path in self.present
            or path in self.folders
            or path in self.opaque
            or any(folder in self.opaque for folder in parents(path))
        )

    def below(self, folder: str) -> list[str]:
        """Return the files in a folder and its folders, sorted."""
        start = f"{folder}/" if folder else ""
        return [path for path in self.files if path.startswith(start)]


def join(folder: str, path: str) -> str | None:
    """Return a path relative to a folder of the repository, without ``.`` and ``..``; None if it leads out of it."""
    parts: list[str] = []
    for part in (*folder.split("/"), *path.split("/")):
        if part == "..":
            if not parts:
                return None
            parts.pop()
        elif part not in ("", "."):
            parts.append(part)
    return "/".join(parts)


def without_comments(text: str) -> str:
    """Return XML with empty lines in place of its comments."""
    parts, at = [], 0
    while (start := text.find("<!--", at)) >= 0:
        end = text.find("-->", start + 4)
        end = len(text) if end < 0 else end + 3
        parts += [text[at:start], "\n" * text.count("\n", start, end)]
        at = end
    return "".join([*parts, text[at:]])


def is_test_file(path: str) -> bool:
    """Whether a file is of a test, which runs beside the sources."""
    return path.endswith(".test") or any(part in ("test", "tests") for part in path.split("/")[:-1])


def compose_yaml(text: str) -> yaml.Node | None:
    """Return the nodes of a document in YAML, which have lines; None if it is no such document."""
    try:
        return yaml.compose(text, Loader=yaml.SafeLoader)
    except (yaml.YAMLError, ValueError, RecursionError):
        return None


def entries_of(node: Any) -> list[tuple[Any, Any]]:
    """Return keys and values of a mapping in YAML; none for other nodes."""
    return node.value if isinstance(node, yaml.MappingNode) else []


Item = TypeVar("Item")


def reachable(starts: Iterable[Item], following: Callable[[Item], Iterable[Item]], most: int = 100_000) -> list[Item]:
    """Return the items that can be reached from some, which are among them; not many more than ``most``."""
    seen: dict[Item, None] = {}
    open_items = list(starts)
    while open_items and len(seen) < most:
        item = open_items.pop()
        if item not in seen:
            seen[item] = None
            open_items += following(item)
    return list(seen)


class PythonFile:
    """Syntax tree of a file, and the meaning of its names."""

    def __init__(self, module: ast.Module) -> None:
        """Collect the names of a module."""
        self.module = module
        self.nodes = list(ast.walk(module))
        self.values: dict[str, ast.expr | None] = {}
        """Expressions of names and attributes of self that are assigned once; None for others."""
        self._imported: dict[str, list[str]] = {}
        for node in self.nodes:
            if isinstance(node, ast.Import):
                self._imported |= {each.asname: each.name.split(".") for each in node.names if each.asname}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                parts = node.module.split(".")
                self._imported |= {each.asname or each.name: [*parts, each.name] for each in node.names}
            elif isinstance(node, ast.Assign) and len(node.targets) == 1 and (name := _name_of(node.targets[0])):
                self.values[name] = None if name in self.values else node.value

    def calls(self) -> Iterator[tuple[ast.Call, list[str]]]:
        """Yield every call, with the parts of the function's name."""
        for node in self.nodes:
            if isinstance(node, ast.Call):
                yield node, self.dotted_name(node.func)

    def dotted_name(self, node: ast.expr) -> list[str]:
        """Return the parts of a dotted name, its first one resolved by the imports."""
        parts: list[str] = []
        while isinstance(node, ast.Attribute):
            parts.append(node.attr)
            node = node.value
        if not isinstance(node, ast.Name):
            return parts[::-1]
        return [*self._imported.get(node.id, [node.id]), *parts[::-1]]

    def value(self, node: ast.expr | None) -> ast.expr | None:
        """Return the value of a name, None if it is not known; other expressions as they are."""
        return self.values.get(name) if node is not None and (name := _name_of(node)) else node

    def text(self, node: ast.expr | None) -> str | None:
        """Return the text that an expression or its name stands for; None for others."""
        value = self.value(node)
        return value.value if isinstance(value, ast.Constant) and isinstance(value.value, str) else None


def parse_python(text: str) -> PythonFile | None:
    """Parse Python; None if it does not parse."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # invalid escapes in the strings of others
            return PythonFile(ast.parse(text))
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return None


def argument_of(call: ast.Call, at: int | None, keyword: str) -> ast.expr | None:
    """Return an argument of a call by its index, if it has one, or its keyword."""
    if at is not None and len(call.args) > at:
        return call.args[at]
    return next((each.value for each in call.keywords if each.arg == keyword), None)


def imported_modules(node: ast.AST) -> list[tuple[int, str]]:
    """Return what an import may name as a module: dots of a relative import, and dotted name, the shortest first."""
    if isinstance(node, ast.Import):
        return [(0, each.name) for each in node.names]
    if not isinstance(node, ast.ImportFrom):
        return []
    base = [node.module] if node.module else []
    return [(node.level, ".".join([*base, *tail])) for tail in ([], *([each.name] for each in node.names))]


def _name_of(node: ast.expr) -> str:
    """Return the text of a name or an attribute of self; empty for others."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "self":
        return f"self.{node.attr}"
    return ""
