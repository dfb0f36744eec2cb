"""Planted defects in small ROS packages: how many the static analysis finds at their file and line.

``workspace`` writes packages without a defect, by a seed; ``kinds`` are the defects. What is found in real packages is
counted too, where ROS_PACKAGES names a folder of them: each folder in it is a repository.
"""

import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks.ros_defects.kinds import KINDS, planted
from benchmarks.ros_defects.workspace import Files, Workspace, write
from benchmarks.rows import Bar, Row
from calibration.addons.analysis.results import CodeFinding
from calibration.addons.analysis.ros.__main__ import check
from calibration.addons.analysis.ros.repository import RosRepository
from calibration.addons.analysis.ros.tree import Tree

SEEDS = 10


def found_in(files: Files) -> list[CodeFinding]:
    """Return the findings in files that are written to a folder."""
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder), files)
        return check(Tree(Path(folder), files))


def measure(quick: bool) -> Iterator[Row]:
    """Measure every kind of defect, workspaces without one, and real packages."""
    seeds = 2 if quick else SEEDS
    missed: list[str] = []
    others = 0
    for kind in KINDS:
        for seed in range(seeds):
            defect = planted(kind, seed)
            found = found_in(defect.files)
            hits = [each for each in found if (each.path, each.line, each.rule) == (*defect.place, f"ros/{kind.rule}")]
            others += len(found) - len(hits)
            if not hits:
                missed.append(f"{kind.name} ({seed})")
    count = len(KINDS) * seeds
    note = f"{len(KINDS)} kinds, {seeds} seeds each; {others} consequences found beside them"
    yield Row("ros_defects/found at their line", 100 * (1 - len(missed) / count), "%", Bar(low=95), note)
    false = sum(len(found_in(Workspace(version, seed).files)) for version in (1, 2) for seed in range(seeds))
    yield Row("ros_defects/in clean workspaces", false, "findings", Bar(high=0), f"of {2 * seeds}")
    yield from _real()


def _real() -> Iterator[Row]:
    name = "ros_defects/findings in real packages"
    given = os.environ.get("ROS_PACKAGES")
    if given is None:
        yield Row(
            name, skipped="set ROS_PACKAGES to a folder of unpacked sources, such as those of apt-get source ros-*"
        )
        return
    packages = findings = 0
    start = time.monotonic()
    for folder in sorted(Path(given).iterdir()):
        files = [path for path in folder.rglob("*") if ".git" not in path.parts]
        inside = [str(path.relative_to(folder)) for path in files if path.is_file() and not path.is_symlink()]
        links = [str(path.relative_to(folder)) for path in files if path.is_symlink()]
        tree = Tree(folder, inside, links)
        packages += len(RosRepository(tree).packages)
        for each in check(tree):
            findings += 1
            print(f"  {folder.name}/{each.place}: {each.rule}: {each.message}")
    note = f"{findings} in {packages} packages, true and false, in {time.monotonic() - start:.0f} s: to be read"
    yield Row(name, findings / max(packages, 1), "a package", note=note)
