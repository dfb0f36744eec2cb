"""Predicates of HPL over the fields of messages, from the tree that the library hpl-specs parses to functions."""

import json
import math
import operator
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeAlias

import numpy as np

from calibration.addons.requirements.message_fields import FieldTree

MAX_STEPS = 1_000_000
"""Limit of the values that the quantifiers of a predicate go through for one message."""
THIS = ""
"""Name of the message itself among the messages by alias; a quantifier's variable is there too."""
Known: TypeAlias = Mapping[str, Any]
"""Fields of messages by alias, and values of variables."""
Evaluate: TypeAlias = Callable[[Known], Any]


class NoValueError(Exception):
    """An expression has no value: an index past the end, a division by zero, an alias of a message that is none."""


class MismatchError(Exception):
    """Values of different kinds are compared, or a number was expected: the requirement does not fit the messages."""


def evaluated(expression: Any) -> Evaluate:
    """Return the function that evaluates an expression of HPL.

    Raises:
        MismatchError: there is no such operator or function here.
    """
    made: Evaluate = _COMPILERS[type(expression).__name__](expression)
    return made


def paths(expression: Any) -> Iterator[tuple[str, FieldTree]]:
    """Yield the alias of each message that an expression reads, `THIS` for its own, with the tree of the field."""
    kind = type(expression).__name__
    if kind in ("HplFieldAccess", "HplArrayAccess"):
        names: list[str] = []
        while type(expression).__name__ in ("HplFieldAccess", "HplArrayAccess"):
            if type(expression).__name__ == "HplArrayAccess":
                yield from paths(expression.index)
                expression = expression.array
            else:
                names.insert(0, str(expression.field))
                expression = expression.message
        tree: FieldTree = {}
        for name in reversed(names):
            tree = {name: tree}
        yield (THIS if expression.is_this_msg else str(expression.name)), tree
        return
    for child in expression.children():
        yield from paths(child)


def _literal(expression: Any) -> Evaluate:
    value = expression.value
    if isinstance(value, str):
        try:
            value = json.loads(value)
        except ValueError:  # an escape that JSON does not have
            value = str(value)[1:-1]
    return lambda _: value


def _reference(expression: Any) -> Evaluate:
    name = THIS if expression.is_this_msg else str(expression.name)

    def read(known: Known) -> Any:
        if name not in known:
            raise NoValueError(name)
        return known[name]

    return read


def _field(expression: Any) -> Evaluate:
    message, name = evaluated(expression.message), str(expression.field)

    def read(known: Known) -> Any:
        found = message(known)
        if not isinstance(found, Mapping) or name not in found:
            raise MismatchError(f"there is no field '{name}' in {_kind(found)}")
        return found[name]

    return read


def _item(expression: Any) -> Evaluate:
    array, index = evaluated(expression.array), evaluated(expression.index)

    def read(known: Known) -> Any:
        items, place = array(known), _number(index(known))
        if not isinstance(items, list | np.ndarray):
            raise MismatchError(f"found {_kind(items)} with an index, expected an array")
        if place != int(place) or not 0 <= place < len(items):
            raise NoValueError(f"[{place}]")
        found = items[int(place)]
        return found.item() if isinstance(found, np.generic) else found

    return read


def _set(expression: Any) -> Evaluate:
    values = [evaluated(value) for value in expression.values]
    return lambda known: [value(known) for value in values]


def _range(expression: Any) -> Evaluate:
    first, last = evaluated(expression.min_value), evaluated(expression.max_value)
    skip_first, skip_last = int(expression.exclude_min), int(expression.exclude_max)

    def whole(known: Known) -> range:
        low, high = _number(first(known)), _number(last(known))
        if not (math.isfinite(low) and math.isfinite(high)):
            raise NoValueError("range")
        return range(math.ceil(low) + skip_first, math.floor(high) + 1 - skip_last)

    return whole


def _quantifier(expression: Any) -> Evaluate:
    domain, condition = evaluated(expression.domain), evaluated(expression.condition)
    variable, every = str(expression.variable), expression.is_universal
    is_written_out = type(expression.domain).__name__ in ("HplSet", "HplRange")

    def holds(known: Known) -> bool:
        values = domain(known)
        if not is_written_out:  # of an array, HPL's variable is the index
            if not isinstance(values, list | np.ndarray):
                raise MismatchError(f"found {_kind(values)} after 'in', expected an array")
            values = range(len(values))
        steps = known.get(_STEPS, [0])
        steps[0] += len(values)
        if steps[0] > MAX_STEPS:
            raise MismatchError(f"its quantifiers go through more than {MAX_STEPS} values of a message")
        results = (_truth(condition({**known, _STEPS: steps, variable: value})) for value in values)
        return all(results) if every else any(results)

    return holds


_STEPS = "#steps"
"""Name under which nested quantifiers count; no alias has it."""


def _unary(expression: Any) -> Evaluate:
    operand = evaluated(expression.operand)
    if expression.operator.is_minus:
        return lambda known: -_number(operand(known))
    return lambda known: not _truth(operand(known))


def _binary(expression: Any) -> Evaluate:
    sign, left, right = str(expression.operator.token), evaluated(expression.operand1), evaluated(expression.operand2)
    if sign in _LOGIC:
        combine = _LOGIC[sign]
        return lambda known: combine(_truth(left(known)), lambda: _truth(right(known)))
    if sign == "in":
        return _membership(expression.operand2, left, right)
    if sign in ("=", "!="):
        return lambda known: _is_equal(left(known), right(known)) == (sign == "=")
    calculate = _ARITHMETIC[sign]

    def calculated(known: Known) -> Any:
        try:
            return calculate(_number(left(known)), _number(right(known)))
        except (ZeroDivisionError, OverflowError):
            raise NoValueError(sign) from None

    return calculated


def _membership(domain: Any, left: Evaluate, right: Evaluate) -> Evaluate:
    if type(domain).__name__ == "HplRange":
        first, last = evaluated(domain.min_value), evaluated(domain.max_value)
        above = operator.gt if domain.exclude_min else operator.ge
        below = operator.lt if domain.exclude_max else operator.le

        def is_between(known: Known) -> bool:
            value = _number(left(known))
            return bool(above(value, _number(first(known))) and below(value, _number(last(known))))

        return is_between

    def is_among(known: Known) -> bool:
        value, values = left(known), right(known)
        if not isinstance(values, list | np.ndarray):
            raise MismatchError(f"found {_kind(values)} after 'in', expected an array, a set or a range")
        return any(_is_equal(value, each) for each in (values.tolist() if isinstance(values, np.ndarray) else values))

    return is_among


def _call(expression: Any) -> Evaluate:
    name, arguments = str(expression.function.name), [evaluated(each) for each in expression.arguments]
    if name not in _FUNCTIONS or len(arguments) != 1:
        raise MismatchError(f"the function {name} is not known here (functions: {', '.join(_FUNCTIONS)})")
    function, argument = _FUNCTIONS[name], arguments[0]

    def called(known: Known) -> Any:
        value = argument(known)
        try:
            return function(value.tolist() if isinstance(value, np.ndarray) else value)
        except (ValueError, OverflowError, ArithmeticError):
            raise NoValueError(name) from None
        except (TypeError, KeyError):
            raise MismatchError(f"{name} of {_kind(value)} is not known") from None

    return called


def _angle(name: str) -> Callable[[Any], float]:
    """Return roll, pitch or yaw of an orientation, or of a pose that has one, in rad (ROS REP 103)."""

    def angle(value: Any) -> float:
        while isinstance(value, Mapping) and "w" not in value:
            value = next(
                value[key] for key in ("orientation", "rotation", "quaternion", "pose", "transform") if key in value
            )
        x, y, z, w = (_number(value[axis]) for axis in "xyzw")
        if name == "pitch":
            return math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
        if name == "roll":
            return math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
        return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))

    return angle


def _power(base: float, exponent: float) -> float:
    found: float | complex = float(base) ** float(exponent)
    if isinstance(found, complex):
        raise NoValueError("**")
    return found


def _number(value: Any) -> Any:
    if isinstance(value, np.generic):
        value = value.item()
    if not isinstance(value, int | float):
        raise MismatchError(f"found {_kind(value)}, expected a number")
    return value


def _truth(value: Any) -> bool:
    if not isinstance(value, bool | int):  # a bool of ROS 1 may be a uint8
        raise MismatchError(f"found {_kind(value)}, expected True or False")
    return bool(value)


def _is_equal(left: Any, right: Any) -> bool:
    if isinstance(left, str) != isinstance(right, str):
        raise MismatchError(f"found {_kind(left)} compared with {_kind(right)}")
    if isinstance(left, str):
        return bool(left == right)
    return bool(_number(left) == _number(right))


def _kind(value: Any) -> str:
    names: dict[Any, str] = {bool: "True or False", int: "a number", float: "a number", str: "a text", list: "an array"}
    return "an array" if isinstance(value, np.ndarray) else names.get(type(value), "a message")


_ARITHMETIC: Mapping[str, Callable[[Any, Any], Any]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "**": _power,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
_LOGIC: Mapping[str, Callable[[bool, Callable[[], bool]], bool]] = {
    "and": lambda left, right: left and right(),
    "or": lambda left, right: left or right(),
    "implies": lambda left, right: not left or right(),
    "iff": lambda left, right: left == right(),
}
_FUNCTIONS: Mapping[str, Callable[[Any], Any]] = {
    "abs": abs,
    "bool": bool,
    "int": int,
    "float": float,
    "str": str,
    "len": len,
    "sum": sum,
    "prod": math.prod,
    "max": max,
    "min": min,
    "sqrt": math.sqrt,
    "ceil": math.ceil,
    "floor": math.floor,
    "sin": math.sin,
    "cos": math.cos,
    "tan": math.tan,
    "asin": math.asin,
    "acos": math.acos,
    "atan": math.atan,
    "deg": math.degrees,
    "rad": math.radians,
    **{name: _angle(name) for name in ("roll", "pitch", "yaw")},
}
_COMPILERS: Mapping[str, Callable[[Any], Evaluate]] = {
    "HplLiteral": _literal,
    "HplThisMessage": _reference,
    "HplVarReference": _reference,
    "HplSet": _set,
    "HplRange": _range,
    "HplQuantifier": _quantifier,
    "HplUnaryOperator": _unary,
    "HplBinaryOperator": _binary,
    "HplFunctionCall": _call,
    "HplFieldAccess": _field,
    "HplArrayAccess": _item,
}
