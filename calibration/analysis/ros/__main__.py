"""Process of the checks: reads a task (root, present files, links), prints the findings as JSON."""

import dataclasses
import json
import sys
from pathlib import Path

from calibration.analysis.ros.check import check
from calibration.analysis.ros.tree import Tree


def main(task: Path) -> None:
    """Check the files that a task names."""
    root, present, opaque = json.loads(task.read_text(encoding="ascii"))
    json.dump([dataclasses.asdict(each) for each in check(Tree(Path(root), present, opaque))], sys.stdout)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
