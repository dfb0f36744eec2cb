"""The process that expands a xacro: it gets a request, confines itself, and writes the URDF to its standard output."""

import json
import os
import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import xacro
from xacro import substitution_args

from calibration.robot.confinement import RefusedError, confine
from calibration.robot.xacro_expressions import (
    CALLABLE,
    NOT_OF_MATH,
    bounded_range,
    bounded_round,
    evaluate,
)

REFUSED, WITHOUT_ARGUMENT = 3, 4
"""Exit codes if the xacro needs more than the expansion takes, and an argument that has no value: its name is the
reason."""
_ARGUMENT = re.compile(r"\$\(arg\s+(\S+)\s*\)")
_EXPRESSION = re.compile(r"when evaluating expression '(.*?)'\s*(?:when evaluating|$)", re.DOTALL)
_REASONS: dict[type[BaseException], str] = {
    MemoryError: "it needs too much memory",
    RecursionError: "its macros, properties or parentheses are nested too deeply",
}
_NAME = re.compile(r"<name>\s*([^<]*?)\s*</name>")
_WARM_UP = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:property name="x" value="${1}"/></robot>'


class MissingPackageError(Exception):
    """A package that is in none of the folders."""


def main() -> None:
    """Expand the xacro of the request, a JSON document in the arguments; the last line of stderr is the reason if not.

    Keys of the request: ``file``; its ``arguments``, by name; ``folders`` that may be read, in which packages are
    looked for in this order; the limits ``seconds``, ``memory`` and ``output``.
    """
    request = json.loads(sys.argv[1])
    target = os.dup(1)
    os.dup2(2, 1)  # what xacro prints is no URDF
    folders = [Path(folder) for folder in request["folders"]]
    _expanded(_WARM_UP, {})  # imports what is imported at the first use
    _allow_arguments_without_default()
    _limit_language()
    substitution_args._eval_find = lambda name: _package(name, folders)
    confine(folders, request["seconds"], request["memory"], request["output"])
    xacro.init_stacks(request["file"])  # relative paths in it begin at its folder
    try:
        urdf = _expanded(Path(request["file"]).read_text("utf-8"), request["arguments"])
        with os.fdopen(target, "wb") as stream:
            stream.write(urdf)
    except Exception as error:
        code, reason = _reason(error)
        os.write(2, f"\n{' '.join(reason.split())}\n".encode(errors="replace"))
        os._exit(code)


def _expanded(text: str, arguments: Mapping[str, str]) -> bytes:
    """Return the URDF that xacro makes of a text in one pass, as it does in ROS."""
    document = xacro.parse(text)
    given = {**_defaults_for_root(document.documentElement), **arguments}
    xacro.process_doc(document, mappings=given)
    urdf: bytes = document.toprettyxml(indent="  ", encoding="utf-8")
    return urdf


def _defaults_for_root(root: Any) -> dict[str, str]:
    """Return the defaults of the arguments in the attributes of ``<robot>``, which xacro evaluates before them."""
    needed = {name for value in root.attributes.values() for name in _ARGUMENT.findall(value.value)}
    declared = [node for node in root.childNodes if getattr(node, "tagName", "") == "xacro:arg"]
    return {
        name: node.getAttribute("default")
        for node in reversed(declared)
        if (name := node.getAttribute("name")) in needed and node.hasAttribute("default")
    }


def _allow_arguments_without_default() -> None:
    """Let ``<xacro:arg name="x"/>`` declare an argument without a default: it needs a value only where it is used."""
    parse = xacro.parse

    def parse_without_them(*arguments: Any) -> Any:
        document = parse(*arguments)
        for node in document.getElementsByTagName("xacro:arg"):
            if not node.hasAttribute("default"):
                node.parentNode.removeChild(node)
        return document

    xacro.parse = parse_without_them


def _limit_language() -> None:
    """Let xacro evaluate its expressions by `evaluate`, with the names that those may have."""
    symbols = xacro._global_symbols
    for table in (symbols, symbols["python"]):
        dict.update(table, range=bounded_range, round=bounded_round)
    of_math, of_xacro = set(symbols["math"]) - NOT_OF_MATH, set(symbols["xacro"])
    named = ((symbols, CALLABLE | of_math | of_xacro), (symbols["python"], CALLABLE), (symbols["math"], of_math))
    functions = frozenset(
        id(table[name]) for table, names in (*named, (symbols["xacro"], of_xacro)) for name in names if name in table
    )

    def evaluate_expression(expression: str, symbols: Mapping[str, Any], _locals: object = None) -> Any:
        return evaluate(expression, symbols, functions)

    def evaluate_substitution(expression: str, context: Mapping[str, Any]) -> str:
        """Evaluate ``$(eval ...)``, in which arguments are names."""
        given = {name: substitution_args.convert_value(text, "auto") for name, text in context["arg"].items()}
        return str(evaluate(expression, {**symbols, "true": True, "false": False, **given}, functions))

    xacro.safe_eval = evaluate_expression
    substitution_args._eval = evaluate_substitution


def _package(name: str, folders: list[Path]) -> str:
    """Return the folder of a package: the one whose package.xml has this name, else one that is called so.

    A description that was copied into a team's repository often has lost its package.xml.

    Raises:
        MissingPackageError: there is none.
    """
    called_so = ""
    for folder in folders:
        for place, below, files in os.walk(folder):
            below[:] = sorted(each for each in below if not each.startswith("."))
            if "package.xml" in files or "CATKIN_IGNORE" in files or "COLCON_IGNORE" in files:
                below.clear()
            if "package.xml" in files and name in _NAME.findall(Path(place, "package.xml").read_text("utf-8")):
                return place
            if not called_so and "package.xml" not in files and Path(place).name == name:
                called_so = place
    if called_so:
        return called_so
    raise MissingPackageError(f"there is no package '{name}'")


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    """Yield an error and those that it wraps, as xacro does it."""
    while error is not None:
        yield error
        error = getattr(error, "exc", None) or error.__context__


def _reason(error: Exception) -> tuple[int, str]:
    """Return the exit code for an error, and one line."""
    for cause in _causes(error):
        if isinstance(cause, substitution_args.ArgException):
            return WITHOUT_ARGUMENT, str(cause)
        if isinstance(cause, RefusedError | MemoryError | RecursionError):
            text = _REASONS.get(type(cause), str(cause))
            where = _EXPRESSION.search(str(error))
            return REFUSED, f"{text}{f' in the expression {where[1]}' if where else ''}"
        if isinstance(cause, MissingPackageError):
            return 1, str(cause)
        if isinstance(cause, FileNotFoundError):
            return 1, f"there is no file {cause.filename}{_given_arguments()}"
    return 1, f"{type(error).__name__}: {error}"


def _given_arguments() -> str:
    """Return the values of the arguments, from which names of files are often made."""
    given = xacro.substitution_args_context["arg"]
    values = ", ".join(f"{name}={value}" for name, value in given.items())
    return f"; the key xacro gives other arguments than {values}" if given else ""
