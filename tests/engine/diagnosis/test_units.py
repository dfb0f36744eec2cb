"""Millimetres and degrees, each planted in data that ship or in recorded ones, are refused by name."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.base import InputError
from calibration.engine.dataset.model import Dataset, Edge, PointLabels
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.diagnosis.units import check_units
from calibration.engine.geometry.frames import JOINT_PARAMETERS
from tests.engine.estimation.scenes import relabelled
from tests.engine.estimation.systems import mobile_base, stereo, two_arms

DATASETS = Path(__file__).parents[3] / "datasets"


def refusal(dataset: Dataset) -> str:
    with pytest.raises(InputError) as error:
        check_units(dataset)
    return str(error.value)


def scaled_pattern(dataset: Dataset, corners: float, outline: float) -> Dataset:
    patterns = {
        name: replace(pattern, corners=pattern.corners * corners, outline=pattern.outline * outline)
        for name, pattern in dataset.patterns.items()
    }
    return replace(dataset, patterns=patterns)


def in_millimetres(dataset: Dataset, which: Callable[[Edge], bool] = lambda _: True) -> Dataset:
    scaled = {}
    for edge, T in dataset.transforms.items():
        if which(edge):
            scaled[edge] = T.copy()
            scaled[edge][:, :3, 3] *= 1000
    return dataset.with_transforms(scaled)


@pytest.mark.parametrize("name", ["t2rgb", "rlbot", "riwbot", "softbot", "spjbot"])
def test_data_that_ship_are_in_metres(name: str) -> None:
    check_units(read_dataset(DATASETS / name))


def test_a_pattern_in_millimetres(shared_data: Path) -> None:
    recorded = read_dataset(shared_data / "t2rgb-paper")
    check_units(recorded)
    assert "found squares of 60 m, expected 1 m at most; this looks like millimetres: 0.06 m" in refusal(
        scaled_pattern(recorded, 1000, 1000)
    )
    assert "this looks like centimetres: 0.06 m or inches: 0.152 m" in refusal(scaled_pattern(recorded, 100, 100))
    assert "this looks like centimetres: 0.0236 m or inches: 0.06 m" in refusal(scaled_pattern(recorded, 39.37, 39.37))
    assert "found a border of 699.34 m around the squares" in refusal(scaled_pattern(recorded, 1, 1000))


@pytest.mark.parametrize(
    ("name", "edge", "said"),
    [
        (
            "t2rgb",
            "'tripod_plate-",
            "'left_camera' and 'right_camera' are 385 m apart, although both see 'pattern_1' 2.2 m away",
        ),
        ("riwbot", "'", "although it sees 'pattern_1' "),
        ("spjbot", "'", "although it sees 'pattern_1' "),
        ("softbot", "'", "'front_left_camera' and 'front_right_camera' are "),
    ],
)
def test_transforms_in_millimetres(name: str, edge: str, said: str) -> None:
    message = refusal(in_millimetres(read_dataset(DATASETS / name)))
    assert f"transform {edge}" in message
    assert said in message
    assert message.endswith("expected metres, this looks like millimetres")


def test_one_link_of_an_arm_in_millimetres() -> None:
    dataset = in_millimetres(read_dataset(DATASETS / "riwbot"), lambda edge: edge[0] == "upper_arm_link")
    assert "'upper_arm_link-forearm_link'" in refusal(dataset)


def test_a_lidar_in_millimetres() -> None:
    def scaled(_: int, __: str, label: object) -> object:
        return replace(label, points=label.points * 1000) if isinstance(label, PointLabels) else label

    message = refusal(relabelled(read_dataset(DATASETS / "rlbot"), scaled))
    assert "sensor 'lidar_right': found the pattern" in message
    assert "this looks like millimetres" in message


@pytest.mark.parametrize(
    ("what", "said"),
    [
        (
            "origin",
            "its origin's angles and its transform 'j1_link-j2_link' do not go together; this looks like degrees",
        ),
        ("position", "found a position of 104.3 rad, expected two turns at most; this looks like degrees"),
        ("small", "its position and its transform 'j1_link-j2_link' do not go together; this looks like degrees"),
    ],
)
def test_a_joint_in_degrees(what: str, said: str) -> None:
    dataset = read_dataset(DATASETS / "spjbot")
    joint = dataset.joints["j2_joint"]
    if what == "origin":
        angles = np.array(["roll" in p or "pitch" in p or "yaw" in p for p in JOINT_PARAMETERS])
        turned = joint.values + 0.5 * angles
        true = replace(joint, values=turned)
        wrong = replace(joint, values=np.where(angles, np.degrees(turned), turned))
    else:
        true = joint if what == "position" else replace(joint, positions=joint.positions / 20)
        wrong = replace(joint, positions=np.degrees(true.positions))
    dataset = dataset.with_transforms({joint.edge: true.transform})
    check_units(replace(dataset, joints={joint.name: true}))
    assert said in refusal(replace(dataset, joints={joint.name: wrong}))


def test_a_joint_whose_transform_is_made_of_degrees() -> None:
    dataset = read_dataset(DATASETS / "spjbot")
    joint = dataset.joints["j2_joint"]
    wrong = replace(joint, positions=np.degrees(joint.positions))
    told = replace(dataset, joints={joint.name: wrong}).with_transforms({joint.edge: wrong.transform})
    assert "joint 'j2_joint': found a position of" in refusal(told)
    assert "this looks like degrees" in refusal(told)


def test_long_drives_and_bad_guesses_are_not_taken_for_millimetres() -> None:
    dataset = mobile_base().dataset()
    far = dataset.transforms["world", "base"].copy()
    far[:, :2, 3] += (540_000, 4_500_000)  # UTM
    check_units(dataset.with_transforms({("world", "base"): far}))
    for scene in (mobile_base, two_arms, stereo):
        dataset = scene().dataset()
        check_units(dataset)
        check_units(dataset.with_transforms({sensor.edge: np.eye(4) for sensor in dataset.sensors.values()}))
