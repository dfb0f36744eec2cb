"""Calibration configuration: the sensors, patterns and transforms to calibrate.

ATOM's config.yml and a dataset's ``calibration_config`` have the same content.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args

import numpy as np

from calibration.base import InputError, read_yaml
from calibration.base.records import read
from calibration.engine.dataset.document import Node
from calibration.engine.dataset.modalities import MODALITIES
from calibration.engine.dataset.model import Edge
from calibration.engine.dataset.pattern import (
    CIRCLE_KINDS,
    MAX_MARKER,
    MAX_SIZE,
    MIN_SIZE,
    Pattern,
    PatternKind,
    PlacedTag,
    corner_origin,
    grid,
    outline,
    rectangle,
    staggered_grid,
    tag_grid,
    tag_outline,
)

MAX_CORNERS = 1000
"""Limit of the number of corners along one side of a pattern."""
APRILGRID_TAGS, TAG_COUNT = "DICT_APRILTAG_36h11", 587
"""ArUco dictionary of an aprilgrid's tags, and the number of tags in it."""
MIN_SPACING, MAX_SPACING = 0.01, 1.0
"""Limits of the gap between two tags, in sides of a tag."""
FIRST_PATTERN = "pattern_1"
IF_SET = ("first_marker", "inverted", "known_pose")
"""Keys of a pattern that are written only where they say something; ATOM does not know them."""
"""Name of the only pattern of a version 2 configuration."""


@dataclass(frozen=True)
class SensorConfiguration:
    """Configuration of a sensor: the frame of its data, and the transform parent_link -> child_link to calibrate."""

    name: str
    modality: str
    """Name of the modality, as in the document: "rgb", "lidar3d", "depth" ..."""
    link: str
    parent_link: str
    child_link: str
    topic_name: str = ""
    throttle: float | None = None

    @property
    def has_corners(self) -> bool:
        """Whether its labels are corners in images; False for an unknown modality."""
        return self.modality in MODALITIES and MODALITIES[self.modality].has_corners


@dataclass(frozen=True)
class PatternConfiguration:
    """Configuration of a pattern: its print and its mounting. Metres."""

    name: str
    kind: PatternKind
    link: str
    parent_link: str
    fixed: bool
    dimension: tuple[int, int]
    """Inner corners along x and y; of an aprilgrid, tags; circles of a row, and rows."""
    size: float
    """The side of a square, or of a tag; the spacing of circles."""
    inner_size: float | None = None
    """The side of a charuco board's markers; the diameter of circles."""
    border_size: tuple[float, float] = (0.0, 0.0)
    """Margin of the physical board around the print, along x and y."""
    dictionary: str | None = None
    """The ArUco dictionary of a charuco board; `APRILGRID_TAGS` for an aprilgrid."""
    mesh_file: str = ""
    spacing: float = 0.0
    """Aprilgrid only: the gap between two tags, in sides of a tag (Kalibr's ``tagSpacing``)."""
    first_marker: int = 0
    """The lowest id of the markers or tags; the others follow."""
    inverted: bool = False
    """Whether black and white are exchanged in the print."""

    tags: tuple[PlacedTag, ...] = ()
    """Of kind tags."""
    known_pose: bool = False
    """Whether its pose on its parent is as exact as its print, and so is not calibrated."""

    def pattern(self, version: str = "3.0") -> Pattern:
        """Return the geometry of the pattern in a dataset of this version."""
        columns, rows = self.dimension
        if self.kind == "tags":
            corners = np.concatenate([tag.corners for tag in self.tags])
            low, high = corners[:, :2].min(0) - self.border_size, corners[:, :2].max(0) + self.border_size
            border = rectangle(*low, *high)
        elif self.kind == "aprilgrid":
            corners = tag_grid(columns, rows, self.size, self.spacing)
            border = tag_outline(columns, rows, self.size, self.spacing, self.border_size)
        elif self.kind == "asymmetric-circles":
            corners = staggered_grid(columns, rows, self.size)
            border = outline(2 * columns, rows, self.size, self.border_size, (0.0, 0.0))
        else:
            origin = corner_origin(self.kind, version, self.size)
            corners = grid(columns, rows, self.size, origin)
            border = outline(columns, rows, self.size, self.border_size, origin)
        return Pattern(self.name, self.kind, self.link, self.parent_link, self.fixed, corners, border, self.known_pose)


@dataclass(frozen=True)
class Configuration:
    """Configuration of a calibration."""

    world_link: str
    sensors: Mapping[str, SensorConfiguration]
    patterns: Mapping[str, PatternConfiguration]
    anchored_sensor: str | None = None
    additional_tfs: Mapping[str, Edge] = field(default_factory=dict)
    moving_tfs: tuple[str, ...] = ()
    """Those of them that are known to differ between collections; not in the document."""
    joints: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """The parameters to calibrate of each joint, such as ("origin_yaw",)."""
    description_file: str = ""
    bag_file: str = ""
    package_name: str = ""
    max_duration_between_msgs: float = 1000.0

    def to_document(self) -> dict[str, Any]:
        """Return the ``calibration_config`` of a version 3 dataset."""
        return {
            "world_link": self.world_link,
            "anchored_sensor": self.anchored_sensor,
            "additional_tfs": {
                name: {"parent_link": parent, "child_link": child}
                for name, (parent, child) in self.additional_tfs.items()
            }
            or None,
            "joints": {name: {"params_to_calibrate": list(each)} for name, each in self.joints.items()} or None,
            "description_file": self.description_file,
            "bag_file": self.bag_file,
            "package_name": self.package_name,
            "max_duration_between_msgs": self.max_duration_between_msgs,
            "version": 3.0,
            "sensors": {
                name: {key: value for key, value in vars(sensor).items() if key != "name"}
                for name, sensor in self.sensors.items()
            },
            "calibration_patterns": {
                pattern.name: {
                    "link": pattern.link,
                    "parent_link": pattern.parent_link,
                    "fixed": pattern.fixed,
                    "pattern_type": pattern.kind,
                    "dictionary": pattern.dictionary,
                    "mesh_file": pattern.mesh_file,
                    "border_size": {"x": pattern.border_size[0], "y": pattern.border_size[1]},
                    "dimension": {"x": pattern.dimension[0], "y": pattern.dimension[1]},
                    "size": pattern.size,
                    "inner_size": pattern.inner_size,
                    **({"spacing": pattern.spacing} if pattern.kind == "aprilgrid" else {}),
                    **({"tags": [vars(tag) for tag in pattern.tags]} if pattern.tags else {}),
                    **{key: value for key in IF_SET if (value := getattr(pattern, key))},
                }
                for pattern in self.patterns.values()
            },
        }


def read_configuration(path: Path | str) -> Configuration:
    """Read a configuration in ATOM's YAML form; a single ``calibration_pattern`` (version 2) is accepted.

    Raises:
        InputError: the file cannot be read, or something in it is missing or wrong.
    """
    path = Path(path)
    return parse_configuration(Node(path, (), read_yaml(path, "a calibration configuration")))


def parse_configuration(node: Node) -> Configuration:
    """Parse a configuration and check that it is consistent in itself.

    Raises:
        InputError: something in it is missing or wrong.
    """
    sensors = {name: _sensor_configuration(name, entry) for name, entry in node["sensors"].items()}
    if not sensors:
        raise node["sensors"].unexpected("at least one sensor")
    if node.get("calibration_pattern") and not node.get("calibration_patterns"):
        patterns = {FIRST_PATTERN: _pattern_configuration(FIRST_PATTERN, node["calibration_pattern"])}
    else:
        patterns = {name: _pattern_configuration(name, entry) for name, entry in node["calibration_patterns"].items()}
        if not patterns:
            raise node["calibration_patterns"].unexpected("at least one pattern")
    anchored = node.get("anchored_sensor")
    if anchored and anchored.text() and anchored.value not in sensors:
        raise anchored.unexpected(f"a sensor ({', '.join(sensors)})")
    additional, joints = node.get("additional_tfs"), node.get("joints")
    return Configuration(
        world_link=node["world_link"].name(),
        sensors=sensors,
        patterns=patterns,
        anchored_sensor=(anchored and anchored.value) or None,
        additional_tfs={name: read_links(entry) for name, entry in additional.items()} if additional else {},
        joints={
            name: tuple(element.name() for element in entry["params_to_calibrate"].elements())
            for name, entry in (joints.items() if joints else ())
        },
        description_file=_text_or_empty(node, "description_file"),
        bag_file=_text_or_empty(node, "bag_file"),
        package_name=_text_or_empty(node, "package_name"),
        max_duration_between_msgs=limit.number() if (limit := node.get("max_duration_between_msgs")) else 1000.0,
    )


def _sensor_configuration(name: str, node: Node) -> SensorConfiguration:
    throttle = node.get("throttle")
    parent, child = read_links(node)
    return SensorConfiguration(
        name=name,
        modality=node["modality"].text(),
        link=node["link"].name(),
        parent_link=parent,
        child_link=child,
        topic_name=_text_or_empty(node, "topic_name"),
        throttle=throttle.number() if throttle else None,
    )


def _pattern_configuration(name: str, node: Node) -> PatternConfiguration:
    kind = node["pattern_type"]
    if kind.text() not in get_args(PatternKind):
        raise kind.unexpected(f"one of {', '.join(get_args(PatternKind))}")
    if kind.value == "tags":
        return _tag_list(name, node)
    dimension = node["dimension"]
    size = node["size"].within(MIN_SIZE, MAX_SIZE)
    circles = kind.value in CIRCLE_KINDS
    inner = node["inner_size"] if circles else node.get("inner_size")
    if inner and kind.value == "chessboard" and inner.number() == 0:  # ATOM's value for a pattern without markers
        inner = None
    if inner and inner.within(MIN_SIZE, MAX_SIZE) >= size:
        raise inner.unexpected(f"less than the {'spacing of circles' if circles else 'size of a square'}, {size:g}")
    columns, rows = dimension["x"].whole(2, MAX_CORNERS), dimension["y"].whole(2, MAX_CORNERS)
    tags = kind.value == "aprilgrid"
    first = marker.whole(0, MAX_MARKER) if (marker := node.get("first_marker")) else 0
    if tags:
        check_tags(columns, rows, dimension, first)
        if (dictionary := node.get("dictionary")) and dictionary.text() not in ("", APRILGRID_TAGS):
            raise dictionary.unexpected(f"{APRILGRID_TAGS}, that of an aprilgrid")
    return PatternConfiguration(
        kind=kind.value,
        dimension=(columns, rows),
        size=size,
        inner_size=inner.number() if inner and not tags else None,
        dictionary=APRILGRID_TAGS if tags else _text_or_empty(node, "dictionary") or None,
        spacing=node["spacing"].within(MIN_SPACING, MAX_SPACING) if tags else 0.0,
        first_marker=first,
        **_frames_and_board(name, node),
    )


def _tag_list(name: str, node: Node) -> PatternConfiguration:
    listed = list(node["tags"].elements())
    try:
        tags = tuple(read(PlacedTag, each.value, f"tag {i}") for i, each in enumerate(listed))
    except InputError as error:
        raise node["tags"].fault(str(error)) from None
    if not 0 < len(tags) <= MAX_CORNERS or len({tag.id for tag in tags}) < len(tags):
        raise node["tags"].unexpected(f"1 to {MAX_CORNERS} tags, each id once")
    return PatternConfiguration(
        kind="tags",
        dimension=(len(tags), 1),
        size=tags[0].size,
        dictionary=node["dictionary"].name(),
        tags=tags,
        **_frames_and_board(name, node),
    )


def _frames_and_board(name: str, node: Node) -> dict[str, Any]:
    """Return what the configurations of all kinds of patterns have in common."""
    return {
        "name": name,
        "link": node["link"].name(),
        "parent_link": node["parent_link"].name(),
        "fixed": node["fixed"].flag(),
        "border_size": _border_widths(node.get("border_size")),
        "mesh_file": _text_or_empty(node, "mesh_file"),
        "inverted": _flag_or_false(node, "inverted"),
        "known_pose": _flag_or_false(node, "known_pose"),
    }


def check_tags(columns: int, rows: int, where: Node, first: int = 0) -> None:
    """Refuse an aprilgrid with more tags than its dictionary has.

    Raises:
        InputError: there are too many.
    """
    if first + columns * rows > TAG_COUNT:
        begin = f" from id {first}" if first else ""
        raise where.fault(
            f"found {columns} x {rows} tags{begin}, expected {TAG_COUNT} at most, as {APRILGRID_TAGS} has"
        )


def _border_widths(node: Node | None) -> tuple[float, float]:
    """Return the border's widths; one number is for all sides, else {x, y}; absent means 0."""
    if node is None:
        return (0.0, 0.0)
    x, y = (node["x"], node["y"]) if isinstance(node.value, dict) else (node, node)
    return (x.within(0.0, MAX_SIZE), y.within(0.0, MAX_SIZE))


def read_links(node: Node) -> Edge:
    """Return the frames that a sensor, a joint or a transform lies between.

    Raises:
        InputError: a name is missing.
    """
    return (node["parent_link"].name(), node["child_link"].name())


def _flag_or_false(node: Node, key: str) -> bool:
    value = node.get(key)
    return value.flag() if value else False


def _text_or_empty(node: Node, key: str) -> str:
    value = node.get(key)
    return value.text() if value else ""
