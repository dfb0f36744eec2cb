"""Random messages of any type, and bags of a robot that drives, by the library rosbags."""

import string
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.typesys import get_types_from_msg

from calibration.addons.requirements.judging import judge_bag
from calibration.addons.requirements.requirement import Judgement
from calibration.addons.requirements.settings import RequirementSettings
from calibration.base.records import read
from tests.robot.importing.bags import BEGIN, SECOND, BagFile, Kind

NUMPY_OF_KIND = {"bool": "?", "byte": "i1", "octet": "u1", "char": "u1", "float32": "f4", "float64": "f8"}
BATTERY = "std_msgs/Header header\nCell[] cells\nstring name\nuint8 OK=1\nuint8 state\nfloat32[3] volts"
CELL = "float64 charge\nint32[] history\nstring label"
"""A type of the team's own, which the library does not know."""
MS = 10**6


def random_message(types: Any, kind: str, random: np.random.Generator) -> Any:
    """A message of a type with random values."""
    fields = {name: _random_value(types, node, random) for name, node in types.fielddefs[kind][1]}
    return types.types[kind](**fields)


def _random_value(types: Any, node: Any, random: np.random.Generator) -> Any:
    code, about = int(node[0]), node[1]
    if code == 2:
        return random_message(types, about, random)
    if code == 1:
        return _random_number(about[0], random, None)
    item, size = about
    count = size if code == 3 else int(random.integers(0, 4))
    if int(item[0]) == 1 and item[1][0] != "string":
        return _random_number(item[1][0], random, count)
    return [_random_value(types, item, random) for _ in range(count)]


def _random_number(kind: str, random: np.random.Generator, count: int | None) -> Any:
    if kind == "string":
        return "".join(random.choice(list(string.printable + "é"), int(random.integers(0, 9))))
    code = np.dtype(NUMPY_OF_KIND.get(kind, kind))
    values = np.frombuffer(random.bytes((count or 1) * code.itemsize), code if kind != "bool" else "u1")
    values = values % 2 == 1 if kind == "bool" else np.nan_to_num(values)
    return values if count is not None else values[0].item()


def own_types(bag: BagFile) -> None:
    """Make the bag know the team's own types."""
    for name, definition in (("Cell", CELL), ("Battery", BATTERY)):
        bag.types.register(get_types_from_msg(definition, f"own_msgs/msg/{name}"))


def battery(bag: BagFile, charge: float, name: str = "main", state: int = 1) -> Any:
    """A message of a type of the team's own."""
    cell = bag.make("own_msgs/msg/Cell", charge=charge, history=np.arange(3, dtype=np.int32), label="cell")
    return bag.make(
        "own_msgs/msg/Battery",
        header=bag.header("base", BEGIN),
        cells=[cell, cell],
        name=name,
        OK=1,
        state=state,
        volts=np.array([1, 2, 3], np.float32),
    )


def twist(bag: BagFile, x: float) -> Any:
    """A Twist ahead."""
    zero = {"x": 0.0, "y": 0.0, "z": 0.0}
    return bag.make(
        "geometry_msgs/msg/Twist",
        linear=bag.make("geometry_msgs/msg/Vector3", **{**zero, "x": x}),
        angular=bag.make("geometry_msgs/msg/Vector3", **zero),
    )


def scan(bag: BagFile, stamp: int, ranges: list[float]) -> Any:
    """A LaserScan."""
    numbers = dict.fromkeys(
        ("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time", "range_min", "range_max"), 0.5
    )
    return bag.make(
        "sensor_msgs/msg/LaserScan",
        header=bag.header("laser", stamp),
        **numbers,
        ranges=np.array(ranges, np.float32),
        intensities=np.zeros(0, np.float32),
    )


def bag_file(folder: Path, kind: Kind, write: Callable[[BagFile], None]) -> Path:
    """Write a bag."""
    path = folder / ("robot.bag" if kind == "bag" else "robot")
    with BagFile(path, kind) as bag:
        write(bag)
    return path


def drive(bag: BagFile) -> None:
    """Ten seconds: /cmd_vel at 5 Hz, a /scan 20 ms late at 10 Hz from 1 s, tf at 10 Hz, a battery every second."""
    own_types(bag)
    bag.transforms("/tf_static", BEGIN, {("base", "laser"): np.eye(4)})
    for i in range(101):
        stamp = BEGIN + i * SECOND // 10
        if i % 2 == 0:
            bag.write("/cmd_vel", stamp, twist(bag, 0.5 if i < 90 else 0.9))
        if i >= 10:
            bag.write("/scan", stamp + 20 * MS, scan(bag, stamp, [1.0, 2.0, 0.5 + i / 100]))
        if i % 10 == 0:
            bag.write("/battery", stamp, battery(bag, 1 - i / 200))
        bag.transforms("/tf", stamp, {("odom", "base"): np.eye(4)})


def judge(path: Path, **section: object) -> dict[str, Judgement]:
    """Judge requirements over a bag, and return what was found by the requirements' names."""
    pairs, _ = judge_bag(read(RequirementSettings, section, "requirements"), [path], "requirements")
    return {judgement.name: judgement for _, judgement in pairs}
