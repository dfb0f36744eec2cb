"""Process of the checks: reads a task (what, root, present files, links), prints the findings or the graph as JSON."""

import dataclasses
import json
import sys
from pathlib import Path

from calibration.addons.analysis.ros.check import check
from calibration.addons.analysis.ros.graph import build_graphs, summary_of
from calibration.addons.analysis.ros.graph_picture import picture
from calibration.addons.analysis.ros.repository import RosRepository
from calibration.addons.analysis.ros.tree import Tree


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
