"""Reading of robot descriptions: URDF, and xacro, which the library xacrodoc expands to URDF without ROS.

A xacro has expressions, which are program code: it is expanded in a separate process with an empty
environment, and with limits of its time, its memory and its output.
"""

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

from calibration.errors import InfrastructureError, InputError
from calibration.files import read_bytes
from calibration.temporary_folder import temporary_folder
from calibration.workflow.text import one_line, shorten

ENDING = ".xacro"
MAX_BYTES = 10_000_000
"""Limit of a description's size, expanded or not: far above that of any robot."""
PLACES = "packages are looked for above the file and beside its own package; an import names them by 'packages'"
SECONDS, MEMORY = 60, 2 * 1024**3
"""Limits of the expansion: seconds of processor time, and bytes."""
_CHILD = """
import resource, sys
from pathlib import Path
seconds, memory, most = map(int, sys.argv[4:7])
resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
if sys.platform == "linux":
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
from xacrodoc import XacroDoc, packages
if sys.argv[3]:
    packages.look_in([sys.argv[3]])
try:
    text = XacroDoc.from_file(sys.argv[1], resolve_packages=False).to_urdf_string()
except Exception as error:
    sys.exit(" ".join(f"{type(error).__name__}: {error}".split()))
Path(sys.argv[2]).write_text(text)
"""


def read_robot_description(path: Path, packages: Path | None = None) -> bytes:
    """Read a URDF, or expand a xacro to one.

    Args:
        path: path of the file; the name of a xacro ends with ``.xacro``.
        packages: the folder in which ``$(find PACKAGE)`` is searched, in addition to the file's parent folders; None
            for the one that holds the file's own package, as a workspace does.

    Raises:
        InputError: the file cannot be read or expanded, or the folder does not exist.
        InfrastructureError: xacrodoc is not installed.
    """
    content = read_bytes(path, MAX_BYTES, "a robot description")
    if packages is not None and not packages.is_dir():
        raise InputError(f"{packages}: there is no such folder, expected one with the packages of {path.name}")
    return _expanded(path, packages or _workspace_of(path)) if path.name.endswith(ENDING) else content


def _workspace_of(path: Path) -> Path | None:
    """Return the folder that holds the package of a file; None if it is in no package."""
    return next((each.parent for each in path.resolve().parents if (each / "package.xml").is_file()), None)


def _expanded(path: Path, packages: Path | None) -> bytes:
    if find_spec("xacrodoc") is None:
        raise InfrastructureError(f"{path}: a xacro needs the package xacrodoc: pip install 'calibration-ci[xacro]'")
    with temporary_folder() as folder:
        target = folder / "robot.urdf"
        words = [str(path.resolve()), str(target), str(packages.resolve()) if packages else ""]
        try:
            done = subprocess.run(
                [sys.executable, "-I", "-c", _CHILD, *words, str(SECONDS), str(MEMORY), str(MAX_BYTES)],
                env={"PATH": os.defpath, "HOME": str(folder), "ROS_HOME": str(folder)},
                cwd=folder,
                capture_output=True,
                timeout=2 * SECONDS,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise InputError(f"{path}: cannot be expanded in {2 * SECONDS} s") from None
        if done.returncode != 0:
            lines = done.stderr.decode(errors="replace").strip().splitlines()
            ended = (
                f"it took more than {SECONDS} s or {MAX_BYTES:g} bytes" if done.returncode < 0 else "no reason given"
            )
            why = shorten(one_line(lines[-1]), 300) if lines else ended
            hint = f"; {PLACES}" if "ackage" in why else ""
            raise InputError(f"{path}: this xacro cannot be expanded: {why}{hint}")
        return read_bytes(target, MAX_BYTES, "an expanded robot description")
