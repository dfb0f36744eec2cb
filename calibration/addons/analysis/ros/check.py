"""Run all checks of ROS packages."""

from collections.abc import Callable, Iterator

from calibration.addons.analysis.finding import CodeFinding
from calibration.addons.analysis.ros.build_checks import check_builds
from calibration.addons.analysis.ros.frame_checks import check_frames
from calibration.addons.analysis.ros.graph_checks import check_graph
from calibration.addons.analysis.ros.launch_checks import check_launches
from calibration.addons.analysis.ros.mesh_checks import check_meshes
from calibration.addons.analysis.ros.package_checks import check_packages
from calibration.addons.analysis.ros.repository import RosRepository
from calibration.addons.analysis.ros.tree import Tree

CHECKS: tuple[Callable[[RosRepository], Iterator[CodeFinding]], ...] = (
    check_packages,
    check_builds,
    check_launches,
    check_graph,
    check_frames,
    check_meshes,
)


def check(tree: Tree) -> list[CodeFinding]:
    """Return the findings of all checks, each once."""
    repository = RosRepository(tree)
    found = dict.fromkeys(finding for each in CHECKS for finding in each(repository))
    return sorted(found, key=lambda each: (each.path, each.line, each.rule))
