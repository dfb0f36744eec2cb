"""Descriptions of printed patterns: from import.yml, Kalibr's target YAML and robot_cal_tools' target."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from calibration.base import read_yaml
from calibration.engine.dataset.configuration import (
    APRILGRID_TAGS,
    MAX_CORNERS,
    MAX_SPACING,
    MIN_SPACING,
    PatternConfiguration,
    check_tags,
)
from calibration.engine.dataset.document import Node
from calibration.engine.dataset.pattern import CIRCLE_KINDS, MAX_SIZE, MIN_SIZE
from calibration.robot.importing.description import PatternDescription

PLACEHOLDER_PATTERN = {"kind": "chessboard", "dimension": (2, 2), "size": 0.1}
"""Placeholder geometry of a pattern that is never detected in images: only its frame is used."""
MAX_SIDE_DIFFERENCE = 1e-6
"""Relative tolerance of the two sides of a square: only squares are supported."""


def pattern_configuration(described: PatternDescription, world: str, root: str | None = None) -> PatternConfiguration:
    """Return the pattern of an entry of import.yml, described there or in its ``target`` file.

    Args:
        described: the entry.
        world: the world frame by import.yml; a pattern with another parent is fixed there.
        root: the root of the recorded frames, on which a pattern without a parent moves; None for the world.

    Raises:
        InputError: the file cannot be read, or describes an unknown pattern.
    """
    parent = described.parent or root or world
    printed = _keys_of_target_file(described) if described.target else _keys_of_pattern(described)
    if not described.is_printed:
        printed = PLACEHOLDER_PATTERN
    return PatternConfiguration(
        name=described.name,
        link=described.frame or f"{described.name}_link",
        parent_link=parent,
        fixed=(described.parent or world) != world if described.fixed is None else described.fixed,
        border_size=(described.border, described.border),
        first_marker=described.first or 0,
        inverted=described.inverted,
        **printed,
    )


def _keys_of_pattern(pattern: PatternDescription) -> dict[str, Any]:
    if pattern.tags:
        keys = {
            "size": pattern.tags[0].size,
            "dictionary": pattern.dictionary,
            "tags": tuple(each.flat for each in pattern.tags),
        }
        return {"kind": "tags", "dimension": (len(pattern.tags), 1)} | keys
    if pattern.type in CIRCLE_KINDS:
        size, diameter = pattern.spacing, pattern.diameter
        return {
            "kind": pattern.type,
            "dimension": (pattern.columns, pattern.rows),
            "size": size,
            "inner_size": diameter,
        }
    return {
        "kind": pattern.type,
        "dimension": (pattern.columns, pattern.rows),
        "size": pattern.tag if pattern.type == "aprilgrid" else pattern.square,
        "inner_size": pattern.marker if pattern.type == "charuco" else None,
        "dictionary": APRILGRID_TAGS if pattern.type == "aprilgrid" else pattern.dictionary,
        "spacing": pattern.spacing or 0.0,
    }


def _keys_of_target_file(pattern: PatternDescription) -> dict[str, Any]:
    path = pattern.target or Path()
    root = Node(path, (), read_yaml(path, "the description of a pattern"))
    if finder := root.get("target_finder"):
        printed = _by_type(finder, "type", ROBOT_CAL_TOOLS)
    else:
        printed = _by_type(root, "target_type", KALIBR_TARGETS)
    if printed["kind"] not in CIRCLE_KINDS:
        return printed
    if pattern.diameter is None or pattern.diameter >= printed["size"]:
        found = "no diameter" if pattern.diameter is None else f"a diameter of {pattern.diameter:g}"
        raise root.fault(
            f"has the spacing of the circles, {printed['size']:g} m, not their diameter; found {found} for "
            f"'{pattern.name}' in import.yml, expected 'diameter' beside 'target': a circle's, m, less than the spacing"
        )
    return printed | {"inner_size": pattern.diameter}


def _by_type(node: Node, key: str, kinds: Mapping[str, Callable[[Node], dict[str, Any]]]) -> dict[str, Any]:
    kind = node[key]
    if kind.text() not in kinds:
        raise kind.unexpected(f"one of {', '.join(kinds)}")
    return kinds[kind.value](node)


def _corner_count(node: Node, key: str, less: int = 0) -> int:
    return node[key].whole(2 + less, MAX_CORNERS) - less


def _length_in_bounds(node: Node, key: str) -> float:
    return node[key].within(MIN_SIZE, MAX_SIZE)


def _kalibr_chessboard(node: Node) -> dict[str, Any]:
    width, height = _length_in_bounds(node, "colSpacingMeters"), _length_in_bounds(node, "rowSpacingMeters")
    if abs(width - height) > MAX_SIDE_DIFFERENCE * width:
        raise node["rowSpacingMeters"].unexpected(f"{width:g} as colSpacingMeters: squares")
    columns, rows = _corner_count(node, "targetCols"), _corner_count(node, "targetRows")
    return {"kind": "chessboard", "dimension": (columns, rows), "size": width}


def _kalibr_aprilgrid(node: Node) -> dict[str, Any]:
    columns, rows = _corner_count(node, "tagCols"), _corner_count(node, "tagRows")
    check_tags(columns, rows, node)
    return {
        "kind": "aprilgrid",
        "dimension": (columns, rows),
        "size": _length_in_bounds(node, "tagSize"),
        "dictionary": APRILGRID_TAGS,
        "spacing": node["tagSpacing"].within(MIN_SPACING, MAX_SPACING),
    }


def _kalibr_circles(node: Node) -> dict[str, Any]:
    is_asymmetric = asymmetric.flag() if (asymmetric := node.get("asymmetricGrid")) else False
    return {
        "kind": "asymmetric-circles" if is_asymmetric else "circles",
        "dimension": (_corner_count(node, "targetCols"), _corner_count(node, "targetRows")),
        "size": _length_in_bounds(node, "spacingMeters"),
    }


def _charuco_keys(node: Node) -> dict[str, Any]:
    number = node["dictionary"].whole(0, len(DICTIONARY_NAMES) - 1)
    size, marker = _length_in_bounds(node, "chessboard_dim"), node["aruco_marker_dim"]
    if marker.within(MIN_SIZE, MAX_SIZE) >= size:
        raise marker.unexpected(f"less than chessboard_dim, {size:g}")
    return {
        "kind": "charuco",
        "dimension": (_corner_count(node, "cols", 1), _corner_count(node, "rows", 1)),  # counts of squares
        "size": size,
        "inner_size": marker.number(),
        "dictionary": DICTIONARY_NAMES[number],
    }


DICTIONARY_NAMES = tuple(f"DICT_{bits}X{bits}_{count}" for bits in (4, 5, 6, 7) for count in (50, 100, 250, 1000))
"""Dictionaries by OpenCV's numbers."""
KALIBR_TARGETS = {"aprilgrid": _kalibr_aprilgrid, "checkerboard": _kalibr_chessboard, "circlegrid": _kalibr_circles}
"""Kalibr's types of targets; ``targetCols`` and ``targetRows`` are inner corners or circles, ``tagCols`` ... tags."""
ROBOT_CAL_TOOLS = dict.fromkeys(
    ("rct_ros_tools::CharucoGridTargetFinderPlugin", "CharucoGridTargetFinder"), _charuco_keys
)
"""Target finders of robot_cal_tools, and of industrial_calibration, which it has become."""
