"""Reading of robot descriptions: URDF, and xacro, which the library xacrodoc expands to URDF without ROS.

A xacro has expressions of Python: a part of them is evaluated by `xacro_expressions`, never by Python itself, in a
separate process with an empty environment, which reads a few folders only, and with limits of its time, its memory and
its output.
"""

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

from calibration.base import InfrastructureError, InputError, one_line, read_bytes, shorten, temporary_folder
from calibration.base.records import Converted, Place, field, length, record

ENDING = ".xacro"
XACRO_ELEMENT = b"<xacro:"
MAX_BYTES = 10_000_000
"""Limit of a description's size, expanded or not: far above that of any robot."""
PLACES = "packages are looked for beside the file's own one and in its repository; the key packages names one more"
SECONDS, MEMORY = 30, 1024**3
"""Limits of the expansion: seconds of processor time, and bytes."""
_SYSTEM = ("/proc", "/sys", "/run")
_CHILD = "import sys; sys.path.insert(0, sys.argv.pop(1)); from calibration.robot.xacro_expansion import main; main()"
_SOURCES = str(Path(__file__).resolve().parents[2])
_REFUSED, _WITHOUT_ARGUMENT = 3, 4  # exit codes of the child: it needs more than is expanded; an argument has no value


def _argument(value: object, _: Place) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


XacroArgument = Annotated[str, Converted(Annotated[str, length(0, 1000)] | bool | int | float, _argument)]


@record(case="snake", nulls=True)
class XacroInputs:
    """What the expansion of a xacro needs beside its file; a URDF needs nothing."""

    xacro: Mapping[Annotated[str, length(1, 200)], XacroArgument] = field(
        "Arguments of the robot's xacro, by name: {ur_type: ur5e}.", default_factory=dict
    )
    packages: Path | None = field(
        "Folder in which the packages are looked for that the xacro includes; those above its file are found.",
        default=None,
    )


NO_INPUTS = XacroInputs()


def read_robot_description(path: Path, inputs: XacroInputs = NO_INPUTS) -> bytes:
    """Read a URDF, or expand a xacro to one.

    Args:
        path: path of the file; a xacro's name ends with ``.xacro``, or it has elements of xacro, as TurtleBot3's .urdf.
        inputs: of a xacro, its arguments, and the folder in which ``$(find PACKAGE)`` is searched after the file's own
            package; then it is in the one that holds that package, as a workspace does, and in the file's repository.

    Raises:
        InputError: the file cannot be read or expanded, the folder does not exist, an argument has no value, or a URDF
            has arguments.
        InfrastructureError: xacrodoc is not installed.
    """
    content, packages = read_bytes(path, MAX_BYTES, "a robot description"), inputs.packages
    if packages is not None and not packages.is_dir():
        raise InputError(f"{packages}: there is no such folder, expected one with the packages of {path.name}")
    if packages is not None and _holds_private_files(packages.resolve()):
        raise InputError(
            f"{packages}: packages: a xacro may read this whole folder, which holds your home, the system's or the "
            f"runner's files: name a smaller one, with the packages of {path.name} alone"
        )
    if path.name.endswith(ENDING) or XACRO_ELEMENT in content:
        return _expanded(path, inputs)
    if inputs.xacro:
        raise InputError(f"{path}: found the xacro argument '{next(iter(inputs.xacro))}', but this is no xacro")
    return content


def _readable(path: Path, packages: Path | None) -> list[Path]:
    """Return the folders that the expansion may read, in the order in which packages are looked for.

    They are the file's own package, the packages' folder, the one that holds the file's own package, or else the file's
    own folder, and the repository that the file is in.
    """
    above = path.resolve().parents
    package = next((each for each in above if (each / "package.xml").is_file()), None)
    workspace = above[0] if package is None else package if _holds_private_files(package.parent) else package.parent
    repository = next((each for each in above if (each / ".git").exists()), workspace)
    own = [] if package is None else [package]
    folders = [*own, *([] if packages is None else [packages.resolve()]), workspace, repository]
    return list(dict.fromkeys(folders))


def _holds_private_files(folder: Path) -> bool:
    """Return whether the home folder is in a folder, or files of the system or of the runner (with its tokens)."""
    home, runner = os.environ.get("HOME"), os.environ.get("RUNNER_TEMP")
    closed = [Path(each).resolve() for each in (*_SYSTEM, *([runner] if runner else []))]
    return (home is not None and Path(home).resolve().is_relative_to(folder)) or any(
        each.is_relative_to(folder) or folder.is_relative_to(each) for each in closed
    )


def _expanded(path: Path, inputs: XacroInputs) -> bytes:
    if find_spec("xacrodoc") is None:
        raise InfrastructureError(f"{path}: a xacro needs the package xacrodoc: pip install 'calibration-ci[xacro]'")
    with temporary_folder() as folder:
        urdf, log = folder / "robot.urdf", folder / "log"
        request = {
            "file": str(path.resolve()),
            "folders": [str(each) for each in _readable(path, inputs.packages)],
            "arguments": dict(inputs.xacro),
            "seconds": SECONDS,
            "memory": MEMORY,
            "output": MAX_BYTES,
        }
        with urdf.open("wb") as output, log.open("wb") as errors:
            try:
                done = subprocess.run(
                    [sys.executable, "-I", "-c", _CHILD, _SOURCES, json.dumps(request)],
                    env={"HOME": str(folder), "ROS_HOME": str(folder)},
                    cwd=folder,
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=errors,
                    timeout=4 * SECONDS,
                    check=False,
                )
            except subprocess.TimeoutExpired:
                raise InputError(f"{path}: cannot be expanded in {4 * SECONDS} s") from None
        if done.returncode != 0:
            raise InputError(f"{path}: this xacro cannot be expanded: {_reason(done.returncode, log, path)}")
        return read_bytes(urdf, MAX_BYTES, "an expanded robot description")


def _reason(code: int, log: Path, path: Path) -> str:
    """Return why the expansion ended with a code, from the last line that it wrote, and what to do."""
    if code < 0:
        return f"it took more than {SECONDS} s, {MEMORY:g} bytes of memory or {MAX_BYTES:g} bytes of text"
    lines = read_bytes(log, MAX_BYTES, "a log").decode(errors="replace").strip().splitlines()
    why = shorten(one_line(lines[-1]), 300) if lines else "no reason given"
    if code == _WITHOUT_ARGUMENT:
        return f"its argument '{why}' has no value: give one, xacro: {{{why}: ...}} (--xacro {why}=... of export)"
    if code == _REFUSED:
        return f"{why}; give the URDF that xacro makes of it: xacro {path.name} > {path.name.removesuffix(ENDING)}"
    return f"{why}; {PLACES}" if "ackage" in why else why
