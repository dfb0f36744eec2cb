"""Launch files in Python, read by their syntax tree and never run."""

import ast
from collections.abc import Iterator
from dataclasses import replace

from calibration.addons.analysis.ros.launch import Include, Launch, LaunchParameter, NodeStart, Remapping, known
from calibration.addons.analysis.ros.tree import PythonFile, argument_of, parse_python

_UNKNOWN_PART = "$(?)"
_MAX_EXPRESSION_DEPTH = 30
_NODE_CLASSES = ("Node", "LifecycleNode")
_SHARE_FUNCTIONS = ("get_package_share_directory", "get_package_share_path", "FindPackageShare")
_JOINING_FUNCTIONS = ("join", "PathJoinSubstitution", "joinpath")
_IDENTITY_FUNCTIONS = (
    *("PythonLaunchDescriptionSource", "XMLLaunchDescriptionSource", "AnyLaunchDescriptionSource", "Path", "str"),
    *("YAMLLaunchDescriptionSource", "FrontendLaunchDescriptionSource", "TextSubstitution", "ParameterFile", "abspath"),
)
"""Calls whose first argument is their value, for us."""


def read_launch_python(path: str, source: str) -> Launch | None:
    """Read a launch file in Python; None if it is no such file."""
    file = parse_python(source) if "generate_launch_description" in source else None
    return None if file is None else _LaunchReader(path, file).read()


class _LaunchReader:
    """Reader of one file; a text has ``$(?)`` for parts that are not known."""

    def __init__(self, path: str, file: PythonFile) -> None:
        self._path = path
        self._file = file
        self._depth = 0

    def read(self) -> Launch:
        """Return what the calls in the file start, include, declare and use, wherever they stand."""
        launch = Launch(self._path)
        pushed = False
        for node, parts in self._file.calls():
            name = "".join(parts[-1:])
            pushed |= name in ("PushRosNamespace", "PushROSNamespace")
            if name in ("OpaqueFunction", "ComposableNodeContainer"):
                launch.unresolved.append(f"{self._path}: {name}")
            elif name in _NODE_CLASSES and argument_of(node, None, "package") is not None:
                launch.starts.append(self._read_start(node))
            elif name == "IncludeLaunchDescription":
                launch.includes.append(self._read_include(node))
            elif name == "DeclareLaunchArgument" and (text := self._known_text(argument_of(node, 0, "name"))):
                launch.arguments[text] = argument_of(node, 1, "default_value") is not None
            elif name == "LaunchConfiguration" and (text := self._known_text(argument_of(node, 0, "variable_name"))):
                launch.used.append((text, node.lineno))
        if pushed:
            launch.unresolved.append(f"{self._path}: the namespaces that PushRosNamespace sets")
            launch.starts = [replace(each, namespace=None) for each in launch.starts]
            launch.includes = [replace(each, namespace=None) for each in launch.includes]
        paths = (
            (self._text(node), node.lineno)
            for node in self._file.nodes
            if isinstance(node, ast.BinOp)
            or (isinstance(node, ast.Call) and self._function_name(node) not in _IDENTITY_FUNCTIONS)
        )
        files = ((text, line) for text, line in paths if text.startswith("package://") and text.count("/") > 2)
        launch.files = list(dict.fromkeys(files))
        return launch

    def _function_name(self, call: ast.Call) -> str:
        return "".join(self._file.dotted_name(call.func)[-1:])

    def _known_text(self, node: ast.expr | None) -> str | None:
        return None if node is None else known(self._text(node))

    def _text(self, node: ast.expr) -> str:
        """Return the value of an expression."""
        self._depth += 1
        try:
            return self._evaluate(node) if self._depth < _MAX_EXPRESSION_DEPTH else _UNKNOWN_PART
        finally:
            self._depth -= 1

    def _evaluate(self, node: ast.expr) -> str:
        match node:
            case ast.Constant(str(text)):
                return text
            case ast.Name():
                value = self._file.value(node)
                return _UNKNOWN_PART if value is None else self._text(value) or _UNKNOWN_PART
            case ast.BinOp(left, ast.Add(), right):
                return self._text(left) + self._text(right)
            case ast.BinOp(left, ast.Div(), right):
                return f"{self._text(left)}/{self._text(right)}"
            case ast.List(elements) | ast.Tuple(elements):
                return "".join(map(self._text, elements))
            case ast.Call():
                return self._evaluate_call(node)
        return _UNKNOWN_PART

    def _evaluate_call(self, node: ast.Call) -> str:
        name = self._function_name(node)
        if name in _SHARE_FUNCTIONS:
            package = self._known_text(argument_of(node, 0, "package"))
            return f"package://{package}" if package else _UNKNOWN_PART
        if name in _JOINING_FUNCTIONS:
            match node.args:
                case [ast.List(given) | ast.Tuple(given)]:
                    parts = list(map(self._text, given))
                case given:
                    parts = list(map(self._text, given))
            if name == "joinpath" and isinstance(node.func, ast.Attribute):
                parts.insert(0, self._text(node.func.value))
            return "/".join(each.strip("/") if at else each.rstrip("/") for at, each in enumerate(parts))
        return self._text(node.args[0]) if name in _IDENTITY_FUNCTIONS and node.args else _UNKNOWN_PART

    def _read_start(self, node: ast.Call) -> NodeStart:
        given = {each.arg: each.value for each in reversed(node.keywords)}
        parameters, files = self._read_parameters(given.get("parameters"))
        arguments = given.get("arguments")
        return NodeStart(
            package=self._known_text(given.get("package")),
            executable=self._known_text(given.get("executable")),
            name=self._known_text(given.get("name")),
            path=self._path,
            line=given.get("executable", node).lineno,
            namespace=self._known_text(given["namespace"]) if "namespace" in given else "",
            is_named="name" in given,
            conditional="condition" in given,
            remappings=tuple(self._read_remappings(given.get("remappings"))),
            parameters=tuple(parameters),
            parameter_files=tuple(files),
            arguments=tuple(map(self._text, arguments.elts)) if isinstance(arguments, ast.List) else (),
        )

    def _read_remappings(self, node: ast.expr | None) -> Iterator[Remapping]:
        if node is None:
            return
        value = self._file.value(node)
        if not isinstance(value, ast.List | ast.Tuple):
            yield Remapping(None, None, node.lineno)
            return
        for each in value.elts:
            pair = each.elts if isinstance(each, ast.Tuple) and len(each.elts) == 2 else (None, None)
            old, new = map(self._known_text, pair)
            yield Remapping(old, new, each.lineno)

    def _read_parameters(self, node: ast.expr | None) -> tuple[list[LaunchParameter], list[str]]:
        found: list[LaunchParameter] = []
        files: list[str] = []
        value = self._file.value(node)
        for each in value.elts if isinstance(value, ast.List) else ():
            inner = self._file.value(each)
            if isinstance(inner, ast.Dict):
                found += [LaunchParameter(name, self._path, line) for name, line in self._texts_of_keys(inner)]
            elif (text := self._text(each)) != _UNKNOWN_PART:
                files.append(text)
        return found, files

    def _read_include(self, node: ast.Call) -> Include:
        source = argument_of(node, 0, "launch_description_source")
        given = argument_of(node, None, "launch_arguments")
        if isinstance(given, ast.Call) and isinstance(given.func, ast.Attribute):  # {...}.items()
            given = given.func.value
        given = self._file.value(given)
        return Include(
            file=None if source is None else self._text(source),
            path=self._path,
            line=(source or node).lineno,
            arguments=dict(self._texts_of_keys(given)) if isinstance(given, ast.Dict) else {},
            conditional=argument_of(node, None, "condition") is not None,
            passes_all=given is not None and not isinstance(given, ast.Dict),
        )

    def _texts_of_keys(self, node: ast.Dict) -> Iterator[tuple[str, int]]:
        for key in node.keys:
            if key is not None and (text := self._known_text(key)):
                yield text, key.lineno
