"""The process that expands a xacro: it gets a request, confines itself, and writes the URDF to its standard output.

The confinement is for good: what the process may read, compute and start. It has two layers. A hook of Python's audit
events refuses files outside of the folders, programs and sockets, on every system. Landlock, where Linux has it (since
5.13), is the kernel's: no file outside of the folders, no program, no TCP, no memory of another process. In newer
kernels root can read its environment where /proc is in one of the folders.
"""

import ctypes
import json
import os
import re
import resource
import struct
import sys
import sysconfig
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import xacro
from xacro import substitution_args

from calibration.robot.expansion.expressions import (
    CALLABLE,
    NOT_OF_MATH,
    RefusedError,
    bounded_range,
    bounded_round,
    evaluate,
)

_PYTHON = tuple(
    {Path(sysconfig.get_paths()[name]).resolve() for name in ("stdlib", "platstdlib", "purelib", "platlib")}
)  # it may import at any time
_READING = ("open", "os.listdir", "os.scandir")
_REFUSED = ("ctypes.", "os.", "pty.", "shutil.", "socket.", "subprocess.")

# Landlock (linux/landlock.h): system calls, whose numbers are the same on all architectures, and flags
_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446
_VERSION, _PATH_BENEATH, _NO_NEW_PRIVILEGES = 1, 1, 38
_READ_FILE, _READ_FOLDER = 1 << 2, 1 << 3
_FILE_RIGHTS = {1: 13, 2: 14, 3: 15, 4: 15}
"""Number of the rights about files by version; 16 in later ones."""


def confine(folders: Sequence[Path], seconds: int, memory: int, output: int) -> None:
    """Confine this process to reading a few folders, and to limits.

    Args:
        folders: what it may read, but for hidden files and folders in them.
        seconds: limit of processor time.
        memory: limit of memory, bytes (Linux).
        output: limit of the size of a file that it writes, bytes.
    """
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    resource.setrlimit(resource.RLIMIT_FSIZE, (output, output))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_NPROC, (0, 0))  # no program, except for root's; no audit event sees fork_exec
    if sys.platform == "linux":
        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
        restrict_by_kernel([*folders, *filter(Path.is_dir, _PYTHON)])
    restrict_by_audit(folders)


def restrict_by_audit(folders: Sequence[Path]) -> None:
    """Refuse what Python would read outside of the folders, write or start; such a hook cannot be removed."""
    roots = [folder.resolve() for folder in folders]

    def check(event: str, arguments: tuple[object, ...]) -> None:
        if event in _READING:
            path = arguments[0]
            if isinstance(path, bytes | str | os.PathLike):
                writes = event == "open" and isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR)
                if writes or not _is_inside(Path(os.path.realpath(os.fsdecode(path))), roots):
                    places = ", ".join(map(str, roots))
                    raise RefusedError(
                        f"{os.fsdecode(path)} is outside of the folders that may be read ({places}) or hidden"
                    )
        elif event.startswith(_REFUSED) and event != "os.walk":
            raise RefusedError(f"{event} is not allowed here")

    sys.addaudithook(check)


def restrict_by_kernel(folders: Sequence[Path]) -> bool:
    """Restrict this process by Landlock to reading folders; return whether the kernel has it.

    Raises:
        OSError: the kernel has it and refuses.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    version = libc.syscall(_CREATE_RULESET, None, ctypes.c_size_t(0), ctypes.c_uint(_VERSION))
    if version < 1:
        return False
    network, scopes = (3 if version >= 4 else 0), (3 if version >= 6 else 0)  # TCP; signals and abstract sockets
    rules = struct.pack("QQQ", (1 << _FILE_RIGHTS.get(version, 16)) - 1, network, scopes)
    size = 8 * (1 + (version >= 4) + (version >= 6))
    ruleset = _checked(libc.syscall(_CREATE_RULESET, rules, ctypes.c_size_t(size), ctypes.c_uint(0)))
    for folder in folders:
        descriptor = os.open(folder, os.O_PATH)
        rule = struct.pack("=Qi", _READ_FILE | _READ_FOLDER, descriptor)
        _checked(libc.syscall(_ADD_RULE, ruleset, _PATH_BENEATH, rule, ctypes.c_uint(0)))
        os.close(descriptor)
    _checked(libc.prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0))
    _checked(libc.syscall(_RESTRICT_SELF, ruleset, ctypes.c_uint(0)))
    os.close(ruleset)
    return True


def _is_inside(path: Path, roots: Sequence[Path]) -> bool:
    """Return whether a path without links is in Python's folders, or in one of the roots and not hidden there."""
    parts = [path.relative_to(root).parts for root in roots if path.is_relative_to(root)]
    visible = any(not any(part.startswith(".") for part in each) for each in parts)
    return visible or any(path.is_relative_to(folder) for folder in _PYTHON)


def _checked(result: int) -> int:
    if result < 0:
        raise OSError(ctypes.get_errno(), f"Landlock: {os.strerror(ctypes.get_errno())}")
    return result


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
