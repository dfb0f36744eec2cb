"""Tracked files of one state of a repository, and their XML with the line of every element."""

from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar
from xml.etree.ElementTree import Element

import yaml
from defusedxml import DefusedXmlException
from defusedxml.ElementTree import ParseError, XMLParser

LINE_KEY = "{calibration}line"
"""Key of an element's line, which cannot be an attribute of a document."""

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
