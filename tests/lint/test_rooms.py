"""The rooms of `calibration/`: imports between them form no circle of two."""

import ast
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


def test_no_two_rooms_import_each_other() -> None:
    found = imports()
    assert {"geometry", "execution", "commands"} <= set(found)
    assert [(one, other) for one in found for other in found[one] if one in found.get(other, ())] == []
