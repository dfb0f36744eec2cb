"""Checks of launch files and robot descriptions: what they start, include and name."""

import re
from collections.abc import Iterator

from calibration.addons.analysis.finding import CodeFinding
from calibration.addons.analysis.ros.executables import is_installed
from calibration.addons.analysis.ros.faults import fault, quoted
from calibration.addons.analysis.ros.launch import Include, Launch, package_of
from calibration.addons.analysis.ros.repository import RosRepository
from calibration.addons.analysis.ros.tree import without_comments
from calibration.base.text import did_you_mean

_SUFFIXES_READ_ONLY = (
    *(".launch", ".py", ".xml", ".yaml", ".yml", ".urdf", ".xacro", ".srdf", ".sdf", ".world", ".rviz", ".gazebo"),
    *(".stl", ".dae", ".obj", ".json", ".pgm"),
)
"""Suffixes of files that launch files and descriptions read; others may be written."""
_RESOURCE_PATH = re.compile(r"package://[\w-]+/[^\"'\s<>&]+|\$\(find[ \t]+[\w-]+\)/[^\"'\s<>&]+")


def check_launches(repository: RosRepository) -> Iterator[CodeFinding]:
    """Check every launch file and robot description."""
    for launch in repository.launches.values():
        yield from _check_executables(launch, repository)
        for text, line in launch.files:
            yield from _check_file(text, launch.path, line, repository)
        for include in launch.includes:
            yield from _check_include(include, repository)
        yield from _check_arguments(launch)
        yield from _check_cycles(launch, repository)
    for package in repository.packages:
        for path in package.files:
            if path.endswith((".urdf", ".xacro")):
                text = without_comments(repository.tree.text(path))
                for number, content in enumerate(text.split("\n"), 1):
                    for match in _RESOURCE_PATH.findall(content):
                        named = re.sub(r"\$\(find[ \t]+([\w-]+)\)", r"package://\1", match)
                        yield from _check_file(named, path, number, repository)


def _check_executables(launch: Launch, repository: RosRepository) -> Iterator[CodeFinding]:
    for start in launch.starts:
        package = repository.by_name.get(start.package or "")
        if package is None or start.executable is None:
            continue
        executables = repository.executables(package)
        named = start.executable in executables.files or start.executable in package.build_words
        if not named and executables.is_complete:
            names = [each for each, sources in executables.files.items() if sources]
            hint = did_you_mean(start.executable, names)
            message = f"{quoted(package.name)} has no executable {quoted(start.executable)}{hint}"
            yield fault("no-such-executable", start.path, start.line, message)


def _check_file(text: str, path: str, line: int, repository: RosRepository) -> Iterator[CodeFinding]:
    named = package_of(text)
    package = repository.by_name.get(named[0]) if named else None
    if named is None or package is None or not named[1].lower().endswith(_SUFFIXES_READ_ONLY) or _is_test(path):
        return
    inside = named[1]
    if inside.rpartition("/")[2] in package.build_words:  # generated, downloaded, or installed by name
        return
    folders = {package.folder.rpartition("/")[2], package.name}
    if any(f"{each}/{inside}" in repository.image_text for each in folders):
        return  # copied there when an image is built
    if not repository.tree.has(package.inside(inside)):
        folder, _, name = inside.rpartition("/")
        beside = [each for each in package.files if package.relative(each).rpartition("/")[0] == folder]
        hint = did_you_mean(name, [each.rpartition("/")[2] for each in beside])
        message = f"{quoted(package.name)} has no file {quoted(inside)}{hint}"
        yield fault("no-such-file", path, line, message)
    elif not is_installed(package, inside):
        message = f"{quoted(package.name)} does not install {quoted(inside)}: it is not found after an installation"
        yield fault("not-installed", path, line, message)


def _check_include(include: Include, repository: RosRepository) -> Iterator[CodeFinding]:
    launch = repository.included(include)
    if launch is None or include.passes_all:
        return
    python = launch.path.endswith(".py")
    for name, line in include.arguments.items():
        if name not in launch.arguments and not (python and name in dict(launch.used)):
            hint = did_you_mean(name, launch.arguments)
            message = f"{launch.path} declares no argument {quoted(name)}{hint}"
            yield fault("launch-argument", include.path, line, message)
    for name, has_value in launch.arguments.items():
        if not has_value and name not in include.arguments:
            message = f"{launch.path} needs the argument {quoted(name)}, which is not given"
            yield fault("launch-argument", include.path, include.line, message)


def _check_arguments(launch: Launch) -> Iterator[CodeFinding]:
    for name, line in launch.used:
        if name and name not in launch.arguments and re.fullmatch(r"\w+", name):
            hint = did_you_mean(name, launch.arguments)
            if launch.path.endswith(".py") and not hint:
                continue  # the file that includes it may declare it
            message = f"the argument {quoted(name)} is used, but not declared{hint}"
            yield fault("launch-argument", launch.path, line, message)


def _check_cycles(launch: Launch, repository: RosRepository) -> Iterator[CodeFinding]:
    for include in launch.includes:
        if include.conditional:
            continue
        seen: dict[str, None] = {}
        open_launches = [repository.included(include)]
        while open_launches:
            each = open_launches.pop()
            if each is None or each.path in seen:
                continue
            seen[each.path] = None
            open_launches += [repository.included(inner) for inner in each.includes if not inner.conditional]
        if launch.path in seen:
            message = f"{quoted(include.file or '')} includes this file again, without an end"
            yield fault("launch-cycle", launch.path, include.line, message)


def _is_test(path: str) -> bool:
    """Whether a file is of a test, which runs beside the sources."""
    return path.endswith(".test") or any(part in ("test", "tests") for part in path.split("/")[:-1])
