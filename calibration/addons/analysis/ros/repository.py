"""The packages, their executables, code and launch files of a repository, each read once for all checks."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import PurePosixPath

from calibration.addons.analysis.ros.client_code import ClientCode, read_cpp, read_python
from calibration.addons.analysis.ros.cmake import CMakeCommand
from calibration.addons.analysis.ros.launch import Include, Launch, package_of, read_launch_xml, read_launch_yaml
from calibration.addons.analysis.ros.launch_python import read_launch_python
from calibration.addons.analysis.ros.package import Package, find_packages
from calibration.addons.analysis.ros.tree import (
    HEADER_SUFFIXES,
    SOURCE_SUFFIXES,
    Tree,
    imported_modules,
    join,
    parse_python,
    reachable,
)
from calibration.addons.analysis.ros.uses import COMMON_PACKAGES

_INCLUDED_HEADER = re.compile(r"#\s*include\s*[<\"](?:[^>\"\n]*/)?([\w-]+)\.h")
"""Name of an included header, without folders and suffix."""
_LINK_KEYWORDS = ("PUBLIC", "PRIVATE", "INTERFACE")
_DESTINATION_STARTS = ("share/", "lib/", "bin", "include", "${CMAKE_INSTALL")
"""How arguments with variables start that name a place to install to."""
_ALWAYS_INSTALLED = ("package.xml",)
"""Files that the build tools install themselves."""


@dataclass(frozen=True)
class Executables:
    """Executables of a package."""

    files: dict[str, tuple[str, ...]]
    """Sources of each by name: C++, or the Python file that is run."""
    is_complete: bool
    """Whether there can be no others."""


def find_executables(package: Package) -> Executables:
    """Return what ``run`` and launch files can start."""
    files: dict[str, tuple[str, ...]] = {}
    complete = not any(path.endswith(".cmake") for path in package.files)
    linked = _libraries_of_targets(package)
    sources = {
        each.texts[0]: _sources_of_target(package, each) for each in package.commands("add_library") if each.texts
    }
    for command in package.commands("add_executable", "ament_auto_add_executable", "cs_add_executable"):
        if not command.arguments or not command.arguments[0].is_known:
            complete = False
            continue
        name = command.texts[0]
        own = _sources_of_target(package, command)
        libraries = [path for each in linked.get(name, ()) for path in sources.get(each, ())]
        files[name] = _with_headers(package, (*own, *_included_sources(package, own, libraries)))
    for command in package.commands("rclcpp_components_register_node"):
        for name in [each.text for each in command.after("EXECUTABLE", ("PLUGIN", "EXECUTOR", "RESOURCE_INDEX"))]:
            files[name] = _with_headers(package, sources.get(command.texts[0], ()))
    for command in package.commands("set_target_properties"):
        texts = command.texts
        if "OUTPUT_NAME" in texts[:-1] and texts[0] in files:
            files[texts[texts.index("OUTPUT_NAME") + 1]] = files[texts[0]]
    for command in package.commands("install", "catkin_install_python"):
        for each in command.after("PROGRAMS", ("DESTINATION", "RENAME", "PERMISSIONS", "OPTIONAL", "COMPONENT")):
            place = command.place(each.text)
            if place is None:
                complete = False
            else:
                files[place.rpartition("/")[2]] = (place,)
    if not package.is_ros2:  # roslaunch takes any executable file below the package's folder
        for path in package.files:
            if not path.endswith((*SOURCE_SUFFIXES, *HEADER_SUFFIXES)):
                files.setdefault(path.rpartition("/")[2], (path,))
    if package.setup is not None:
        complete = complete and package.setup.is_known
        for entry in package.setup.entry_points:
            places = module_places(package, entry.module)
            files[entry.name] = tuple(place for place in places if place in package.tree.present)[:1]
        complete = complete and (package.build_type != "ament_python" or bool(package.setup.entry_points))
    return Executables({name: paths for name, paths in files.items() if name}, complete)


def _libraries_of_targets(package: Package) -> dict[str, list[str]]:
    """Return the libraries of each target, with those of its libraries."""
    direct: dict[str, list[str]] = {}
    for command in package.commands("target_link_libraries"):
        names = [each for each in command.texts[1:] if each not in _LINK_KEYWORDS]
        direct.setdefault(command.texts[0] if command.texts else "", []).extend(names)
    return {target: reachable(names, lambda name: direct.get(name, ())) for target, names in direct.items()}


def _sources_of_target(package: Package, command: CMakeCommand) -> tuple[str, ...]:
    places = (command.place(each) for each in command.texts[1:] if each.endswith(SOURCE_SUFFIXES))
    return tuple(each for each in places if each is not None and each in package.tree.present)


def _included_sources(package: Package, own: Sequence[str], others: Sequence[str]) -> list[str]:
    """Return those of other sources whose header some source includes, directly or not: a linked one may be unused."""
    used: dict[str, None] = {}
    open_paths = list(own)
    while open_paths:
        stems = set(_INCLUDED_HEADER.findall(package.tree.text(open_paths.pop())))
        found = [each for each in others if each not in used and PurePosixPath(each).stem in stems]
        used |= dict.fromkeys(found)
        open_paths += found
    return list(used)


def _with_headers(package: Package, sources: Sequence[str]) -> tuple[str, ...]:
    """Return sources, and the headers of the package that have the name of one."""
    stems = {PurePosixPath(path).stem for path in sources}
    headers = (path for path in package.files if path.endswith(HEADER_SUFFIXES))
    return (*sources, *(path for path in headers if PurePosixPath(path).stem in stems))


def module_places(package: Package, name: str) -> list[str]:
    """Return the paths at which a module of a package may be."""
    place = name.replace(".", "/")
    return [package.inside(f"{root}{place}{end}") for root in ("", "src/") for end in (".py", "/__init__.py")]


def with_imports(package: Package, path: str) -> tuple[str, ...]:
    """Return a Python file and those of the package that it imports, directly or not."""

    def imported(each: str) -> Iterator[str]:
        file = parse_python(package.tree.text(each)) if each.endswith(".py") or "/scripts/" in each else None
        for level, name in [] if file is None else [pair for node in file.nodes for pair in imported_modules(node)]:
            folder = join(each.rpartition("/")[0], "../" * (level - 1)) or "" if level else ""
            parts = [*(package.relative(folder).split("/") if level else ()), name]
            places = module_places(package, ".".join(filter(None, parts)))
            yield from [place for place in places if place in package.tree.present][:1]

    return tuple(reachable([path], imported, most=200))


def is_installed(package: Package, path: str) -> bool:
    """Whether a file of a package is installed, or may be; ``path`` is relative to the package."""
    if path in _ALWAYS_INSTALLED or path.rpartition("/")[2] in package.build_words:
        return True
    if package.build_type == "ament_python":
        text = package.build_text
        return package.setup is None or not package.setup.is_known or path.split("/")[0] in text or "walk(" in text
    for command in package.commands("install", "ament_auto_package", "install_launch_files", "catkin_install_python"):
        for each in command.arguments:
            place = command.place(each.text)
            if place is None and "DESTINATION" not in each.text and not each.text.startswith(_DESTINATION_STARTS):
                return True  # a variable or a pattern that may be it
            if place is not None and each.text and (package.inside(path) + "/").startswith(place.rstrip("/") + "/"):
                return True
    return not package.commands("install") and not package.is_ros2 and not package.cmake


class RosRepository:
    """Packages of a repository, with their code, executables and launch files."""

    def __init__(self, tree: Tree) -> None:
        """Create it from the tracked files."""
        self.tree = tree
        self._codes: dict[str, ClientCode] = {}
        self._executables: dict[str, Executables] = {}

    @cached_property
    def packages(self) -> list[Package]:
        """Packages of the repository, by folder."""
        return find_packages(self.tree)

    @cached_property
    def by_name(self) -> dict[str, Package]:
        """The packages by name; the first of two of one name."""
        return {each.name: each for each in reversed(self.packages) if each.name}

    @cached_property
    def known(self) -> frozenset[str]:
        """Names of packages: those of the repository, and common ones."""
        return COMMON_PACKAGES | frozenset(self.by_name)

    @cached_property
    def launches(self) -> dict[str, Launch]:
        """The launch files of the packages, by path."""
        read = (self._read_launch(path) for package in self.packages for path in package.files)
        return {each.path: each for each in read if each is not None}

    def _read_launch(self, path: str) -> Launch | None:
        if path.endswith((".launch", ".launch.xml", ".test")):
            return read_launch_xml(path, self.tree.data(path))
        if path.endswith((".launch.yaml", ".launch.yml")):
            return read_launch_yaml(path, self.tree.text(path))
        return read_launch_python(path, self.tree.text(path)) if path.endswith(".py") else None

    @cached_property
    def image_text(self) -> str:
        """The text of all files that say what images contain."""
        names = ((path, path.rpartition("/")[2]) for path in self.tree.files)
        paths = (path for path, name in names if name.startswith("Dockerfile") or name == "calibration.yml")
        return "\n".join(map(self.tree.text, paths))

    def place(self, text: str | None) -> str | None:
        """Return the path in the repository of ``package://name/path``; None if it is of no package here."""
        if text is not None and text.startswith("repository://"):
            return None if "$" in text else join("", text.removeprefix("repository://"))
        named = package_of(text or "")
        package = self.by_name.get(named[0]) if named else None
        return package.inside(named[1]) if package and named else None

    def included(self, include: Include) -> Launch | None:
        """Return the launch file that another one includes, if it is of this repository."""
        return self.launches.get(self.place(include.file) or "")

    def executables(self, package: Package) -> Executables:
        """Return the executables of a package."""
        if package.folder not in self._executables:
            self._executables[package.folder] = find_executables(package)
        return self._executables[package.folder]

    def code(self, path: str) -> ClientCode:
        """Return the calls in a file of code."""
        if path not in self._codes:
            read = read_python if path.endswith(".py") else read_cpp
            self._codes[path] = read(path, self.tree.text(path))
        return self._codes[path]
