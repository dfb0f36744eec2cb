"""YAML files with the lines that their parts stand on."""

from collections.abc import Iterator
from pathlib import Path

import yaml

PROJECT = Path(__file__).resolve().parents[2]
WORKFLOWS = sorted(PROJECT.glob(".github/workflows/*.yml"))
ACTIONS = sorted([PROJECT / "action.yml", *PROJECT.glob("actions/*/action.yml")])


def entries(path: Path, key: str) -> Iterator[tuple[int, str]]:
    """The texts of a key wherever it stands in a file, each with the line (from 1) on which the text begins.

    What an alias repeats is found once.
    """
    document = yaml.compose(path.read_text(), Loader=yaml.SafeLoader)
    seen: set[int] = set()
    waiting = [document]
    while waiting:
        node = waiting.pop()
        if node is None or id(node) in seen:
            continue
        seen.add(id(node))
        if isinstance(node, yaml.SequenceNode):
            waiting += node.value
        if isinstance(node, yaml.MappingNode):
            for name, value in node.value:
                if name.value == key and isinstance(value, yaml.ScalarNode):
                    block = value.style in ("|", ">")
                    yield value.start_mark.line + 1 + block, value.value
                waiting.append(value)
