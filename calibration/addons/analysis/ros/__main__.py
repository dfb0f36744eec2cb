"""Process of the checks: reads a task (what, root, present files, links), prints the findings or the graph as JSON."""

import dataclasses
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from calibration.addons.analysis.results import CodeFinding
from calibration.addons.analysis.ros.build_checks import check_builds
from calibration.addons.analysis.ros.description_checks import check_frames, check_meshes
from calibration.addons.analysis.ros.graph import build_graphs, picture, summary_of
from calibration.addons.analysis.ros.launch_checks import check_graph, check_launches
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


def main(task: Path) -> None:
    """Check the files that a task names."""
    what, root, present, opaque = json.loads(task.read_text(encoding="ascii"))
    tree = Tree(Path(root), present, opaque)
    found: object = [dataclasses.asdict(each) for each in check(tree)] if what == "findings" else _graph_document(tree)
    json.dump(found, sys.stdout)


def _graph_document(tree: Tree) -> object:
    graphs = build_graphs(RosRepository(tree))
    return {**summary_of(graphs), "picture": picture(graphs)}


if __name__ == "__main__":
    main(Path(sys.argv[1]))
