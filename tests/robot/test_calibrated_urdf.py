"""A URDF with calibrated origins: exact, and otherwise the same bytes."""

import re
from pathlib import Path

import numpy as np
import pytest
from defusedxml.ElementTree import fromstring

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import retract, transform
from calibration.robot.calibrated_urdf import calibrated_urdf
from calibration.robot.exports import calibrated
from tests.pipeline.conftest import DATASETS


def pose(x: float, y: float, z: float, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> Array:
    return transform(rotations.from_rpy((roll, pitch, yaw)), (x, y, z))


SYSTEMS = ("t2rgb", "rlbot", "riwbot", "softbot", "spjbot")


def moved(dataset: Dataset) -> Dataset:
    """The dataset with other transforms, joints' among them, in the place of a calibration's."""
    rng = np.random.default_rng(3)
    of = calibrated(dataset)
    changed = {
        edge: np.broadcast_to(retract(T, rng.normal(0, 0.1, 6)), (len(dataset.collections), 4, 4))
        for edge, T in of.transforms.items()
    }
    joints = {name: joint.values + rng.normal(0, 0.05, 7) for name, joint in dataset.joints.items()}
    return dataset.with_transforms(changed).with_joints(joints)


def origins(content: bytes) -> dict[tuple[str, str], Array]:
    """``T_parent_child`` at position 0 of each joint, by another parser."""
    found = {}
    for joint in fromstring(content).iter("joint"):
        parent, child, origin = (joint.find(tag) for tag in ("parent", "child", "origin"))
        if parent is None or child is None:
            continue
        numbers = [
            [float(v) for v in (origin.get(k, "0 0 0") if origin is not None else "0 0 0").split()]
            for k in ("xyz", "rpy")
        ]
        found[parent.attrib["link"], child.attrib["link"]] = transform(rotations.from_rpy(numbers[1]), numbers[0])
    return found


@pytest.mark.parametrize("system", SYSTEMS)
def test_only_the_calibrated_transforms_change_in_the_urdf(system: str) -> None:
    before = (DATASETS / system / "robot.urdf").read_bytes()
    of = calibrated(moved(read_dataset(DATASETS / system)))
    made = calibrated_urdf(before, {**of.transforms, **of.joints}, "robot.urdf")
    found = origins(made.content)
    for edge, T in {**of.transforms, **of.joints}.items():
        np.testing.assert_allclose(found[edge], T, atol=1e-12)
    old = origins(before)
    for edge in old.keys() - {*of.transforms, *of.joints}:
        np.testing.assert_array_equal(found[edge], old[edge])
    blank = re.compile(rb'(xyz|rpy)="[^"]*"')
    assert blank.sub(b"", made.content) == blank.sub(b"", before)


def test_what_is_in_the_file_already_stays_to_the_byte() -> None:
    before = (DATASETS / "t2rgb" / "robot.urdf").read_bytes()
    assert calibrated_urdf(before, {}, "robot.urdf").content == before


URDF = b"""<?xml version="1.0"?>
<!-- a > in a comment -->
<robot name="r">
  <link name="base"/><link name="mid"/><link name="cam"/><link name="arm"/><link name="lidar"/>
  <joint name="a" type='fixed'><parent link="base"/><child link="mid"/>
    <origin rpy='0 0 0.1'
            xyz="1 2 3" /></joint>
  <joint name="b > a" type="fixed">
    <parent link="mid"/> <child link="cam"/>
  </joint>
  <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/></joint>
  <joint name="c" type="fixed"><parent link="arm"/><child link="lidar"/></joint>
  <transmission><joint name="a"><hardwareInterface/></joint></transmission>
</robot>
"""


def test_the_last_fixed_joint_of_several_takes_the_change() -> None:
    T = pose(0.5, -1.0, 2.0, 0.3, -0.2, 0.1)
    made = calibrated_urdf(URDF, {("base", "cam"): T}, "r.urdf")
    found = origins(made.content)
    np.testing.assert_allclose(found["base", "mid"] @ found["mid", "cam"], T, atol=1e-12)
    assert (
        b"""<origin rpy='0 0 0.1'
            xyz="1 2 3" />"""
        in made.content
    )
    assert made.notes == ["'base' to 'cam' spans 2 joints; 'b > a' takes the change"]
    assert b'<joint name="b > a" type="fixed">\n    <origin xyz=' in made.content


def test_attributes_keep_their_order_and_place() -> None:
    made = calibrated_urdf(URDF, {("base", "mid"): pose(1.5, 0, 0)}, "r.urdf")
    assert (
        b"""<origin rpy="0.0 0.0 0.0"
            xyz="1.5 0.0 0.0" />"""
        in made.content
    )


@pytest.mark.parametrize(
    ("content", "edge", "message"),
    [
        (URDF, ("base", "lidar"), "not all fixed"),
        (URDF, ("base", "nowhere"), "no chain of joints from 'base' to 'nowhere'"),
        (URDF, ("cam", "base"), "no chain of joints from 'cam' to 'base'"),
        (URDF.replace(b'"cam"', b'"mid"'), ("base", "mid"), "link 'mid' has two parents"),
        (URDF.replace(b'"1 2 3"', b'"1 2"'), ("base", "cam"), "3 finite numbers"),
        (URDF.replace(b'"1 2 3"', b'"1 2 nan"'), ("base", "cam"), "3 finite numbers"),
        (URDF[:200], ("base", "cam"), "r.urdf: is not XML"),
        (b"<sdf/>", ("base", "cam"), "<sdf>, not <robot>"),
        (b"\xff\xfe<", ("base", "cam"), "a URDF in UTF-8 was expected"),
        (b'<!DOCTYPE r [<!ENTITY a "b">]><robot/>', ("base", "cam"), "DTD"),
        (
            b'<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:property name="a" value="1"/></robot>',
            ("base", "cam"),
            "is a xacro",
        ),
        (
            URDF.replace(b'link="base"', b'link="cam"'),
            ("base", "cam"),
            "frames form a loop",
        ),
    ],
)
def test_what_cannot_be_written_is_one_line(content: bytes, edge: tuple[str, str], message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        calibrated_urdf(content, {edge: pose(1.0, 0.0, 0.0)}, "r.urdf")
    assert "\n" not in str(error.value)


def test_a_dataset_that_is_not_calibrated_is_refused(tmp_path: Path) -> None:
    dataset = read_dataset(DATASETS / "t2rgb")
    edge = next(iter(calibrated(dataset).transforms))
    T = dataset.transforms[edge].copy()
    T[1, 0, 3] += 1e-3
    with pytest.raises(InputError, match="differ between collections"):
        calibrated(dataset.with_transforms({edge: T}))


def test_a_left_over_namespace_of_xacro_is_kept() -> None:
    """Xacro leaves its namespace in the URDF that it makes."""
    content = URDF.replace(b"<robot ", b'<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ', 1)
    assert b"xmlns:xacro" in content
    assert b"xmlns:xacro" in calibrated_urdf(content, {}, "r.urdf").content
