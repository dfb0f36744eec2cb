"""Checks of what CMakeLists.txt and setup.py build, generate and install."""

import ast
import re
from collections.abc import Iterator

from calibration.addons.analysis.results import CodeFinding
from calibration.addons.analysis.ros import fault, quoted
from calibration.addons.analysis.ros.cmake import CATKIN_PACKAGE_KEYWORDS, Argument, CMakeCommand
from calibration.addons.analysis.ros.package import FOLDER_OF_SUFFIX, Package, Unreadable, lines_of
from calibration.addons.analysis.ros.repository import RosRepository, module_places
from calibration.addons.analysis.ros.tree import SOURCE_SUFFIXES, parse_python
from calibration.addons.analysis.ros.uses import BUILT_IN_TYPES

_INSTALL_KEYWORDS = (
    *("TARGETS", "FILES", "PROGRAMS", "DIRECTORY", "DESTINATION", "PERMISSIONS", "CONFIGURATIONS", "COMPONENT"),
    *("RENAME", "OPTIONAL", "ARCHIVE", "LIBRARY", "RUNTIME", "OBJECTS", "FRAMEWORK", "BUNDLE", "PRIVATE_HEADER"),
    *("PUBLIC_HEADER", "RESOURCE", "INCLUDES", "EXPORT", "FILES_MATCHING", "PATTERN", "REGEX", "EXCLUDE", "TYPE"),
    *("USE_SOURCE_PERMISSIONS", "FILE_PERMISSIONS", "DIRECTORY_PERMISSIONS", "NAMELINK_SKIP", "NAMELINK_ONLY"),
    *("MESSAGE_NEVER", "EXCLUDE_FROM_ALL", "SCRIPT", "CODE"),
)
"""Keywords of ``install``."""
_COMMANDS_WITHOUT_TARGET = (
    *("install", "target_link_libraries", "target_include_directories", "target_compile_features", "add_dependencies"),
    *("target_compile_definitions", "target_compile_options", "set_target_properties", "ament_target_dependencies"),
    *("catkin_package", "ament_export_libraries", "ament_export_targets", "rclcpp_components_register_node"),
    *("rclcpp_components_register_nodes", "set", "list", "unset", "message", "project", "find_package", "if", "elseif"),
)
"""Commands that make no target."""
_INTERFACE_KEYWORDS = (
    *("DIRECTORY", "FILES", "NOINSTALL", "DEPENDENCIES", "LIBRARY_NAME", "SKIP_INSTALL", "ADD_LINTER_TESTS"),
)
_KIND_OF_INTERFACE_LIST = {"add_message_files": "msg", "add_service_files": "srv", "add_action_files": "action"}
_ROS2_FIELD = re.compile(r"(?!.*__)(?!.*_$)[a-z][a-z0-9_]*")


def check_builds(repository: RosRepository) -> Iterator[CodeFinding]:
    """Check every package."""
    for package in repository.packages:
        yield from _check_sources(package)
        yield from _check_targets(package)
        yield from _check_found_packages(package)
        yield from _check_interface_lists(package)
        yield from _check_fields(package, repository)
        yield from _entry_points(package)


def made_words(package: Package) -> frozenset[str]:
    """Return all arguments of commands that may make files or targets."""
    return frozenset(
        word
        for each in package.cmake
        if each.name not in _COMMANDS_WITHOUT_TARGET
        for text in each.texts
        for word in (text, text.rpartition("/")[2])
    )


def _check_sources(package: Package) -> Iterator[CodeFinding]:
    for command in package.commands("add_executable", "add_library"):
        for each in command.arguments[1:]:
            if each.text.endswith(SOURCE_SUFFIXES):
                yield from _check_existence(package, command, each)
    made = made_words(package)
    for command in package.commands("install", "catkin_install_python"):
        kinds = ("FILES", "PROGRAMS", "DIRECTORY") if command.name == "install" else ("PROGRAMS",)
        if command.texts[:1] and command.texts[0] in kinds and "OPTIONAL" not in command.texts:
            for each in command.after(command.texts[0], _INSTALL_KEYWORDS):
                if each.text.rpartition("/")[2] not in made:
                    yield from _check_existence(package, command, each)


def _check_existence(package: Package, command: CMakeCommand, argument: Argument) -> Iterator[CodeFinding]:
    place = command.place(argument.text)
    if place is None or package.tree.has(place):
        return
    folder, _, name = place.rpartition("/")
    generated = [each for each in package.cmake if each.name in ("configure_file", "add_custom_command", "file")]
    if any(text.endswith(name) for each in generated for text in each.texts):
        return
    beside = [path.rpartition("/")[2] for path in package.tree.present if path.rpartition("/")[0] == folder]
    message = f"{command.name} names {quoted(argument.text)}, which does not exist"
    yield fault("no-such-source", command.path, argument.line, message, name, beside)


def _check_targets(package: Package) -> Iterator[CodeFinding]:
    built = {each.texts[0] for each in package.cmake if each.name not in _COMMANDS_WITHOUT_TARGET and each.texts}
    made = made_words(package)
    if any("$" in each for each in built if each) or any(path.endswith(".cmake") for path in package.files):
        return
    for command in package.cmake:
        if command.name == "install":
            names = command.after("TARGETS", _INSTALL_KEYWORDS)
        elif command.name == "catkin_package":
            names = command.after("LIBRARIES", CATKIN_PACKAGE_KEYWORDS)
        elif command.name in ("target_link_libraries", "ament_target_dependencies", "target_include_directories"):
            names = list(command.arguments[:1])
        else:
            continue
        for each in names:
            if each.is_known and each.text not in built | made and "::" not in each.text and "/" not in each.text:
                message = f"{command.name} names {quoted(each.text)}, which no command builds"
                yield fault("no-such-target", command.path, each.line, message, each.text, built)


def _check_found_packages(package: Package) -> Iterator[CodeFinding]:
    """Yield dependencies of targets and interfaces that CMake has not found before."""
    if not package.is_ros2 or "ament_auto_find_build_dependencies" in package.build_words:
        return
    found: set[str] = set()
    for command in package.cmake:
        words = command.arguments
        if command.name == "find_package":
            found.update(command.texts[:1])
        elif command.name == "ament_target_dependencies":
            keys = ("SYSTEM", "PUBLIC", "INTERFACE", "PRIVATE")
            yield from _not_found(command, [each for each in words[1:] if each.text not in keys], found)
        elif command.name == "rosidl_generate_interfaces":
            yield from _not_found(command, command.after("DEPENDENCIES", _INTERFACE_KEYWORDS), found)
        elif command.name == "include":
            return  # what it finds is not read


def _not_found(command: CMakeCommand, names: list[Argument], found: set[str]) -> Iterator[CodeFinding]:
    for each in names:
        if each.is_known and each.text not in found and not any("$" in name for name in found):
            message = f"{command.name} names {quoted(each.text)}, for which there is no find_package before"
            yield fault("not-found-in-cmake", command.path, each.line, message)


def _check_interface_lists(package: Package) -> Iterator[CodeFinding]:
    """Check lists of interfaces against the files."""
    listed: set[str] = set()
    complete = set(FOLDER_OF_SUFFIX.values())
    calls = package.commands(*_KIND_OF_INTERFACE_LIST, "rosidl_generate_interfaces")
    for command in calls:
        if command.name == "rosidl_generate_interfaces":
            entries = [each for each in command.arguments[1:] if each.text.endswith((*FOLDER_OF_SUFFIX, ".idl"))]
            folder, unknown = "", any("$" in text for text in command.texts[1:])
        else:
            kind = _KIND_OF_INTERFACE_LIST[command.name]
            folder = next((each.text for each in command.after("DIRECTORY", _INTERFACE_KEYWORDS)), kind) + "/"
            entries = command.after("FILES", _INTERFACE_KEYWORDS)
            unknown = not entries or any("$" in each.text for each in entries)
        if unknown:
            complete = {kind for kind in complete if folder not in ("", f"{kind}/")}
        for each in entries:
            place = command.place(folder + each.text)
            if place is None:
                continue
            listed.add(place)
            if not package.tree.has(place):
                names = [path.rpartition("/")[2] for path in package.files if path.endswith(tuple(FOLDER_OF_SUFFIX))]
                message = f"{command.name} names {quoted(each.text)}, which does not exist"
                name = each.text.rpartition("/")[2]
                yield fault("no-such-interface", command.path, each.line, message, name, names)
    for path in package.files if package.cmake else ():
        own = _kind_of_interface(path)
        folder, _, name = path.removeprefix(package.inside("")).rpartition("/")
        if own in complete and folder == own and path not in listed and not _is_named_in_build(package, name):
            message = "CMakeLists.txt does not name this file, so nothing is generated"
            yield fault("interface-not-built", path, 1, message)


def _kind_of_interface(path: str) -> str | None:
    return next((kind for suffix, kind in FOLDER_OF_SUFFIX.items() if path.endswith(suffix)), None)


def _is_named_in_build(package: Package, name: str) -> bool:
    """Whether a word of the build names a file, or an unknown variable may."""
    return name in package.build_text or name.rpartition(".")[0] in package.build_words


def _check_fields(package: Package, repository: RosRepository) -> Iterator[CodeFinding]:
    interfaces = {path.rpartition("/")[2].partition(".")[0] for path in package.files if path.endswith(".msg")}
    for path in package.files:
        if _kind_of_interface(path) is None or path.split("/")[-2:-1] not in (
            [kind] for kind in FOLDER_OF_SUFFIX.values()
        ):
            continue
        for each in lines_of(package.tree.text(path)):
            if isinstance(each, Unreadable):
                message = f"found {quoted(each.text)}, expected a type and a name"
                yield fault("interface-field", path, each.line, message)
                continue
            owner, separator, name = each.type.rpartition("/")
            if separator:
                other = repository.by_name.get(owner)
                files = {file.rpartition("/")[2] for file in other.files} if other else {f"{name}.msg"}
                if not files & {f"{name}.msg", f"{name}.idl"}:
                    messages = [file.partition(".")[0] for file in sorted(files) if file.endswith(".msg")]
                    message = f"{quoted(owner)} has no message {quoted(name)}"
                    yield fault("interface-field", path, each.line, message, name, messages)
            elif each.type not in interfaces | BUILT_IN_TYPES:
                message = f"{quoted(each.type)} is no built-in type, and no message of this package"
                yield fault("interface-field", path, each.line, message, each.type, interfaces | BUILT_IN_TYPES)
            if package.is_ros2 and not each.is_constant and not _ROS2_FIELD.fullmatch(each.name):
                message = f"found the field {quoted(each.name)}: ROS 2 takes small letters, digits and single _"
                yield fault("interface-field", path, each.line, message)


def _entry_points(package: Package) -> Iterator[CodeFinding]:
    setup = package.setup
    if setup is None:
        return
    tree = package.tree
    for each in setup.entry_points:
        files = module_places(package, each.module)
        file = next((path for path in files if tree.has(path)), None)
        if file is None:
            if "package_dir" in package.build_text and "src" not in package.build_text:
                continue
            folder = files[0].rpartition("/")[0]
            names = [path.rpartition("/")[2].removesuffix(".py") for path in package.files if path.startswith(folder)]
            message = f"{each.name} is to run the module {quoted(each.module)}, which does not exist"
            yield fault("no-such-entry-point", each.path, each.line, message, each.module.rpartition(".")[2], names)
            continue
        source = parse_python(tree.text(file))
        if source is None or not each.function or "." in each.function:
            continue
        names = list(_defined_names(source.module))
        if each.function not in names and "*" not in names:
            message = f"{each.name} is to call {quoted(each.function)}, which {file} does not define"
            yield fault("no-such-entry-point", each.path, each.line, message, each.function, names)


def _defined_names(module: ast.Module) -> Iterator[str]:
    """Yield the names that a module defines outside of functions and classes, and ``*`` for what is not written."""
    for node in module.body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name
        else:
            for each in ast.walk(node):
                if isinstance(each, ast.FunctionDef | ast.ClassDef):
                    yield each.name
                elif isinstance(each, ast.alias):
                    yield each.asname or each.name.partition(".")[0]
                elif isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store):
                    yield each.id
