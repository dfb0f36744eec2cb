"""Packages of a repository: package.xml, setup.py, interfaces, and the files that belong to each.

setup.py is read without running it.
"""

import ast
import re
from collections.abc import Iterator, Sequence
from configparser import ConfigParser
from configparser import Error as ConfigError
from dataclasses import dataclass
from functools import cached_property
from xml.etree.ElementTree import Element

from calibration.addons.analysis.ros.cmake import CMakeCommand, read_cmake
from calibration.addons.analysis.ros.tree import PythonFile, Tree, line_of, parents, parse_python, parse_xml

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
    is_known: bool = True
    """Whether the file could be parsed."""


def read_setup(tree: Tree, folder: str) -> SetupScript | None:
    """Return what a folder's setup.py says; None if there is none."""
    path = f"{folder}/setup.py" if folder else "setup.py"
    if path not in tree.present:
        return None
    file = parse_python(tree.text(path))
    if file is None:
        return SetupScript(path, is_known=False)
    name, entries = None, list[EntryPoint]()
    for node in file.nodes:
        if isinstance(node, ast.keyword) and node.arg == "entry_points":
            entries = [each for key, value in _items_of(node.value) for each in _entry_points(key, value, file, path)]
        elif isinstance(node, ast.keyword) and node.arg == "name" and (text := file.text(node.value)) is not None:
            name = (text, node.value.lineno)
    return SetupScript(path, name, (*entries, *_entry_points_of_configuration(tree, folder)))


def _items_of(node: ast.expr) -> Iterator[tuple[ast.expr | None, ast.expr]]:
    return zip(node.keys, node.values, strict=True) if isinstance(node, ast.Dict) else iter(())


def _entry_points(key: ast.expr | None, value: ast.expr, file: PythonFile, path: str) -> Iterator[EntryPoint]:
    """Yield the console scripts of an entry in a dictionary of entry points."""
    if file.text(key) == "console_scripts" and isinstance(value, ast.List | ast.Tuple):
        for each in value.elts:
            if match := _ENTRY_POINT.fullmatch(file.text(each) or ""):
                yield EntryPoint(match[1], match[2], match[3] or "", path, each.lineno)


def _entry_points_of_configuration(tree: Tree, folder: str) -> Iterator[EntryPoint]:
    """Yield the console scripts of setup.cfg."""
    path = f"{folder}/setup.cfg" if folder else "setup.cfg"
    parser = ConfigParser(interpolation=None)
    try:
        parser.read_string(tree.text(path))
        text = parser.get("options.entry_points", "console_scripts", fallback="")
    except (ConfigError, ValueError):
        return
    lines = [line.strip() for line in tree.text(path).split("\n")]
    for each in text.split("\n"):
        if match := _ENTRY_POINT.fullmatch(each):
            line = lines.index(each.strip()) + 1 if each.strip() in lines else 1
            yield EntryPoint(match[1], match[2], match[3] or "", path, line)


_FIELD_LINE = re.compile(r"([\w/]+(?:<=\d+)?)((?:\[(?:<=)?\d*\])?)\s+(\w+)\s*(.*)")
_BOUND_OF_TEXT = re.compile(r"<=\d+")
FOLDER_OF_SUFFIX = {".msg": "msg", ".srv": "srv", ".action": "action"}


@dataclass(frozen=True)
class Field:
    """Field or constant of an interface."""

    type: str
    """Without the size of an array or text."""
    name: str
    line: int
    is_constant: bool


@dataclass(frozen=True)
class Unreadable:
    """Line of an interface that is no field."""

    text: str
    line: int


def lines_of(text: str) -> Iterator[Field | Unreadable]:
    """Yield what the lines of an interface declare."""
    for number, line in enumerate(text.split("\n"), 1):
        content = line.partition("#")[0].strip()
        if not content or content == "---":
            continue
        match = _FIELD_LINE.fullmatch(content)
        if match is None:
            yield Unreadable(content, number)
        else:
            yield Field(_BOUND_OF_TEXT.sub("", match[1]), match[3], number, match[4].startswith("="))


def fields_of(text: str) -> list[Field]:
    """Return the fields and constants of an interface."""
    return [each for each in lines_of(text) if isinstance(each, Field)]


PACKAGE_FILE = "package.xml"
_IGNORING_FILES = ("COLCON_IGNORE", "CATKIN_IGNORE", "AMENT_IGNORE")
"""Files whose folder the build tools skip."""
BUILD_TAGS = ("depend", "build_depend", "build_export_depend", "buildtool_depend", "buildtool_export_depend")
_DEPENDENCY_TAGS = (*BUILD_TAGS, "exec_depend", "run_depend", "test_depend", "doc_depend", "group_depend")


@dataclass(frozen=True)
class Dependency:
    """Dependency that package.xml declares."""

    name: str
    tag: str
    line: int
    condition: str


@dataclass(frozen=True, eq=False)
class Package:
    """A ROS package; its files are those below its folder."""

    tree: Tree
    folder: str
    xml: Element
    files: tuple[str, ...]
    """Files whose text can be read."""

    @property
    def path(self) -> str:
        """The path of package.xml."""
        return self.inside(PACKAGE_FILE)

    @cached_property
    def name(self) -> str:
        """The name that package.xml gives; empty if there is none."""
        return (self.xml.findtext("name") or "").strip()

    @property
    def name_line(self) -> int:
        """The line of the name."""
        return self.line_of("name")

    @cached_property
    def dependencies(self) -> tuple[Dependency, ...]:
        """Declared dependencies of all kinds, in their order."""
        return tuple(
            Dependency((each.text or "").strip(), each.tag, line_of(each), each.get("condition", ""))
            for each in self.xml
            if each.tag in _DEPENDENCY_TAGS and (each.text or "").strip()
        )

    @cached_property
    def declared(self) -> frozenset[str]:
        """Names of all declared dependencies."""
        return frozenset(each.name for each in self.dependencies)

    @property
    def is_metapackage(self) -> bool:
        """Whether the package only names others."""
        return self.xml.find("export/metapackage") is not None

    @cached_property
    def build_type(self) -> str:
        """``catkin``, ``ament_cmake``, ``ament_python``, ``cmake``, ...: exported, or that of the build tool."""
        exported = (self.xml.findtext("export/build_type") or "").strip()
        if exported:
            return exported
        tools = {each.name for each in self.dependencies if each.tag == "buildtool_depend"}
        if "catkin" in tools or not tools:
            return "catkin"
        return "ament_cmake" if any(each.startswith("ament_cmake") for each in tools) else "cmake"

    @property
    def is_ros2(self) -> bool:
        """Whether it is built by ament."""
        return self.build_type.startswith("ament")

    @cached_property
    def cmake(self) -> Sequence[CMakeCommand]:
        """The commands of CMakeLists.txt."""
        return read_cmake(self.tree, self.folder)

    @cached_property
    def setup(self) -> SetupScript | None:
        """setup.py, if there is one."""
        return read_setup(self.tree, self.folder)

    @cached_property
    def build_text(self) -> str:
        """The text of all files that say what is built and installed."""
        names = ("CMakeLists.txt", "setup.py", "setup.cfg")
        build = (path for path in self.files if path.rpartition("/")[2] in names or path.endswith(".cmake"))
        return "\n".join(map(self.tree.text, build))

    @cached_property
    def build_words(self) -> frozenset[str]:
        """The words of these files."""
        return frozenset(re.findall(r"[\w.+-]+", self.build_text))

    def inside(self, path: str) -> str:
        """Return the path in the repository of a path in the package."""
        return f"{self.folder}/{path}" if self.folder else path

    def relative(self, path: str) -> str:
        """Return the path in the package of a path in the repository."""
        return path.removeprefix(f"{self.folder}/") if self.folder else path

    def line_of(self, tag: str) -> int:
        """Return the line of an element of package.xml, or of the root."""
        found = self.xml.find(tag)
        return line_of(self.xml if found is None else found)

    def commands(self, *names: str) -> list[CMakeCommand]:
        """Return the commands of CMakeLists.txt of these names, in lower case."""
        return [each for each in self.cmake if each.name in names]


def find_packages(tree: Tree) -> list[Package]:
    """Return the packages as build tools find them: none in another one, none in an ignored folder."""
    roots: dict[str, Element] = {}
    for path in sorted(tree.files, key=lambda each: each.count("/")):
        folder, _, name = path.rpartition("/")
        above = [folder, *parents(folder)] if folder else [""]
        if name != PACKAGE_FILE or any(each in roots for each in above):
            continue
        if any(f"{each}/{mark}".lstrip("/") in tree.present for each in above for mark in _IGNORING_FILES):
            continue
        root = parse_xml(tree.data(path))
        if root is not None and root.tag == "package" and root.find("channel") is None:  # PHP's has a channel
            roots[folder] = root
    files: dict[str, list[str]] = {folder: [] for folder in roots}
    for path in tree.files:
        owner = next((each for each in parents(path) if each in roots), None)
        if owner is not None:
            files[owner].append(path)
    return [Package(tree, folder, root, tuple(files[folder])) for folder, root in sorted(roots.items())]
