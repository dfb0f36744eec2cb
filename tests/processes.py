"""Processes of others: whether they run. What has ended may wait for its parent for long: in a container, for ever."""

import os
from pathlib import Path


def runs(pid: int) -> bool:
    """Whether a process is there, and no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def group_runs(leader: int) -> bool:
    """Whether a process of a group is there, and no zombie."""
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if os.getpgid(int(folder.name)) == leader and runs(int(folder.name)):
                return True
        except ProcessLookupError:
            continue
    return False


def in_folder(folder: Path) -> list[int]:
    """The processes that work in a folder, or below it, whatever group they are of."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            works_there = (process / "cwd").readlink().is_relative_to(folder)
        except OSError:  # it has ended, or is of another user
            continue
        if works_there and runs(int(process.name)):
            found.append(int(process.name))
    return found
