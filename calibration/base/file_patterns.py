"""Files by paths and patterns with wildcards."""

import os
from collections.abc import Iterable
from glob import glob, has_magic
from itertools import takewhile
from pathlib import Path

from calibration.base.errors import InputError


def matching(patterns: Iterable[str]) -> list[str]:
    """Return the files that match paths and patterns (``results/**/*.csv``), without duplicates, sorted by pattern.

    Raises:
        InputError: a pattern matches no file, or would search the whole machine.
    """
    files: dict[str, None] = {}
    for pattern in patterns:
        if os.path.exists(pattern) or not has_magic(pattern):  # noqa: PTH110 (Path.exists may raise)
            files[pattern] = None
            continue
        parts = Path(pattern).parts
        if Path(pattern).is_absolute() and "**" in parts[1:2]:
            raise InputError(f"{pattern}: this searches the whole machine: a folder was expected before the first **")
        found = sorted(file for file in glob(pattern, recursive=True) if os.path.isfile(file))  # noqa: PTH113, PTH207
        if not found:
            folder = Path(*takewhile(lambda part: not has_magic(part), parts))
            closed = os.path.isdir(folder) and not os.access(folder, os.R_OK | os.X_OK)  # noqa: PTH112
            problem = f"the folder {folder} cannot be read" if closed else "no file matches this pattern"
            raise InputError(f"{pattern}: {problem}")
        files.update(dict.fromkeys(found))
    return list(files)
