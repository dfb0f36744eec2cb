"""Functions of Python files: where they are, which of their lines are theirs alone, and which have nothing to test."""

import ast
from collections.abc import Iterator
from dataclasses import dataclass

CACHES = ("cache", "lru_cache", "cached_property", "cached", "memoize")
"""Decorators after which a call may not run the function."""
UNTESTED_NAMES = ("__repr__", "__str__", "__hash__", "__del__", "__format__", "__dir__", "__getstate__", "__sizeof__")
"""Special methods that are written for people or for Python, and that tests run by the way."""
WITHOUT_EFFECT = ("abstractmethod", "overload", "abstractproperty")
"""Decorators of functions whose body is not meant to run."""


@dataclass(frozen=True)
class PythonFunction:
    """A function or method of a Python file."""

    path: str
    """Of its file, in the repository."""
    name: str
    """With the classes and functions around it: ``Arm.move``."""
    line: int
    """Line of ``def``."""
    column: int
    first: int
    """First line, that of the first decorator if there are any."""
    last: int
    own_lines: frozenset[int]
    """Lines of its body that belong to no function within it; empty if the body begins in the line of ``def``."""
    trivial: bool
    """Whether it has nothing to test: an empty body, a constant, a getter, a setter, text for people."""
    decorators: tuple[str, ...]
    """Names, without modules and arguments."""
    generator: bool
    parameters: tuple[str, ...]
    """Names of the arguments, in the order of the signature."""
    fields: tuple[str, ...] = ()
    """Attributes of its first argument that it sets."""


def functions_of(path: str, source: bytes) -> list[PythonFunction]:
    """Return the functions of a file in the order of their lines; none if this Python cannot parse it."""
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return []
    return sorted(_functions_in(tree, path, ()), key=lambda each: (each.line, each.column))


def _functions_in(node: ast.AST, path: str, names: tuple[str, ...]) -> Iterator[PythonFunction]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            yield _function_of(child, path, names)
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield from _functions_in(child, path, (*names, child.name))
        else:
            yield from _functions_in(child, path, names)


def _function_of(node: ast.FunctionDef | ast.AsyncFunctionDef, path: str, names: tuple[str, ...]) -> PythonFunction:
    decorators = tuple(filter(None, map(_name_of_decorator, node.decorator_list)))
    last = node.end_lineno or node.lineno
    own = set(range(node.body[0].lineno, last + 1)) if node.body[0].lineno > node.lineno else set()
    for inner in _inner_functions(node):
        own -= set(range(inner.body[0].lineno, (inner.end_lineno or inner.lineno) + 1))
    arguments = node.args
    ordered = [*arguments.posonlyargs, *arguments.args, arguments.vararg, *arguments.kwonlyargs, arguments.kwarg]
    parameters = tuple(each.arg for each in ordered if each is not None)
    return PythonFunction(
        path,
        ".".join((*names, node.name)),
        node.lineno,
        node.col_offset,
        min([node.lineno, *(each.lineno for each in node.decorator_list)]),
        last,
        frozenset(own),
        node.name in UNTESTED_NAMES or bool(set(decorators) & set(WITHOUT_EFFECT)) or _has_nothing_to_test(node.body),
        decorators,
        any(isinstance(each, ast.Yield | ast.YieldFrom) for each in _own_nodes(node)),
        parameters,
        tuple(dict.fromkeys(_fields_set(node, parameters[0]))) if parameters else (),
    )


def _own_nodes(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes within a function that belong to no function or class within it."""
    for child in ast.iter_child_nodes(node):
        yield child
        if not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda | ast.ClassDef):
            yield from _own_nodes(child)


def _fields_set(node: ast.AST, name: str) -> Iterator[str]:
    """Yield the attributes of a variable that a function sets."""
    for each in _own_nodes(node):
        match each:
            case ast.Attribute(value=ast.Name(id=found), ctx=ast.Store()) if found == name:
                yield each.attr


def _inner_functions(node: ast.AST) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    for child in ast.walk(node):
        if child is not node and isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            yield child


def _name_of_decorator(node: ast.expr) -> str:
    while isinstance(node, ast.Call):
        node = node.func
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def _has_nothing_to_test(body: list[ast.stmt]) -> bool:
    """Return whether a body is empty, only raises, or only returns a constant or gets or sets one attribute."""
    statements = [each for each in body if not isinstance(each, ast.Pass) and not _is_constant_expression(each)]
    if not statements:
        return True
    if len(statements) > 1:
        return False
    match statements[0]:
        case ast.Raise() | ast.Return(value=None | ast.Constant()):
            return True
        case ast.Return(value=ast.Attribute(value=ast.Name())):
            return True
        case ast.Assign(targets=[ast.Attribute(value=ast.Name())], value=ast.Name()):
            return True
    return False


def _is_constant_expression(statement: ast.stmt) -> bool:
    """Return whether a statement is a docstring or an ellipsis."""
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
