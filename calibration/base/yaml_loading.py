"""Parsing of untrusted YAML. `base.documents` imports this at its first use, as PyYAML is slow to import."""

from collections.abc import Hashable, Iterator, Sequence
from pathlib import Path
from typing import Any

import yaml

from calibration.base.errors import InputError
from calibration.base.text import shorten

MAX_ALIASED = 100_000
"""Limit of values that aliases add, because a few nested aliases can expand to billions."""


MAX_DEPTH = 100
"""Limit of lists and mappings inside of each other, judged while reading."""
_TAG_PREFIX = "tag:yaml.org,2002:"


class _Loader(yaml.SafeLoader):
    """Safe loader that refuses repeated keys in a mapping, and scalars that do not fit their tag.

    It reads ``!!python/tuple`` as a list, and ``!!opencv-matrix`` as a mapping.
    """

    def __init__(self, stream: bytes) -> None:
        super().__init__(stream)
        self._depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        self._depth += 1
        if self._depth > MAX_DEPTH:
            problem = f"it is nested too deeply: more than {MAX_DEPTH} levels"
            raise yaml.composer.ComposerError(None, None, problem, self.get_mark())
        node: yaml.Node | None = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        try:
            return super().construct_object(node, deep)
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError):
            # What Python says of an explicit tag (!!bool x is a KeyError), or of a date or number that is none.
            found = shorten(repr(node.value)) if isinstance(node, yaml.ScalarNode) else "a list or mapping"
            problem = f"found {found}, expected a value of the type {node.tag.removeprefix(_TAG_PREFIX)}"
            raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark) from None

    def construct_document(self, node: yaml.Node) -> Any:
        sizes: dict[int, int] = {}
        if _count_unfolded(node, sizes) > len(sizes) + MAX_ALIASED:
            raise yaml.constructor.ConstructorError(
                None, None, f"its aliases expand to more than {MAX_ALIASED} values", node.start_mark
            )
        return super().construct_document(node)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if key.value in seen:
                    problem = f"the key {shorten(repr(key.value))} occurs twice"
                    raise yaml.constructor.ConstructorError(None, None, problem, key.start_mark)
                seen.add(key.value)
        return super().construct_mapping(node, deep)

    def construct_tuple(self, node: yaml.SequenceNode) -> list[Any]:
        return self.construct_sequence(node, deep=True)

    def construct_matrix(self, node: yaml.MappingNode) -> dict[Hashable, Any]:
        return self.construct_mapping(node, deep=True)


_Loader.add_constructor(f"{_TAG_PREFIX}python/tuple", _Loader.construct_tuple)
_Loader.add_constructor(f"{_TAG_PREFIX}opencv-matrix", _Loader.construct_matrix)


def _count_unfolded(node: yaml.Node, sizes: dict[int, int]) -> int:
    """Count the values of a node with all aliases expanded."""
    if (known := sizes.get(id(node))) is not None:
        return known
    sizes[id(node)] = 2 * MAX_ALIASED  # during the count, so that a node that contains itself exceeds the limit
    sizes[id(node)] = 1 + sum(_count_unfolded(child, sizes) for child in _children_of(node))
    return sizes[id(node)]


def _children_of(node: yaml.Node) -> Sequence[yaml.Node]:
    if isinstance(node, yaml.MappingNode):
        return [part for pair in node.value for part in pair]
    return node.value if isinstance(node, yaml.SequenceNode) else ()


def parse_yaml(data: bytes, path: Path) -> object:
    """Parse YAML; nothing in it is executed.

    Raises:
        InputError: it is not YAML; the message names the file and the line.
    """
    try:
        return yaml.load(data, _Loader)  # noqa: S506 (a safe loader)
    except yaml.MarkedYAMLError as error:
        line = f":{error.problem_mark.line + 1}" if error.problem_mark else ""
        raise InputError(f"{path}{line}: this is not valid YAML: {error.problem or error.context}") from None
    except (yaml.YAMLError, ValueError) as error:
        raise InputError(f"{path}: this is not valid YAML: {error}") from None


def line_in(data: bytes, keys: Sequence[str], value: str | None) -> int | None:
    """Return the line number of a key, see `calibration.base.documents.line_of`."""
    try:
        node = yaml.compose(data, yaml.SafeLoader)
    except (yaml.YAMLError, RecursionError):
        return None
    line = None
    for key in keys:
        pairs = node.value if isinstance(node, yaml.MappingNode) else ()
        found = next(((name, below) for name, below in pairs if name.value == key), None)
        if found is None:
            return line
        line, node = found[0].start_mark.line + 1, found[1]
    texts = (each for each in _nodes_below(node, set()) if isinstance(each, yaml.ScalarNode) and each.value == value)
    text = next(texts, None)
    return line if text is None else text.start_mark.line + 1


def _nodes_below(node: yaml.Node | None, seen: set[int]) -> Iterator[yaml.Node]:
    """Yield a node and all nodes below it, each once."""
    if node is None or id(node) in seen:
        return
    seen.add(id(node))
    yield node
    for child in _children_of(node):
        yield from _nodes_below(child, seen)
