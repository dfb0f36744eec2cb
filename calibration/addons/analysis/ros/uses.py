"""Packages that the files of a package use: in CMake, code, interfaces, launch files and robot descriptions."""

import ast
import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass

from calibration.addons.analysis.ros.interfaces import fields_of
from calibration.addons.analysis.ros.known import CORE_HEADERS, CORE_PACKAGES
from calibration.addons.analysis.ros.package import Package
from calibration.addons.analysis.ros.setup_script import parse_python
from calibration.addons.analysis.ros.tree import without_comments

CPP_SUFFIXES = (".cpp", ".cc", ".cxx", ".c", ".h", ".hpp", ".hh", ".hxx")
DESCRIPTION_SUFFIXES = (
    ".launch",
    ".launch.xml",
    ".urdf",
    ".xacro",
    ".test",
    ".launch.py",
    ".launch.yaml",
    ".launch.yml",
)
_INCLUDE_LINE = re.compile(r'[ \t]*#[ \t]*include[ \t]*[<"]([\w.+-]+)/([^>"\n]+)[>"]')
_DIRECTIVE_LINE = re.compile(r"[ \t]*#[ \t]*(if|ifdef|ifndef|endif|define)\b[ \t]*(\w*)")
_PACKAGE_REFERENCE = re.compile(r"\$\(find(?:-pkg-share)?[ \t]+([\w-]+)\)|package://([\w-]+)/")


@dataclass(frozen=True)
class Use:
    """Use of a package at a line."""

    name: str
    path: str
    line: int
    how: str
    """Description of the use, for messages."""
    accepted: frozenset[str] = frozenset()
    """Names of other packages that satisfy it too."""


def uses(package: Package, known: Collection[str]) -> Iterator[Use]:
    """Yield the uses of known packages, those of one file in their order."""
    yield from _in_cmake(package, known)
    for path in package.files:
        if path.endswith(CPP_SUFFIXES):
            yield from _included_packages(package, path, known)
        elif path.endswith(".py") and not path.endswith((".launch.py", "setup.py", "conf.py")):
            yield from _imported_packages(package, path, known)
        elif path.endswith((".msg", ".srv", ".action")):
            for each in fields_of(package.tree.text(path)):
                owner, separator, _ = each.type.partition("/")
                if separator:
                    yield Use(owner, path, each.line, "this type")
        if path.endswith(DESCRIPTION_SUFFIXES):
            yield from _named_packages(package, path, known)


def _in_cmake(package: Package, known: Collection[str]) -> Iterator[Use]:
    for command in package.commands("find_package"):
        words = command.arguments
        if not words or "QUIET" in command.texts:
            continue
        if words[0].text in known or words[0].text in ("catkin", "ament_cmake"):
            yield Use(words[0].text, command.path, command.line, "find_package")
        if words[0].text == "catkin":
            for each in words[1:]:
                if re.fullmatch(r"[a-z][a-z0-9_]*", each.text):
                    yield Use(each.text, command.path, each.line, "find_package")


def _included_packages(package: Package, path: str, known: Collection[str]) -> Iterator[Use]:
    """Yield what is included without a condition; a guard of the whole file is none."""
    depth, guard = 0, ""
    for number, line in enumerate(package.tree.text(path).split("\n"), 1):
        if "#" not in line:
            continue
        if directive := _DIRECTIVE_LINE.match(line):
            kind, name = directive[1], directive[2]
            if kind == "define":
                depth -= name == guard and bool(guard)
                guard = ""
            else:
                depth += -1 if kind == "endif" else 1
                guard = name if kind == "ifndef" and depth == 1 else ""
        elif (include := _INCLUDE_LINE.match(line)) and depth <= 0:
            owner, rest = include[1], include[2]
            if any(package.tree.has(package.inside(f"{folder}{owner}/{rest}")) for folder in ("", "include/", "src/")):
                continue
            if owner == "ros":
                yield Use(CORE_HEADERS.get(rest, "roscpp"), path, number, "this header", CORE_PACKAGES)
            elif owner in known:
                yield Use(owner, path, number, "this header")


def _imported_packages(package: Package, path: str, known: Collection[str]) -> Iterator[Use]:
    """Yield what is imported, but not what may fail."""
    text = package.tree.text(path)
    if "import" not in text:
        return
    module = parse_python(text)
    if module is None:
        return
    tried = {
        id(below)
        for node in ast.walk(module)
        if isinstance(node, ast.Try | ast.If)
        for each in (
            *node.body,
            *node.orelse,
            *(part for handler in getattr(node, "handlers", ()) for part in handler.body),
        )
        for below in ([each] if isinstance(each, ast.Import | ast.ImportFrom) else ())
    }
    for node in ast.walk(module):
        if id(node) in tried or not isinstance(node, ast.Import | ast.ImportFrom):
            continue
        if isinstance(node, ast.Import):
            names = [each.name for each in node.names]
        else:
            names = [] if node.level else [node.module or ""]
        for name in names:
            owner = name.partition(".")[0]
            if owner in known:
                yield Use(owner, path, node.lineno, "this import")


def _named_packages(package: Package, path: str, known: Collection[str]) -> Iterator[Use]:
    """Yield the packages that launch files and URDFs refer to (``$(find ...)``, ``package://``), without comments."""
    for number, line in enumerate(without_comments(package.tree.text(path)).split("\n"), 1):
        for match in _PACKAGE_REFERENCE.finditer(line):
            name = match[1] or match[2]
            if name in known:
                yield Use(name, path, number, "this path")
