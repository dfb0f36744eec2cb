"""Joints of the true robot, which differ from their description."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from calibration.base.errors import InputError
from calibration.base.records import Place, read_as
from calibration.engine.geometry.joints import JOINT_PARAMETERS
from calibration.engine.geometry.transforms import from_xyz_rpy
from calibration.robot.simulation.joints import (
    JointErrors,
    check_calibrated_joints,
    joint_model,
    joint_values,
    with_errors,
)
from calibration.robot.simulation.robot import Joint, JointKind
from calibration.robot.simulation.system import System, read_system
from tests.lint.documents import yaml_blocks
from tests.robot.simulation.conftest import DATASETS

SMALL = st.floats(-0.5, 0.5)


def joint(kind: JointKind = "revolute", xyz: tuple[float, ...] = (0.1, 0.2, 0.3)) -> Joint:
    return Joint("j", kind, "a", "b", from_xyz_rpy(xyz, (0.4, -0.5, 0.6)), np.array([0.0, 0.6, 0.8]), -2.0, 2.0)


@given(st.sampled_from(["revolute", "continuous", "prismatic"]), st.lists(SMALL, min_size=7, max_size=7), SMALL)
def test_errors_of_the_origin_and_of_the_position(kind: JointKind, errors: list[float], position: float) -> None:
    """The bias is as if the joint stood further on; the origin's parameters add up as ATOM's do."""
    nominal = joint(kind)
    robot = replace(read_system(DATASETS / "spjbot").nominal, joints=(nominal,))
    own = dict(zip(JOINT_PARAMETERS, errors, strict=True))
    (true,) = with_errors(robot, {"j": own}).joints
    expected = replace(
        nominal,
        T_parent_joint=from_xyz_rpy(
            np.array([0.1, 0.2, 0.3]) + errors[:3], np.array([0.4, -0.5, 0.6]) + np.array(errors[3:6])
        ),
    )
    np.testing.assert_allclose(
        true.transform(np.array([position])), expected.transform(np.array([position + errors[6]])), atol=1e-12
    )
    np.testing.assert_allclose(joint_values(nominal, own), np.add([0.1, 0.2, 0.3, 0.4, -0.5, 0.6, 0], errors))
    np.testing.assert_allclose(joint_model(nominal).pose(joint_values(nominal)), nominal.T_parent_joint, atol=1e-12)


def test_what_the_docs_show_is_read() -> None:
    """One block is of config.yml, the other of simulation.yml; both speak of the same two joints."""
    docs = Path(__file__).parents[3] / "docs" / "joints.md"
    asked, simulated = (yaml.safe_load(text) for _, text in yaml_blocks(docs.read_text()))
    elbow, slide = replace(joint(), name="elbow"), replace(joint("prismatic"), name="slide")
    robot = replace(read_system(DATASETS / "spjbot").nominal, joints=(elbow, slide))
    parameters = {name: tuple(each["params_to_calibrate"]) for name, each in asked["joints"].items()}

    check_calibrated_joints(parameters, robot, "config.yml")
    errors = read_as(JointErrors, simulated["joints"], Place("docs"))
    assert {name: tuple(own) for name, own in errors.items()} == parameters


def test_the_description_stays_as_it_is(systems: dict[str, System]) -> None:
    system = systems["spjbot"]
    assert system.joint_errors == {
        "j2_joint": {"origin_yaw": 0.02},
        "j3_joint": {"origin_z": 0.005},
        "j4_joint": {"origin_yaw": -0.015},
    }
    changed = [
        name
        for name, j in system.nominal.movable.items()
        if (j.transform(0) != system.robot.movable[name].transform(0)).any()
    ]
    assert changed == list(system.joint_errors)
    assert all(systems[name].robot is systems[name].nominal for name in ("t2rgb", "rlbot", "riwbot", "softbot"))


def read(folder: Path, errors: object) -> JointErrors:
    """The errors of spjbot's joints, of a copy in which they are these."""
    for name in ("robot.urdf", "config.yml"):
        shutil.copy(DATASETS / "spjbot" / name, folder)
    simulation = yaml.safe_load((DATASETS / "spjbot" / "simulation.yml").read_text())
    (folder / "simulation.yml").write_text(yaml.safe_dump(simulation | {"joints": errors}))
    return read_system(folder).joint_errors


def test_errors_are_read(systems: dict[str, System], tmp_path: Path) -> None:
    assert read(tmp_path, None) == {}
    found = read(tmp_path, {"j5_joint": {"position_bias": -0.1, "origin_x": 0}, "j1_joint": {}})
    assert found == {"j5_joint": {"position_bias": -0.1}, "j1_joint": {}}
    assert with_errors(systems["spjbot"].nominal, {"j1_joint": {}}) is systems["spjbot"].nominal


@pytest.mark.parametrize(
    ("errors", "message"),
    [
        ({"j9": {}}, r"joints: unknown key 'j9'.*known: j1_joint, .*j5_joint"),
        ({"world_to_base_link": {}}, "unknown key 'world_to_base_link'"),
        ({"j1_joint": {"yaw": 1}}, r"joints.j1_joint: unknown key 'yaw'.*known: origin_x, .*position_bias"),
        ({"j1_joint": {"origin_z": 1.5}}, "origin_z: found 1.5, expected a number from -1 to 1"),
        ({"j1_joint": {"origin_z": float("nan")}}, "origin_z: found nan"),
        ({"j1_joint": {"origin_z": "far"}}, "origin_z: found 'far'"),
        ({"j1_joint": 0.1}, r"joints\.j1_joint: found 0.1, expected keys"),
        ([0.1], "joints"),
    ],
)
def test_invalid_joint_errors_are_refused(tmp_path: Path, errors: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(tmp_path, errors)


@pytest.mark.parametrize(
    ("joints", "message"),
    [
        ("j9: {params_to_calibrate: [origin_x]}", "joints/j9: .*robot.urdf has no joint 'j9' that moves .*j1_joint"),
        ("world_to_base_link: {params_to_calibrate: [origin_x]}", "no joint 'world_to_base_link' that moves"),
        (
            "j1_joint: {params_to_calibrate: [origin_x, yaw]}",
            "joints/j1_joint/params_to_calibrate: found 'yaw', expected one or more of origin_x, ",
        ),
        ("j1_joint: {params_to_calibrate: []}", "joints/j1_joint/params_to_calibrate: found no parameter"),
    ],
)
def test_joints_that_cannot_be_calibrated(tmp_path: Path, joints: str, message: str) -> None:
    text = (DATASETS / "spjbot" / "config.yml").read_text()
    config = tmp_path / "config.yml"
    config.write_text(text.replace("joints:\n", f"joints:\n  {joints}\n"))
    with pytest.raises(InputError, match=message):
        read_system(DATASETS / "spjbot", configuration=config)


def test_a_transform_is_calibrated_once(tmp_path: Path) -> None:
    text = (DATASETS / "softbot" / "config.yml").read_text()
    config = tmp_path / "config.yml"
    config.write_text(text.replace("joints:\n", "joints:\n  turn: {params_to_calibrate: [origin_yaw]}\n"))
    with pytest.raises(InputError, match="joints/turn: the whole transform from 'odometry_y' to 'base_footprint'"):
        read_system(DATASETS / "softbot", configuration=config)
