"""Calibrated transforms against the truth, gauge removed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.base import InputError
from calibration.engine.dataset.model import Dataset, Joint
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.evaluation.truth import (
    JointError,
    PoseError,
    Truth,
    TruthError,
    find_truth,
    truth_error,
    truth_of,
)
from calibration.engine.geometry import rotations
from calibration.engine.geometry.frames import JointModel, JointParameter
from calibration.engine.geometry.transforms import from_xyz_rpy, inverse, retract, translation
from tests.engine.evaluation.scene import T_LINK_OPTICAL, arm, dataset, lidar_and_camera, pattern, rgb, two_cameras

RIGHT, LEFT = ("right_mount", "right_link"), ("left_mount", "left_link")


def moved(base: Dataset, edge: tuple[str, str], twist: list[float]) -> Dataset:
    T = base.transforms[edge]
    return base.with_transforms({edge: retract(T, np.broadcast_to(twist, (len(T), 6)))})


def test_a_dataset_has_no_error_against_itself():
    for base in (two_cameras(n=2)[0], arm(n=2), lidar_and_camera(n=2)[0]):
        error = truth_error(base, truth_of(base))
        assert error.translation_mm == pytest.approx(0, abs=1e-9)
        assert error.rotation_deg == pytest.approx(0, abs=1e-6)


def test_two_cameras_that_move_together_are_not_wrong():
    base, _ = two_cameras(n=2)
    G = from_xyz_rpy([1, 2, 3], [0.1, 0.2, 0.3])
    T = {
        edge: inverse(base.transforms["world", edge[0]]) @ G @ base.transforms["world", edge[0]] @ base.transforms[edge]
        for edge in (LEFT, RIGHT)
    }
    error = truth_error(base.with_transforms(T), truth_of(base))
    assert [pose.name for pose in error.poses] == ["left/right"]
    assert error.translation_mm < 1e-6
    assert error.rotation_deg < 1e-6


def test_a_camera_that_moved_alone_is():
    base, _ = two_cameras(n=2)
    error = truth_error(moved(base, RIGHT, [0.003, 0, 0.004, 0, 0, 0]), truth_of(base))
    assert error.translation_mm == pytest.approx(5)
    assert error.rotation_deg == pytest.approx(0, abs=1e-6)


def test_the_worse_of_the_two_points_of_view_counts():
    base, _ = two_cameras(n=2)
    error = truth_error(moved(base, RIGHT, [0, 0, 0, 0, 0, 0.01]), truth_of(base))
    # the right camera turns on the spot: seen from it, the left one 0.3 m away has moved
    assert error.translation_mm == pytest.approx(3, abs=0.1)
    assert error.rotation_deg == pytest.approx(np.degrees(0.01))
    swapped = replace(base, sensors=dict(reversed(base.sensors.items())))
    again = truth_error(moved(swapped, RIGHT, [0, 0, 0, 0, 0, 0.01]), truth_of(base))
    assert again.poses[0].name == "right/left"
    assert again.translation_mm == pytest.approx(error.translation_mm)


def test_an_anchored_sensor_counts_with_the_others_own_transform():
    base, _ = two_cameras(n=2)
    error = truth_error(moved(replace(base, anchored="left"), RIGHT, [0, 0.002, 0, 0, 0, 0.01]), truth_of(base))
    assert [pose.name for pose in error.poses] == ["right"]
    assert error.translation_mm == pytest.approx(2)
    assert error.rotation_deg == pytest.approx(np.degrees(0.01))


def test_a_single_sensor_counts_with_its_own_transform():
    base = arm(n=2)
    error = truth_error(moved(base, ("eye_mount", "eye_link"), [0, 0.002, 0, 0, 0, 0]), truth_of(base))
    assert error.poses == (PoseError("eye", pytest.approx(2), pytest.approx(0, abs=1e-6)),)


def test_of_three_sensors_every_pair_counts():
    names = ("a", "b", "c")
    transforms = {
        **{("world", f"{n}_mount"): translation([0, i, 0]) for i, n in enumerate(names)},
        **{(f"{n}_mount", f"{n}_link"): np.eye(4) for n in names},
        **{(f"{n}_link", f"{n}_optical"): T_LINK_OPTICAL for n in names},
    }
    base = dataset([rgb(n) for n in names], pattern(), transforms, [{}, {}])
    base = replace(base, collections=two_cameras(n=2)[0].collections)
    wrong = moved(
        moved(base, ("b_mount", "b_link"), [0.001, 0, 0, 0, 0, 0]), ("c_mount", "c_link"), [-0.001, 0, 0, 0, 0, 0]
    )
    error = truth_error(wrong, truth_of(base))
    assert [pose.name for pose in error.poses] == ["a/b", "a/c", "b/c"]
    np.testing.assert_allclose([pose.translation_mm for pose in error.poses], [1, 1, 2])
    assert error.translation_mm == pytest.approx(2)


def test_the_worst_may_be_of_different_poses():
    error = TruthError((PoseError("a", 1, 9), PoseError("b", 2, 3)))
    assert (error.translation_mm, error.rotation_deg) == (2, 9)


def test_the_worst_collection_counts():
    base, _ = two_cameras(n=3)
    sway = base.transforms["world", "right_mount"] @ from_xyz_rpy(
        np.zeros((3, 3)), [[0, 0, 0], [0, 0, 0.2], [0, 0, 0.1]]
    )
    base = base.with_transforms({("world", "right_mount"): sway})
    truth = truth_of(base)
    wrong = moved(base, ("world", "left_mount"), [0, 0, 0, 0, 0, 0])
    assert truth_error(wrong, truth).translation_mm < 1e-9
    links = base.transforms[RIGHT].copy()
    links[2] = links[2] @ translation([0, 0, 0.007])
    assert truth_error(base.with_transforms({RIGHT: links}), truth).translation_mm == pytest.approx(7)


def test_a_collection_without_labels_does_not_count():
    base, _ = two_cameras(n=2)
    broken = base.transforms["world", "right_mount"].copy()
    broken[1] = np.nan
    blind = replace(base, collections=(base.collections[0], replace(base.collections[1], labels={})))
    error = truth_error(blind.with_transforms({("world", "right_mount"): broken}), truth_of(base))
    assert error.translation_mm == pytest.approx(0, abs=1e-9)


def test_a_sensor_that_the_truth_lacks_is_told():
    base, _ = two_cameras(n=2)
    whole = truth_of(base)
    truth = Truth(Path("ground_truth.json"), {"left": LEFT}, {LEFT: whole.transforms[LEFT]}, {})
    with pytest.raises(
        InputError, match=r"ground_truth\.json: sensor 'right': no true transform 'right_mount-right_link'"
    ):
        truth_error(base, truth)


def test_nothing_to_compare_is_an_error():
    base = arm(n=2)
    with pytest.raises(InputError, match="only sensor 'eye', and it is anchored"):
        truth_error(replace(base, anchored="eye"), truth_of(base))
    blind = replace(base, collections=tuple(replace(c, labels={}) for c in base.collections))
    with pytest.raises(InputError, match="no collection has labels"):
        truth_error(blind, truth_of(base))


def test_a_transform_that_is_not_finite_is_an_error():
    base = arm(n=2)
    broken = base.transforms["eye_mount", "eye_link"].copy()
    broken[1, 0, 3] = np.nan
    with pytest.raises(InputError, match="a transform of eye is not finite"):
        truth_error(base.with_transforms({("eye_mount", "eye_link"): broken}), truth_of(base))


@pytest.mark.parametrize(("name", "poses"), [("t2rgb", 1), ("riwbot", 1), ("rlbot", 1)])
def test_the_synthetic_datasets_hold_their_truth(shared_data, name, poses):
    base = read_dataset(shared_data / "synthetic" / name)
    truth = find_truth(base)
    assert truth is not None
    error = truth_error(base, truth)
    assert len(error.poses) == poses
    assert error.translation_mm < 1e-6
    assert error.rotation_deg < 1e-5


def bent(kind: str = "revolute", anchored: str | None = None) -> Dataset:
    """The arm of `arm` with a joint above its camera, of which two parameters are calibrated."""
    base = arm(n=2)
    model = JointModel(kind == "prismatic", (0.0, 0.0, 1.0))
    values = np.array([0.05, 0.02, 0.1, 0.0, 0.0, 3.0, 0.1])
    asked: tuple[JointParameter, ...] = ("origin_yaw", "position_bias")
    elbow = Joint("elbow", ("world", "elbow"), model, asked, values, np.array([0.1, 0.4]))
    transforms = {edge: T for edge, T in base.transforms.items() if edge != ("world", "eye_mount")}
    transforms[elbow.edge] = elbow.transform
    transforms["elbow", "eye_mount"] = base.transforms["world", "eye_mount"]
    return replace(base, transforms=transforms, joints={"elbow": elbow}, anchored=anchored)


def off(base: Dataset, *errors: float) -> Dataset:
    """The dataset whose joint has these errors in its parameters."""
    return base.with_joints({"elbow": np.add(base.joints["elbow"].values, errors)})


def test_a_joint_is_held_against_its_true_parameters():
    base = bent()
    truth = truth_of(base)
    assert truth_error(base, truth).joints == (
        JointError("elbow", "origin_yaw", 0.0, "rad"),
        JointError("elbow", "position_bias", 0.0, "rad"),
    )
    error = truth_error(off(base, 0.5, 0, 0, 0, 0, 0.01, -0.02), truth)  # the first is not calibrated
    assert [each.error for each in error.joints] == pytest.approx([0.01, 0.02])
    assert (error.joint_mm, error.joint_deg) == (None, pytest.approx(np.degrees(0.02)))
    assert error.translation_mm == pytest.approx(0, abs=1e-9)


def test_an_angle_is_the_same_after_a_whole_turn():
    base = bent()
    error = truth_error(off(base, 0, 0, 0, 0, 0, 2 * np.pi + 0.01, 0), truth_of(base))
    assert error.joint_deg == pytest.approx(np.degrees(0.01))


def test_a_slide_errs_in_millimetres():
    base = bent("prismatic")
    error = truth_error(off(base, 0, 0, 0, 0, 0, 0.01, -7.0), truth_of(base))
    assert error.joint_mm == pytest.approx(7000)
    assert error.joint_deg == pytest.approx(np.degrees(0.01))
    assert TruthError(error.poses).joint_mm is None
    assert TruthError(error.poses).joint_deg is None


def test_an_anchored_camera_may_be_all_but_the_joints():
    base = bent(anchored="eye")
    truth = truth_of(base)
    assert truth_error(base, truth).translation_mm == pytest.approx(0, abs=1e-9)
    elsewhere = moved(base, ("eye_mount", "eye_link"), [0.002, 0, 0, 0, 0, 0])
    assert truth_error(elsewhere, truth).translation_mm == pytest.approx(2)


def test_a_joint_that_the_truth_lacks_or_that_is_not_finite():
    base = bent()
    truth = truth_of(base)
    with pytest.raises(InputError, match="joint 'elbow': no true 'origin_yaw'"):
        truth_error(base, replace(truth, joints={}))
    broken = np.add(base.joints["elbow"].values, [0, 0, 0, 0, 0, 0, np.nan])
    with pytest.raises(InputError, match="'position_bias' of joint 'elbow' is not finite"):
        truth_error(replace(base, joints={"elbow": replace(base.joints["elbow"], values=broken)}), truth)


def test_a_joint_between_two_cameras_moves_one_against_the_other():
    base, _ = two_cameras(n=2)
    mount = base.transforms["world", "right_mount"][0]
    values = np.array([*mount[:3, 3], *rotations.to_rpy(mount[:3, :3]), 0.0])
    neck = Joint(
        "neck", ("world", "right_mount"), JointModel(True, (0.0, 0.0, 1.0)), ("origin_z",), values, np.zeros(2)
    )
    base = replace(base, joints={"neck": neck})
    error = truth_error(base.with_joints({"neck": np.add(values, [0, 0, 0.004, 0, 0, 0, 0])}), truth_of(base))
    assert error.translation_mm == pytest.approx(4)
    assert error.joint_mm == pytest.approx(4)
