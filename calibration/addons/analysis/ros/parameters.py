"""Files of parameters that launch files load."""

from collections.abc import Iterator
from typing import Any

import yaml

from calibration.addons.analysis.ros.launch import Parameter

_MAX_PARAMETERS = 5_000
_MAX_DEPTH = 20


def parameters_of(path: str, text: str, node: str) -> list[Parameter]:
    """Return the parameters that a file of ROS 2 sets for a node of this full name."""
    found: list[Parameter] = []
    short = node.rpartition("/")[2]
    for key, value in _entries_of_mapping(_parse_root(text)):
        if str(key.value) in ("/**", short, node, node.lstrip("/"), f"/**/{short}"):
            for inner, values in _entries_of_mapping(value):
                if inner.value == "ros__parameters":
                    found += _names_of_values(values, "", path, ".")
    return found[:_MAX_PARAMETERS]


def private_parameters_of(path: str, text: str) -> list[Parameter]:
    """Return the names that a file of ROS 1 sets below where it is loaded."""
    return list(_names_of_values(_parse_root(text), "", path, "/"))[:_MAX_PARAMETERS]


def _parse_root(text: str) -> Any:
    try:
        return yaml.compose(text, Loader=yaml.SafeLoader)
    except (yaml.YAMLError, ValueError, RecursionError):
        return None


def _entries_of_mapping(node: Any) -> list[tuple[Any, Any]]:
    return node.value if isinstance(node, yaml.MappingNode) else []


def _names_of_values(node: Any, prefix: str, path: str, separator: str, depth: int = 0) -> Iterator[Parameter]:
    """Yield the names of all values, nested ones joined by the separator."""
    for key, value in _entries_of_mapping(node) if depth < _MAX_DEPTH else ():
        name = f"{prefix}{key.value}"
        if isinstance(value, yaml.MappingNode):
            yield from _names_of_values(value, f"{name}{separator}", path, separator, depth + 1)
        else:
            yield Parameter(name, path, key.start_mark.line + 1)
