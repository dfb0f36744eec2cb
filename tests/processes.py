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
