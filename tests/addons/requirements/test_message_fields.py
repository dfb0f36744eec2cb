"""Fields read from a message's bytes are what the library rosbags decodes; wrong bytes and definitions are refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg

from calibration.addons.requirements.message_fields import (
    MAX_ITEMS,
    FieldReader,
    MessageError,
    merged_trees,
    tree_of_path,
)
from calibration.base import InputError
from calibration.robot.importing.bags.bag import open_bag, typestore
from tests.addons.requirements.messages import bag_file, drive, random_message
from tests.robot.importing.bags import Kind

KINDS = (
    *("sensor_msgs/msg/Imu", "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/JointState"),
    *("nav_msgs/msg/Odometry", "nav_msgs/msg/Path", "nav_msgs/msg/OccupancyGrid", "sensor_msgs/msg/CameraInfo"),
    *("tf2_msgs/msg/TFMessage", "diagnostic_msgs/msg/DiagnosticArray", "sensor_msgs/msg/Image", "std_msgs/msg/Bool"),
    *("geometry_msgs/msg/PolygonStamped", "visualization_msgs/msg/MarkerArray", "std_msgs/msg/Float64MultiArray"),
    *("sensor_msgs/msg/NavSatFix", "sensor_msgs/msg/BatteryState", "sensor_msgs/msg/Joy", "std_msgs/msg/Int64"),
)


def as_read(types: Any, value: Any) -> Any:
    """A decoded value in the form in which fields are read."""
    kind = getattr(value, "__msgtype__", None)
    if kind is not None:
        return {name: as_read(types, getattr(value, name)) for name, _ in types.fielddefs[kind][1]}
    return [as_read(types, each) for each in value] if isinstance(value, list) else value


@pytest.mark.parametrize("ros", [1, 2])
@pytest.mark.parametrize("kind", KINDS)
def test_any_field_is_what_the_library_decodes(kind: str, ros: int) -> None:
    types = typestore(ros)
    random = np.random.default_rng(len(kind) + ros)
    for _ in range(5):
        made = random_message(types, kind, random)
        data = bytes(types.serialize_ros1(made, kind) if ros == 1 else types.serialize_cdr(made, kind))
        decoded = types.deserialize_ros1(data, kind) if ros == 1 else types.deserialize_cdr(data, kind)
        expected = as_read(types, decoded)
        names = [name for name, _ in types.fielddefs[kind][1]]
        for wanted in ([name] for name in names), [names]:
            for some in wanted:
                found = FieldReader(kind, types.fielddefs, {name: {} for name in some}, ros).fields(data)
                np.testing.assert_equal(found, {name: expected[name] for name in some})


def test_big_endian_is_read() -> None:
    types = typestore(2)
    made = random_message(types, "sensor_msgs/msg/JointState", np.random.default_rng(1))
    data = bytes(types.serialize_cdr(made, "sensor_msgs/msg/JointState", little_endian=False))
    found = FieldReader("sensor_msgs/msg/JointState", types.fielddefs, tree_of_path("effort"), 2).fields(data)
    np.testing.assert_equal(found["effort"], made.effort)


def test_a_field_inside_is_read_alone() -> None:
    types = typestore(1)
    made = random_message(types, "nav_msgs/msg/Path", np.random.default_rng(3))
    data = bytes(types.serialize_ros1(made, "nav_msgs/msg/Path"))
    wanted = merged_trees([tree_of_path("poses.pose.position.y"), tree_of_path("header.frame_id")])
    found = FieldReader("nav_msgs/msg/Path", types.fielddefs, wanted, 1).fields(data)
    assert found["header"] == {"frame_id": made.header.frame_id}
    assert [each["pose"]["position"]["y"] for each in found["poses"]] == [each.pose.position.y for each in made.poses]


@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_types_of_the_teams_own_are_read_by_the_bags_definitions(kind: Kind, tmp_path: Path) -> None:
    with open_bag([bag_file(tmp_path, kind, drive)]) as bag:
        wanted = merged_trees([tree_of_path("cells.charge"), tree_of_path("state"), tree_of_path("OK")])
        reader = FieldReader("own_msgs/msg/Battery", bag.definitions("/battery"), wanted, bag.ros)
        found = [reader.fields(raw.data) for raw in bag.messages(["/battery"])]
    assert found[1] == {"OK": 1, "cells": [{"charge": 0.95}, {"charge": 0.95}], "state": 1}
    assert len(found) == 11


@pytest.mark.parametrize(
    ("path", "found"),
    [("ranges_", "did you mean 'ranges'"), ("header.stamp.secs", "fields: sec, nanosec"), ("ranges.x", "no fields")],
)
def test_a_wrong_field_is_an_input_error_that_names_those_there_are(path: str, found: str) -> None:
    with pytest.raises(InputError, match=found):
        FieldReader("sensor_msgs/msg/LaserScan", typestore(1).fielddefs, tree_of_path(path), 1)


@pytest.mark.parametrize("ros", [1, 2])
def test_every_shorter_message_is_refused(ros: int) -> None:
    types, kind = typestore(ros), "nav_msgs/msg/Path"
    made = random_message(types, kind, np.random.default_rng(8))
    data = bytes(types.serialize_ros1(made, kind) if ros == 1 else types.serialize_cdr(made, kind))
    reader = FieldReader(kind, types.fielddefs, tree_of_path("poses"), ros)
    for size in range(len(data)):
        with pytest.raises(MessageError):
            reader.fields(data[:size])


def test_lengths_that_lie_are_refused_before_anything_is_made() -> None:
    types = {"x/msg/A": ([], [("many", (4, ((2, "x/msg/Empty"), 0)))]), "x/msg/Empty": ([], [])}
    reader = FieldReader("x/msg/A", types, tree_of_path("many"), 1)
    with pytest.raises(MessageError, match=str(MAX_ITEMS)):
        reader.fields(b"\xff\xff\xff\x7f")


def test_definitions_that_name_themselves_or_grow_without_bytes_are_bounded() -> None:
    circle = get_types_from_msg("A a\nint32 b", "x/msg/A")
    with pytest.raises(InputError, match="inside one another"):
        FieldReader("x/msg/A", circle, tree_of_path("b"), 1)
    grows: dict[str, Any] = {"x/msg/T0": ([], [])}
    for i in range(1, 15):
        grows[f"x/msg/T{i}"] = ([], [(f"f{j}", (2, f"x/msg/T{i - 1}")) for j in range(9)])
    grows["x/msg/A"] = ([], [("a", (2, "x/msg/T14")), ("b", (1, ("int32", 0)))])
    with pytest.raises(MessageError, match="items"):
        FieldReader("x/msg/A", grows, tree_of_path("b"), 1).fields(bytes(4))
