"""Launch files in Python, read by their syntax tree and never run."""

import ast
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

from calibration.addons.analysis.ros.launch import Include, Launch, LaunchParameter, NodeStart, Remapping, known
from calibration.addons.analysis.ros.package import parse_python

_UNKNOWN_PART = "$(?)"
_NODE_CLASSES = ("Node", "LifecycleNode")
_SHARE_FUNCTIONS = ("get_package_share_directory", "get_package_share_path", "FindPackageShare")
_JOINING_FUNCTIONS = ("join", "PathJoinSubstitution", "joinpath")
_IDENTITY_FUNCTIONS = (
    *("PythonLaunchDescriptionSource", "XMLLaunchDescriptionSource", "AnyLaunchDescriptionSource", "Path", "str"),
    *("YAMLLaunchDescriptionSource", "FrontendLaunchDescriptionSource", "TextSubstitution", "ParameterFile", "abspath"),
)
"""Calls whose first argument is their value, for us."""


@dataclass
class _File:
    path: str
    values: dict[str, ast.expr | None] = field(default_factory=dict)
    """Expressions of names that are assigned once; None for others."""
    depth: int = 0


def read_launch_python(path: str, source: str) -> Launch | None:
    """Read a launch file in Python; None if it is no such file."""
    module = parse_python(source) if "generate_launch_description" in source else None
    if module is None:
        return None
    nodes = list(ast.walk(module))
    file = _File(path)
    for node in nodes:
        if isinstance(node, ast.Assign) and len(node.targets) == 1 and isinstance(node.targets[0], ast.Name):
            name = node.targets[0].id
            file.values[name] = None if name in file.values else node.value
    calls = [(node, _name_of_function(node.func)) for node in nodes if isinstance(node, ast.Call)]
    pushed = any(name in ("PushRosNamespace", "PushROSNamespace") for _, name in calls)
    unresolved = [f"{path}: {name}" for _, name in calls if name in ("OpaqueFunction", "ComposableNodeContainer")]
    starts = [
        _read_start(node, file)
        for node, name in calls
        if name in _NODE_CLASSES and _keyword_argument(node, "package") is not None
    ]
    includes = [_read_include(node, file) for node, name in calls if name == "IncludeLaunchDescription"]
    if pushed:
        unresolved.append(f"{path}: the namespaces that PushRosNamespace sets")
        starts = [replace(each, namespace=None) for each in starts]
        includes = [replace(each, namespace=None) for each in includes]
    declared = {
        text: bool(_keyword_argument(node, "default_value")) or len(node.args) > 1
        for node, name in calls
        if name == "DeclareLaunchArgument"
        and (text := known(_text_of_expression(_argument_of_call(node, 0, "name"), file)))
    }
    used = [
        (text, node.lineno)
        for node, name in calls
        if name == "LaunchConfiguration"
        and (text := known(_text_of_expression(_argument_of_call(node, 0, "variable_name"), file)))
    ]
    files = [
        (text, node.lineno)
        for node in nodes
        if isinstance(node, ast.expr) and (text := _file_of_expression(node, file))
    ]
    return Launch(
        path, tuple(starts), tuple(includes), declared, tuple(used), tuple(dict.fromkeys(files)), (), tuple(unresolved)
    )


def _name_of_function(function: ast.expr) -> str:
    return function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")


def _keyword_argument(node: ast.Call, name: str) -> ast.expr | None:
    return next((each.value for each in node.keywords if each.arg == name), None)


def _argument_of_call(node: ast.Call, at: int, name: str) -> ast.expr | None:
    return node.args[at] if len(node.args) > at else _keyword_argument(node, name)


def _file_of_expression(node: ast.expr, file: _File) -> str | None:
    """Return the path in a package that an outermost expression makes."""
    if not isinstance(node, ast.Call | ast.BinOp) or (
        isinstance(node, ast.Call) and _name_of_function(node.func) in _IDENTITY_FUNCTIONS
    ):
        return None
    text = _text_of_expression(node, file)
    return text if text is not None and text.startswith("package://") and text.count("/") > 2 else None


def _text_of_expression(node: ast.expr | None, file: _File) -> str | None:
    """Return the value of an expression, with ``$(?)`` for parts that are not known; None if there is none."""
    if node is None:
        return None
    file.depth += 1
    try:
        return _evaluate_text(node, file) if file.depth < 30 else _UNKNOWN_PART
    finally:
        file.depth -= 1


def _evaluate_text(node: ast.expr, file: _File) -> str:
    if isinstance(node, ast.Constant):
        return str(node.value) if isinstance(node.value, str) else _UNKNOWN_PART
    if isinstance(node, ast.Name):
        value = file.values.get(node.id)
        return _UNKNOWN_PART if value is None else _text_of_expression(value, file) or _UNKNOWN_PART
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Div):
        between = "/" if isinstance(node.op, ast.Div) else ""
        return between.join(_text_of_expression(each, file) or "" for each in (node.left, node.right))
    if isinstance(node, ast.List | ast.Tuple):
        return "".join(_text_of_expression(each, file) or "" for each in node.elts)
    if isinstance(node, ast.Call):
        return _evaluate_call(node, file)
    return _UNKNOWN_PART


def _evaluate_call(node: ast.Call, file: _File) -> str:
    name = _name_of_function(node.func)
    if name in _SHARE_FUNCTIONS:
        package = _text_of_expression(_argument_of_call(node, 0, "package"), file)
        return f"package://{package}" if known(package) else _UNKNOWN_PART
    if name in _JOINING_FUNCTIONS:
        given = (
            node.args[0].elts if len(node.args) == 1 and isinstance(node.args[0], ast.List | ast.Tuple) else node.args
        )
        parts = [_text_of_expression(each, file) or "" for each in given]
        if name == "joinpath" and isinstance(node.func, ast.Attribute):
            parts.insert(0, _text_of_expression(node.func.value, file) or "")
        return "/".join(each.strip("/") if at else each.rstrip("/") for at, each in enumerate(parts))
    if name in _IDENTITY_FUNCTIONS and node.args:
        return _text_of_expression(node.args[0], file) or ""
    return _UNKNOWN_PART


def _read_start(node: ast.Call, file: _File) -> NodeStart:
    parameters, files = _read_parameters(_keyword_argument(node, "parameters"), file)
    namespace = _keyword_argument(node, "namespace")
    arguments, executable = _keyword_argument(node, "arguments"), _keyword_argument(node, "executable")
    given = arguments.elts if isinstance(arguments, ast.List) else []
    return NodeStart(
        package=known(_text_of_expression(_keyword_argument(node, "package"), file)),
        executable=known(_text_of_expression(executable, file)),
        name=known(_text_of_expression(_keyword_argument(node, "name"), file)),
        path=file.path,
        line=(executable or node).lineno,
        namespace="" if namespace is None else known(_text_of_expression(namespace, file)),
        is_named=_keyword_argument(node, "name") is not None,
        conditional=_keyword_argument(node, "condition") is not None,
        remappings=tuple(_read_remappings(_keyword_argument(node, "remappings"), file)),
        parameters=tuple(parameters),
        parameter_files=tuple(files),
        arguments=tuple(_text_of_expression(each, file) or "" for each in given),
    )


def _read_remappings(node: ast.expr | None, file: _File) -> Iterator[Remapping]:
    if node is None:
        return
    value = file.values.get(node.id) if isinstance(node, ast.Name) else node
    if not isinstance(value, ast.List | ast.Tuple):
        yield Remapping(None, None, node.lineno)
        return
    for each in value.elts:
        pair = each.elts if isinstance(each, ast.Tuple) and len(each.elts) == 2 else (None, None)
        old, new = (known(_text_of_expression(part, file)) for part in pair)
        yield Remapping(old, new, each.lineno)


def _read_parameters(node: ast.expr | None, file: _File) -> tuple[list[LaunchParameter], list[str]]:
    if isinstance(node, ast.Name):
        node = file.values.get(node.id)
    found: list[LaunchParameter] = []
    files: list[str] = []
    for each in node.elts if isinstance(node, ast.List) else ():
        value = file.values.get(each.id) if isinstance(each, ast.Name) else each
        if isinstance(value, ast.Dict):
            names = [(key, known(_text_of_expression(key, file))) for key in value.keys if key is not None]
            found += [LaunchParameter(name, file.path, key.lineno) for key, name in names if name]
        elif (text := _text_of_expression(each, file)) is not None and text != _UNKNOWN_PART:
            files.append(text)
    return found, files


def _read_include(node: ast.Call, file: _File) -> Include:
    source = _argument_of_call(node, 0, "launch_description_source")
    given = _keyword_argument(node, "launch_arguments")
    if isinstance(given, ast.Call) and isinstance(given.func, ast.Attribute):  # {...}.items()
        given = given.func.value
    if isinstance(given, ast.Name):
        given = file.values.get(given.id)
    names: dict[str, int] = {}
    if isinstance(given, ast.Dict):
        names = {
            text: key.lineno
            for key in given.keys
            if key is not None and (text := known(_text_of_expression(key, file)))
        }
    return Include(
        file=_text_of_expression(source, file),
        path=file.path,
        line=(source or node).lineno,
        arguments=names,
        conditional=_keyword_argument(node, "condition") is not None,
        passes_all=given is not None and not isinstance(given, ast.Dict),
    )
