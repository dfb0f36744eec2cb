"""Expressions of xacro, evaluated node by node: Python never runs them, and what is not in this module is refused."""

import ast
import operator
import re
from collections.abc import Callable, Container, Iterator, Mapping
from typing import Any

from xacro import NameSpace, YamlDictWrapper

from calibration.robot.confinement import RefusedError

MAX_LENGTH = 10_000
"""Limit of an expression's characters."""
MAX_STEPS = 200_000
"""Limit of the nodes that one expression evaluates; a comprehension evaluates its own for each item."""
MAX_ITEMS = 1_000_000
"""Limit of the characters of a text, and of the items of a list."""
MAX_BITS = 10_000
"""Limit of an integer's size."""

_BUILTINS = """abs all any bool dict divmod enumerate filter float frozenset int isinstance issubclass len list map max
min ord range repr reversed round set slice sorted str sum tuple zip"""
CALLABLE = frozenset(_BUILTINS.split())
"""Functions of Python that an expression may call: those of xacro, without the ones that show what an object is made
of (``type``, ``vars``)."""
NOT_OF_MATH = frozenset(("comb", "factorial", "lcm", "perm", "prod"))
"""Functions of math that make integers without a limit."""
_OF_TEXT = """capitalize count endswith find index isalnum isalpha isdigit islower isspace isupper join lower lstrip
partition removeprefix removesuffix replace rfind rindex rpartition rsplit rstrip split splitlines startswith strip
title upper zfill"""
_OF_LIST = "append copy count extend index insert pop remove reverse sort"
_OF_MAPPING = "copy get items keys pop setdefault update values"
_METHODS: dict[type, frozenset[str]] = {
    str: frozenset(_OF_TEXT.split()),
    list: frozenset(_OF_LIST.split()),
    tuple: frozenset(("count", "index")),
    dict: frozenset(_OF_MAPPING.split()),
}
"""Methods that may be called, by the type of their object."""
_OPERATORS: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.MatMult: operator.matmul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.Pow: operator.pow,
    ast.LShift: operator.lshift,
    ast.RShift: operator.rshift,
    ast.BitAnd: operator.and_,
    ast.BitOr: operator.or_,
    ast.BitXor: operator.xor,
    ast.UAdd: operator.pos,
    ast.USub: operator.neg,
    ast.Invert: operator.invert,
    ast.Not: operator.not_,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
    ast.In: lambda item, items: item in items,
    ast.NotIn: lambda item, items: item not in items,
}
_SPECIFIERS = re.compile(r"%(?:\(\w*\))?[-+ #0]*(\*|\d*)(?:\.(\*|\d*))?")
_MAX_SHOWN = 60
_MAX_WIDTH = 3
"""Limit of the digits of a width in ``'%5.3f' % x``."""


def evaluate(expression: str, symbols: Mapping[str, Any], functions: Container[int]) -> Any:
    """Return the value of an expression.

    Args:
        expression: what stands between ``${`` and ``}``.
        symbols: values of its names.
        functions: identities (``id``) of the functions that it may use.

    Raises:
        RefusedError: it is longer, larger or more than an expression may be.
        Exception: what Python raises for it: SyntaxError, NameError, ZeroDivisionError, ...
    """
    if len(expression) > MAX_LENGTH:
        raise RefusedError(f"found an expression of {len(expression)} characters, expected {MAX_LENGTH} at most")
    return _Evaluation(symbols, functions).value(ast.parse(expression.strip(), mode="eval").body)


class _Evaluation:
    """The evaluation of one expression."""

    def __init__(self, symbols: Mapping[str, Any], functions: Container[int]) -> None:
        self._symbols, self._functions = symbols, functions
        self._variables: dict[str, Any] = {}  # of comprehensions
        self._steps = 0

    def value(self, node: ast.AST) -> Any:
        """Return the value of a node, which is no namespace: ``dict(python).values()`` would be all its functions."""
        found = self._value_or_namespace(node)
        if isinstance(found, NameSpace):
            raise RefusedError(f"an expression may not use the namespace '{_shortened(ast.unparse(node))}' as a value")
        return found

    def _value_or_namespace(self, node: ast.AST) -> Any:
        """Return the value of a node, if there is a method for its kind."""
        self._steps += 1
        if self._steps > MAX_STEPS:
            raise RefusedError(f"an expression takes more than {MAX_STEPS} steps")
        method: Callable[[Any], Any] | None = getattr(self, f"_{type(node).__name__}", None)
        if method is None:
            raise RefusedError(f"an expression may not contain {_kind(node)}")
        return self._usable(method(node), node)

    def _usable(self, value: Any, node: ast.AST) -> Any:
        if callable(value) and id(value) not in self._functions:
            raise RefusedError(f"an expression may not use '{_shortened(ast.unparse(node))}'")
        return _bounded(value)

    def _Constant(self, node: ast.Constant) -> Any:
        if not isinstance(node.value, int | float | str | None):
            raise RefusedError(f"an expression may not contain {type(node.value).__name__}")
        return node.value

    def _Name(self, node: ast.Name) -> Any:
        if node.id.startswith("__"):
            raise RefusedError(f"an expression may not contain the name {node.id}")
        if node.id in self._variables:
            return self._variables[node.id]
        try:
            return self._symbols[node.id]
        except KeyError:
            raise NameError(f"name '{node.id}' is not defined") from None

    def _Attribute(self, node: ast.Attribute) -> Any:
        return _item(self._value_or_namespace(node.value), node)

    def _Subscript(self, node: ast.Subscript) -> Any:
        owner = self._value_or_namespace(node.value)
        if not isinstance(owner, str | list | tuple | dict | range):
            raise RefusedError(f"an expression may not contain an item of {type(owner).__name__}")
        return owner[self.value(node.slice)]

    def _Slice(self, node: ast.Slice) -> slice:
        return slice(*(None if part is None else self.value(part) for part in (node.lower, node.upper, node.step)))

    def _Call(self, node: ast.Call) -> Any:
        function = self._function(node.func)
        named: dict[str, Any] = {}
        for keyword in node.keywords:
            given = self.value(keyword.value)
            named.update({keyword.arg: given} if keyword.arg else given)
        return function(*self._items(node.args), **named)

    def _function(self, node: ast.expr) -> Callable[..., Any]:
        """Return a method of a text or a collection, which is had nowhere but in its call, or one of the functions."""
        if isinstance(node, ast.Attribute):
            owner = self._value_or_namespace(node.value)
            if not isinstance(owner, NameSpace) and any(
                isinstance(owner, kind) and node.attr in names for kind, names in _METHODS.items()
            ):
                method: Callable[..., Any] = getattr(owner, node.attr)
                return method
            found = self._usable(_item(owner, node), node)
        else:
            found = self.value(node)
        if not callable(found):
            raise TypeError(f"'{_shortened(ast.unparse(node))}' is no function")
        function: Callable[..., Any] = found
        return function

    def _items(self, nodes: list[ast.expr]) -> list[Any]:
        found: list[Any] = []
        for node in nodes:
            found.extend(self.value(node.value) if isinstance(node, ast.Starred) else [self.value(node)])
        return found

    def _List(self, node: ast.List) -> list[Any]:
        return self._items(node.elts)

    def _Tuple(self, node: ast.Tuple) -> tuple[Any, ...]:
        return tuple(self._items(node.elts))

    def _UnaryOp(self, node: ast.UnaryOp) -> Any:
        return _OPERATORS[type(node.op)](self.value(node.operand))

    def _BinOp(self, node: ast.BinOp) -> Any:
        left, right = self.value(node.left), self.value(node.right)
        _check_size(node.op, left, right)
        return _OPERATORS[type(node.op)](left, right)

    def _BoolOp(self, node: ast.BoolOp) -> Any:
        result: Any = None
        for each in node.values:
            result = self.value(each)
            if bool(result) is isinstance(node.op, ast.Or):
                break
        return result

    def _Compare(self, node: ast.Compare) -> Any:
        left, result = self.value(node.left), True
        for op, each in zip(node.ops, node.comparators, strict=True):
            right = self.value(each)
            result = _OPERATORS[type(op)](left, right)
            if not result:
                break
            left = right
        return result

    def _IfExp(self, node: ast.IfExp) -> Any:
        return self.value(node.body if self.value(node.test) else node.orelse)

    def _ListComp(self, node: ast.ListComp | ast.GeneratorExp) -> list[Any]:
        outer = self._variables
        self._variables = dict(outer)
        try:
            return [self.value(node.elt) for _ in self._rounds(node.generators)]
        finally:
            self._variables = outer

    _GeneratorExp = _ListComp

    def _rounds(self, generators: list[ast.comprehension]) -> Iterator[None]:
        """Set the variables of a comprehension to each of their values in turn."""
        if not generators:
            yield
            return
        first, *rest = generators
        for item in self.value(first.iter):
            self._assign(first.target, item)
            if all(self.value(condition) for condition in first.ifs):
                yield from self._rounds(rest)

    def _assign(self, target: ast.expr, item: Any) -> None:
        if isinstance(target, ast.Name):
            self._variables[target.id] = item
        elif isinstance(target, ast.Tuple | ast.List):
            for part, each in zip(target.elts, item, strict=True):
                self._assign(part, each)
        else:
            raise RefusedError(f"an expression may not assign to {_kind(target)}")


def bounded_range(*limits: int) -> range:
    """``range``, of at most `MAX_ITEMS` items.

    Raises:
        RefusedError: it has more.
    """
    made = range(*limits)
    if made[MAX_ITEMS : MAX_ITEMS + 1]:
        raise RefusedError(f"found a range of more than {MAX_ITEMS} items")
    return made


def bounded_round(number: float, digits: int | None = None) -> float:
    """``round``, to at most `MAX_BITS` digits.

    Raises:
        RefusedError: they are more.
    """
    if digits is not None and abs(digits) > MAX_BITS:
        raise RefusedError(f"found {digits} digits to round to, expected {MAX_BITS} at most")
    return round(number, digits)


def _item(owner: Any, node: ast.Attribute) -> Any:
    """Return an item that is written as an attribute: no attribute of an object can be had."""
    if node.attr.startswith("_") or not isinstance(owner, NameSpace | YamlDictWrapper):
        raise RefusedError(f"an expression may not contain the attribute '{node.attr}' of a {type(owner).__name__}")
    try:
        return owner[node.attr]
    except (KeyError, AttributeError):
        raise NameError(f"'{node.attr}' is not defined in '{_shortened(ast.unparse(node.value))}'") from None


def _check_size(operation: ast.operator, left: Any, right: Any) -> None:
    """Refuse what would take long or much memory to compute; any result is bounded afterwards."""
    size = 0
    if isinstance(left, int) and isinstance(right, int):
        if isinstance(operation, ast.Pow):
            size = left.bit_length() * right
        elif isinstance(operation, ast.LShift):
            size = right
    elif isinstance(operation, ast.Mult):
        count, items = (left, right) if isinstance(left, int) else (right, left)
        if isinstance(count, int) and isinstance(items, str | list | tuple) and count * len(items) > MAX_ITEMS:
            raise RefusedError(f"found a repetition of {count * len(items)} items, expected {MAX_ITEMS} at most")
    elif isinstance(operation, ast.Mod) and isinstance(left, str):
        widths = [width for match in _SPECIFIERS.findall(left) for width in match]
        if any(width == "*" or len(width) > _MAX_WIDTH for width in widths):
            raise RefusedError(f"found a width of more than {_MAX_WIDTH} digits in the format '{_shortened(left)}'")
    if size > MAX_BITS:
        raise RefusedError(f"found an integer of {size} bits, expected {MAX_BITS} at most")


def _bounded(value: Any) -> Any:
    if isinstance(value, str | list | tuple | dict | set | frozenset) and len(value) > MAX_ITEMS:
        raise RefusedError(f"found {len(value)} items, expected {MAX_ITEMS} at most")
    if isinstance(value, int) and value.bit_length() > MAX_BITS:
        raise RefusedError(f"found an integer of {value.bit_length()} bits, expected {MAX_BITS} at most")
    return value


def _kind(node: ast.AST) -> str:
    names = {ast.Lambda: "a lambda", ast.JoinedStr: "an f-string", ast.NamedExpr: "an assignment"}
    return names.get(type(node), type(node).__name__)


def _shortened(text: str) -> str:
    return text if len(text) <= _MAX_SHOWN else f"{text[:_MAX_SHOWN]}..."
