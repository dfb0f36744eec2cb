"""Python source, read by its syntax tree and never run: calls, imports, and names that are assigned once."""

import ast
import warnings
from collections.abc import Iterator


class PythonFile:
    """Syntax tree of a file, and the meaning of its names."""

    def __init__(self, module: ast.Module) -> None:
        """Collect the names of a module."""
        self.module = module
        self.nodes = list(ast.walk(module))
        self.values: dict[str, ast.expr | None] = {}
        """Expressions of names and attributes of self that are assigned once; None for others."""
        self._imported: dict[str, list[str]] = {}
        for node in self.nodes:
            if isinstance(node, ast.Import):
                self._imported |= {each.asname: each.name.split(".") for each in node.names if each.asname}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                parts = node.module.split(".")
                self._imported |= {each.asname or each.name: [*parts, each.name] for each in node.names}
            elif isinstance(node, ast.Assign) and len(node.targets) == 1 and (name := _name_of(node.targets[0])):
                self.values[name] = None if name in self.values else node.value

    def calls(self) -> Iterator[tuple[ast.Call, list[str]]]:
        """Yield every call, with the parts of the function's name."""
        for node in self.nodes:
            if isinstance(node, ast.Call):
                yield node, self.dotted_name(node.func)

    def dotted_name(self, node: ast.expr) -> list[str]:
        """Return the parts of a dotted name, its first one resolved by the imports."""
        parts: list[str] = []
        while isinstance(node, ast.Attribute):
            parts.append(node.attr)
            node = node.value
        if not isinstance(node, ast.Name):
            return parts[::-1]
        return [*self._imported.get(node.id, [node.id]), *parts[::-1]]

    def value(self, node: ast.expr | None) -> ast.expr | None:
        """Return the value of a name, None if it is not known; other expressions as they are."""
        return self.values.get(name) if node is not None and (name := _name_of(node)) else node

    def text(self, node: ast.expr | None) -> str | None:
        """Return the text that an expression or its name stands for; None for others."""
        value = self.value(node)
        return value.value if isinstance(value, ast.Constant) and isinstance(value.value, str) else None


def parse_python(text: str) -> PythonFile | None:
    """Parse Python; None if it does not parse."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # invalid escapes in the strings of others
            return PythonFile(ast.parse(text))
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return None


def argument_of(call: ast.Call, at: int | None, keyword: str) -> ast.expr | None:
    """Return an argument of a call by its index, if it has one, or its keyword."""
    if at is not None and len(call.args) > at:
        return call.args[at]
    return next((each.value for each in call.keywords if each.arg == keyword), None)


def imported_modules(node: ast.AST) -> list[tuple[int, str]]:
    """Return what an import may name as a module: dots of a relative import, and dotted name, the shortest first."""
    if isinstance(node, ast.Import):
        return [(0, each.name) for each in node.names]
    if not isinstance(node, ast.ImportFrom):
        return []
    base = [node.module] if node.module else []
    return [(node.level, ".".join([*base, *tail])) for tail in ([], *([each.name] for each in node.names))]


def _name_of(node: ast.expr) -> str:
    """Return the text of a name or an attribute of self; empty for others."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "self":
        return f"self.{node.attr}"
    return ""
