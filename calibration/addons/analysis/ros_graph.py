"""Graph of the ROS nodes of a repository, and what a change connects or cuts in it."""

from dataclasses import dataclass

from calibration.addons.analysis.analysers.ros import run_in_process
from calibration.addons.analysis.copies import Copy
from calibration.addons.analysis.results import Graph

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

    def since(self, earlier: "RosGraph | None") -> Graph:
        """Return what the graph has, and what has changed since an earlier state."""
        before = self.connections if earlier is None else earlier.connections
        return Graph(
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
