"""Confinement of a process, for good, before it reads an untrusted file: what it may read, compute and start.

It has two layers. A hook of Python's audit events refuses files outside of the folders, programs and sockets, on every
system. Landlock, where Linux has it (since 5.13), is the kernel's: no file outside of the folders, no program, no TCP,
no memory of another process. In newer kernels root can read its environment where /proc is in one of the folders.
"""

import ctypes
import os
import resource
import struct
import sys
import sysconfig
from collections.abc import Sequence
from pathlib import Path

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


class RefusedError(Exception):
    """An expression, or a file, that the expansion does not take."""


def confine(folders: Sequence[Path], seconds: int, memory: int, output: int) -> None:
    """Confine this process to reading a few folders, and to limits.

    Args:
        folders: what it may read, but for hidden files and folders in them.
        seconds: limit of processor time.
        memory: limit of memory, bytes (Linux).
        output: limit of the size of a file that it writes, bytes.
    """
    limit_resources(seconds, memory, output)
    resource.setrlimit(resource.RLIMIT_NPROC, (0, 0))  # no program, except for root's; no audit event sees fork_exec
    if sys.platform == "linux":
        restrict_by_kernel([*folders, *filter(Path.is_dir, _PYTHON)])
    restrict_by_audit(folders)


def limit_resources(seconds: int, memory: int, output: int) -> None:
    """Limit this process; see `confine`. It gets one more second after the signal that its time is over."""
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    resource.setrlimit(resource.RLIMIT_FSIZE, (output, output))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if sys.platform == "linux":
        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))


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
