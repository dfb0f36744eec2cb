"""Analyser of ROS packages: our own checks, in a process of their own."""

import json
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import calibration
from calibration.addons.analysis.analysers.analyser import Analyser, run_program
from calibration.addons.analysis.copies import MAX_FILES, Copy
from calibration.addons.analysis.results import CodeFinding, GraphSummary
from calibration.base import temporary_folder

_CHECKED_FILES = re.compile(
    r"(.*/)?(package\.xml|CMakeLists\.txt|setup\.(py|cfg)|calibration\.yml|config\.yml|dataset\.json)"
    r"|.*\.(launch|launch\.xml|test|urdf|xacro|msg|srv|action|py|cpp|cc|cxx|c|h|hpp|hh|hxx|yaml|yml)"
)
_PROGRAM_OF_CHECKS = (
    "import runpy, sys; sys.path.insert(0, sys.argv.pop(1)); "
    "runpy.run_module('calibration.addons.analysis.ros', run_name='__main__', alter_sys=True)"
)
"""Runs the checks from where this package is, whether it is installed or not."""


class RosChecks(Analyser):
    """Packages, build files, interfaces, launch files and code of ROS, one against the other."""

    name = "ros"
    at_once = MAX_FILES
    whole: ClassVar[bool] = True

    def wants(self, path: str, copy: Copy) -> bool:
        """Select the files that checks report on, if there is a package."""
        return bool(_CHECKED_FILES.fullmatch(path)) and any(
            each.rpartition("/")[2] == "package.xml" for each in copy.present
        )

    def findings(self, copy: Copy, files: Sequence[str], seconds: float) -> list[CodeFinding]:
        """Check all files together, and keep what is found in ``files``."""
        asked = set(files)
        entries = run_in_process("findings", copy, seconds)
        return [finding for entry in entries if (finding := CodeFinding(**entry)).path in asked]


def run_in_process(what: str, copy: Copy, seconds: float) -> Any:
    """Run the checks of ROS packages in a process of their own, and return the document that it prints.

    Args:
        what: ``findings`` or ``graph``.
        copy: the files.
        seconds: time limit.

    Raises:
        InfrastructureError: it fails, or takes too long.
    """
    with temporary_folder(prefix="calibration-analysis-") as folder:
        task = folder / "task.json"
        task.write_text(json.dumps([what, str(copy.root), copy.present, copy.opaque]), encoding="ascii")
        home = str(Path(calibration.__file__).parents[1])
        result = run_program(
            RosChecks.name, [sys.executable, "-I", "-c", _PROGRAM_OF_CHECKS, home, str(task)], copy.root, seconds, (0,)
        )
    return json.loads(result.output)


JSON_FILE, PICTURE_FILE = "ros-graph.json", "ros-graph.svg"


@dataclass(frozen=True)
class RosGraph:
    """Graph of one state of a repository."""

    nodes: int
    connections: frozenset[str]
    """Connections of nodes, one line each: ``/scan: scanner -> follower``."""
    unresolved: tuple[str, ...]
    document: str
    """The whole graph as JSON."""
    picture: str
    """Picture of the graph as SVG."""

    def since(self, earlier: "RosGraph | None") -> GraphSummary:
        """Return what the graph has, and what has changed since an earlier state."""
        before = self.connections if earlier is None else earlier.connections
        return GraphSummary(
            nodes=self.nodes,
            connections=len(self.connections),
            connected=tuple(sorted(self.connections - before)),
            cut=tuple(sorted(before - self.connections)),
            unresolved=self.unresolved,
        )


def read_graph(copy: Copy, seconds: float) -> RosGraph:
    """Read the graph of a copy in a process of its own.

    Raises:
        InfrastructureError: it fails, or takes too long.
    """
    found = run_in_process("graph", copy, seconds)
    connections = frozenset(found["connections"])
    return RosGraph(found["nodes"], connections, tuple(found["unresolved"]), found["document"], found["picture"])
