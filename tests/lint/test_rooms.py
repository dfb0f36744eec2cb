"""The rooms of `calibration/`: each imports only from rooms above it in the table of CONTRIBUTING.md."""

import ast
import re
from collections import defaultdict

from .yaml_lines import PROJECT


def imports() -> dict[str, set[str]]:
    """The rooms that each room imports, in functions too."""
    found: defaultdict[str, set[str]] = defaultdict(set)
    package = PROJECT / "calibration"
    for file in package.rglob("*.py"):
        room = file.relative_to(package).with_suffix("").parts[0]
        for node in ast.walk(ast.parse(file.read_bytes())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(f"{package.name}."):
                found[room].add((node.module or "").split(".")[1])
        found[room].discard(room)
    return found


def test_rooms_import_only_from_rooms_above_them_in_the_table() -> None:
    found = imports()
    rooms = [name for name in found if (PROJECT / "calibration" / name).is_dir()]
    table = re.findall(r"^\| `(\w+)` \|", (PROJECT / "CONTRIBUTING.md").read_text(), re.MULTILINE)
    order = [name for name in table if (PROJECT / "calibration" / name).is_dir()]
    assert len(order) == len(set(order)) > 20
    assert set(rooms) <= set(order)
    below = [(room, other) for room in rooms for other in found[room] if other in order[order.index(room) :]]
    assert below == []
