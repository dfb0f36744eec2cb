"""Checks of package.xml: what the build tools need, names, dependencies."""

import re
from collections.abc import Iterator

from calibration.addons.analysis.results import CodeFinding
from calibration.addons.analysis.ros import fault, quoted
from calibration.addons.analysis.ros.cmake import CATKIN_PACKAGE_KEYWORDS
from calibration.addons.analysis.ros.package import BUILD_TAGS, Package
from calibration.addons.analysis.ros.repository import RosRepository
from calibration.addons.analysis.ros.tree import line_of
from calibration.addons.analysis.ros.uses import uses

_REQUIRED_TAGS = ("name", "version", "description", "maintainer", "license")
_PACKAGE_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")
_PACKAGE_VERSION = re.compile(r"\d+\.\d+\.\d+")
_NEW_TAGS = ("depend", "exec_depend", "build_export_depend", "buildtool_export_depend", "doc_depend")
_RUN_TAGS = ("depend", "exec_depend", "run_depend", "build_export_depend")


def check_packages(repository: RosRepository) -> Iterator[CodeFinding]:
    """Check every package.xml, alone and against the files beside it."""
    first: dict[str, Package] = {}
    for package in repository.packages:
        yield from _check_content(package)
        yield from _check_names(package)
        if package.name and package.name in first:
            message = f"the package {quoted(package.name)} is in {quoted(first[package.name].folder or '.')} too"
            yield fault("package-twice", package.path, package.name_line, message)
        first.setdefault(package.name, package)
        yield from _check_build_type(package)
        yield from _check_dependencies(package, repository)


def _check_content(package: Package) -> Iterator[CodeFinding]:
    for tag in _REQUIRED_TAGS:
        element = package.xml.find(tag)
        if element is None or not "".join(element.itertext()).strip():
            message = f"expected <{tag}>, found {'none' if element is None else 'it empty'}"
            yield fault("package-xml", package.path, package.line_of(tag), message)
    if package.name and not _PACKAGE_NAME.fullmatch(package.name):
        message = f"found the name {quoted(package.name)}, expected letters, digits and _"
        yield fault("package-xml", package.path, package.name_line, message)
    version = (package.xml.findtext("version") or "").strip()
    if version and not _PACKAGE_VERSION.fullmatch(version):
        message = f"found the version {quoted(version)}, expected three numbers such as 1.0.0"
        yield fault("package-xml", package.path, package.line_of("version"), message)
    for each in package.xml.findall("maintainer"):
        if "@" not in each.get("email", ""):
            yield fault("package-xml", package.path, line_of(each), "expected an email of the maintainer")
    form = package.xml.get("format", "1")
    for dependency in package.dependencies:
        if form == "1" and dependency.tag in _NEW_TAGS:
            message = f'<{dependency.tag}> needs <package format="2"> or "3", found format 1'
            yield fault("package-xml", package.path, dependency.line, message)
        if form != "1" and dependency.tag == "run_depend":
            message = f"<run_depend> is of format 1, found format {quoted(form)}: use <exec_depend>"
            yield fault("package-xml", package.path, dependency.line, message)


def _check_names(package: Package) -> Iterator[CodeFinding]:
    projects = [each for each in package.commands("project") if each.folder == package.folder and each.arguments]
    if projects and projects[0].arguments[0].is_known:
        name = projects[0].arguments[0].text
        if package.name and name != package.name:
            message = f"project({name}), but package.xml calls it {quoted(package.name)}"
            yield fault("package-name", projects[0].path, projects[0].line, message)
    if package.build_type == "ament_python" and package.setup is not None and package.setup.name is not None:
        name, line = package.setup.name
        if name.replace("-", "_") != package.name.replace("-", "_"):
            message = f"the name is {quoted(name)}, but package.xml calls it {quoted(package.name)}"
            yield fault("package-name", package.setup.path, line, message)


def _check_build_type(package: Package) -> Iterator[CodeFinding]:
    kind, tree = package.build_type, package.tree
    build_type = package.xml.find("export/build_type")
    at = package.line_of("export") if build_type is None else line_of(build_type)
    needed = {"ament_python": "setup.py", "ament_cmake": "CMakeLists.txt", "cmake": "CMakeLists.txt"}.get(kind)
    if kind == "catkin" and "catkin" in package.declared:
        needed = "CMakeLists.txt"
    if needed is None:
        return
    if package.inside(needed) not in tree.present:
        yield fault("build-type", package.path, at, f"a package of type {kind} needs {needed}, found none")
    elif kind == "ament_python":
        marker = f"resource/{package.name}"
        if package.name and not tree.has(package.inside(marker)) and "resource/" in package.build_text:
            message = f"setup.py installs a file of resource/, but {marker} does not exist: the package is not found"
            yield fault("build-type", package.inside("setup.py"), _line_with(package, "resource/"), message)
    else:
        ends = {
            "catkin": ("catkin_package", "catkin_metapackage"),
            "ament_cmake": ("ament_package", "ament_auto_package"),
        }
        known = {word.lower() for word in package.build_words}
        if kind in ends and not known.intersection(ends[kind]):
            line = next((each.line for each in package.commands("project")), 1)
            message = f"a package of type {kind} calls {ends[kind][0]}() in CMakeLists.txt, found no such call"
            yield fault("build-type", package.inside(needed), line, message)


def _line_with(package: Package, text: str) -> int:
    lines = package.tree.text(package.inside("setup.py")).split("\n")
    return next((number for number, line in enumerate(lines, 1) if text in line), 1)


def _check_dependencies(package: Package, repository: RosRepository) -> Iterator[CodeFinding]:
    seen: set[tuple[str, str]] = set()
    for each in package.dependencies:
        same = (each.name, each.tag)
        if same in seen and not each.condition:
            message = f"<{each.tag}>{each.name}</{each.tag}> stands here a second time"
            yield fault("dependency-twice", package.path, each.line, message)
        seen.add(same)
    yield from _check_undeclared(package, repository)
    yield from _check_exported(package)
    if not package.is_metapackage:
        yield from _check_unused(package, repository)


def _check_undeclared(package: Package, repository: RosRepository) -> Iterator[CodeFinding]:
    reported = {package.name}
    for use in uses(package, repository.known):
        if use.name in reported or package.declared & {use.name, *use.accepted}:
            continue
        reported.add(use.name)
        message = f"{use.how} is of {quoted(use.name)}, which package.xml does not name"
        yield fault("undeclared-dependency", use.path, use.line, message)


def _check_exported(package: Package) -> Iterator[CodeFinding]:
    """Yield what catkin refuses: exported dependencies that are not installed with the package."""
    running = {each.name for each in package.dependencies if each.tag in _RUN_TAGS}
    for command in package.commands("catkin_package"):
        for each in command.after("CATKIN_DEPENDS", CATKIN_PACKAGE_KEYWORDS):
            if each.is_known and each.text in package.declared and each.text not in running:
                message = f"CATKIN_DEPENDS names {quoted(each.text)}, which package.xml does not name to run with"
                yield fault("undeclared-dependency", command.path, each.line, message)


def _check_unused(package: Package, repository: RosRepository) -> Iterator[CodeFinding]:
    wanted = [
        each
        for each in package.dependencies
        if each.tag in BUILD_TAGS[:2] and each.name in repository.known and not each.condition
    ]
    if not wanted:
        return
    texts = [
        package.tree.text(path) for path in package.files if path != package.path and not path.endswith((".rst", ".md"))
    ]
    for each in wanted:
        if not any(each.name in text for text in texts):
            message = f"no file of the package names {quoted(each.name)}"
            yield fault("unused-dependency", package.path, each.line, message)
