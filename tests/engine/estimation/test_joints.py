"""Joints: their parameters are found with correct covariances; degenerate ones are named."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.base import UndeterminedError
from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.options import ALL_EXACT
from calibration.engine.estimation.start.build import build
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.engine.geometry.frames import JOINT_PARAMETERS, JointParameter
from calibration.engine.geometry.transforms import distance, inverse
from tests.engine.estimation.scenes import Scene, board, camera, errors, pose
from tests.engine.estimation.systems import jointed_arm

Free = dict[str, tuple[JointParameter, ...]]
ORIGIN = JOINT_PARAMETERS[:6]
CASES: dict[str, Free] = {
    "one angle": {"j3": ("origin_yaw",)},
    "one encoder": {"j4": ("position_bias",)},
    "a prismatic encoder": {"slide": ("position_bias",)},
    "a prismatic origin": {"slide": ("origin_x", "origin_roll", "origin_pitch")},
    "a whole origin": {"j3": ORIGIN},
    "an angle and an encoder": {"j3": ("origin_yaw", "position_bias")},
    "five encoders": dict.fromkeys(("j2", "j3", "slide", "j4", "j5"), ("position_bias",)),
    "angles in a row": {"j2": ("origin_yaw",), "j4": ("origin_pitch",), "j5": ("origin_y", "origin_roll")},
}


def nominal(dataset: Dataset, size: float, seed: int = 0) -> Dataset:
    """The dataset with all free parameters off by so much (m, rad)."""
    rng = np.random.default_rng(seed)
    off = {}
    for name, joint in dataset.joints.items():
        free = np.isin(JOINT_PARAMETERS, joint.parameters)
        off[name] = joint.values + size * free * rng.choice([-1.0, 1.0], 7)
    return dataset.with_joints(off)


def joint_errors(result: Calibration, dataset: Dataset) -> np.ndarray:
    """Of all free parameters, one after the other."""
    each = [
        joint.values - dataset.joints[name].values[np.isin(JOINT_PARAMETERS, joint.parameters)]
        for name, joint in result.joints.items()
    ]
    return np.concatenate(each)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("size", [0.0, 0.02, 0.1])
def test_exact_labels_give_the_truth(case, size):
    dataset = jointed_arm(free=CASES[case]).dataset()
    result = calibrate(nominal(dataset, size), noise=StartingNoise(0.5, 0.5))
    assert result.converged, result.reason
    assert {name: joint.parameters for name, joint in result.joints.items()} == CASES[case]
    assert np.abs(joint_errors(result, dataset)).max() < 1e-8
    assert max(errors(dataset, result.transforms)) < 1e-8
    for name in CASES[case]:
        edge = dataset.joints[name].edge
        np.testing.assert_allclose(result.dataset.transforms[edge], dataset.transforms[edge], atol=1e-8)
        np.testing.assert_allclose(result.dataset.joints[name].values, dataset.joints[name].values, atol=1e-8)


def test_a_joint_that_is_walked_upwards():
    """The pattern on the arm, the camera in the world: the chain goes from the world down; seen from a camera in
    the hand it goes up. Both are the same joints."""
    scene = jointed_arm(free={"j3": ("origin_x", "origin_yaw"), "slide": ("position_bias",)})
    transforms = {edge: T for edge, T in scene.transforms.items() if edge[1] not in ("cam", "board_link")}
    transforms["world", "cam"] = scene.transforms["world", "board_link"] @ pose(0, 0, -4.5)
    transforms["j6", "board_link"] = pose(0.1, 0.0, 0.1, 0.2, 0.1, 0.0)
    swapped = replace(scene, transforms=transforms, sensors=[camera("cam")], patterns=[board(parent="j6", fixed=True)])
    for each, inverted in ((scene, True), (swapped, False)):
        dataset = each.dataset()
        setup = build(dataset)
        (group,) = setup.problem.groups
        assert {link.inverted for link in group.chain.links if setup.problem.blocks[link.block].joint} == {inverted}
        result = calibrate(nominal(dataset, 0.03))
        assert np.abs(joint_errors(result, dataset)).max() < 1e-8


def test_what_is_not_free_stays():
    dataset = jointed_arm(free={"j3": ("origin_yaw",)}).dataset()
    result = calibrate(nominal(dataset, 0.05))
    assert np.flatnonzero(result.dataset.joints["j3"].values != dataset.joints["j3"].values).tolist() in ([], [5])
    assert result.joints["j3"].units == ("rad",)
    assert calibrate(jointed_arm(free={"slide": ("origin_x", "position_bias")}).dataset()).joints["slide"].units == (
        "m",
        "m",
    )


def test_fixed_joints_and_parameters():
    dataset = jointed_arm(free={"j3": ("origin_x", "origin_yaw"), "j4": ("position_bias",)}).dataset()
    off = nominal(dataset, 0.01)
    part = calibrate(dataset, Options(hold=("joint-j3-origin_yaw", "joint-j4-position_bias")))
    assert {name: joint.parameters for name, joint in part.joints.items()} == {"j3": ("origin_x",)}
    assert np.abs(joint_errors(part, dataset)).max() < 1e-8
    none = calibrate(off, Options(hold=("joint-j3", "joint-j4")))
    assert none.joints == {}
    for name in ("j3", "j4"):
        np.testing.assert_array_equal(none.dataset.joints[name].values, off.joints[name].values)


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("case", ["one angle", "a prismatic encoder", "a whole origin", "angles in a row"])
@pytest.mark.many_scenes
def test_the_errors_are_as_large_as_stated(case):
    scores, normalised, scenes = [], [], 25
    for seed in range(scenes):
        dataset = jointed_arm(20, seed=0, free=CASES[case], pixel_noise=0.3).dataset(seed)
        result = calibrate(
            nominal(dataset, 0.02, seed), Options(loss="linear" if seed % 2 else "huber", assume=ALL_EXACT)
        )
        for name, joint in result.joints.items():
            e = joint.values - dataset.joints[name].values[np.isin(JOINT_PARAMETERS, joint.parameters)]
            scores.append(e @ np.linalg.solve(joint.covariance, e) / len(e))
            normalised.append(e / joint.sigmas)
    freedom = sum(len(each) for each in normalised)
    assert abs(np.mean(scores) - 1) < 4 * np.sqrt(2 / freedom)
    z = np.concatenate(normalised)
    assert abs(np.mean(z**2) - 1) < 6 * np.sqrt(2 / freedom)  # parameters of a joint are correlated


@pytest.mark.many_scenes
def test_the_mount_and_the_base_keep_honest_errors_beside_a_joint():
    scores = []
    for seed in range(20):
        dataset = jointed_arm(20, free=CASES["five encoders"], pixel_noise=0.3).dataset(seed)
        result = calibrate(nominal(dataset, 0.02, seed))
        for edge, covariance in result.label_covariances.items():
            D = inverse(result.transforms[edge]) @ dataset.transforms[edge][0]
            t, r = distance(np.eye(4), D)
            scores.append((t / np.sqrt(np.trace(covariance[:3, :3])), r / np.sqrt(np.trace(covariance[3:, 3:]))))
    assert 0.7 < np.mean(np.square(scores)) < 1.3


@pytest.mark.parametrize(
    ("free", "names"),
    [
        ({"j1": ("origin_yaw",)}, ("'joint-j1' (origin_yaw)", "'board'")),
        ({"j6": ("position_bias",)}, ("'joint-j6' (position_bias)", "'j6-cam'")),
        ({"j1": ("position_bias",), "j3": ("position_bias",)}, ("'joint-j1' (position_bias)", "'board'")),
        ({"j3": (*ORIGIN[3:], "position_bias")}, ("'joint-j3' (", "position_bias", "origin_yaw")),
        ({"j3": ("origin_yaw", "position_bias"), "j1": ("origin_z",)}, ("'joint-j1' (origin_z)", "'board'")),
    ],
)
@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_degenerate_parameters_are_named(free, names, noise):
    dataset = jointed_arm(free=free, pixel_noise=noise).dataset()
    with pytest.raises(UndeterminedError) as error:
        calibrate(nominal(dataset, 0.01))
    message = str(error.value)
    assert all(name in message for name in names), message
    held = message.rpartition("or hold one of them, such as '")[2].removesuffix("'")
    assert held in {f"joint-{joint}-{parameter}" for joint, parameters in free.items() for parameter in parameters}


def test_holding_one_of_them_determines_the_other():
    dataset = jointed_arm(free={"j1": ("origin_yaw",), "j6": ("position_bias",)}).dataset()
    result = calibrate(nominal(dataset, 0.02), Options(hold=("board", "cam")))
    assert result.converged
    assert np.abs(joint_errors(result, dataset)).max() < 1e-8


def test_a_joint_that_no_view_depends_on():
    scene = jointed_arm(free={"j3": ("origin_yaw",)})
    beside = replace(scene.joints[0], name="beside", edge=("world", "beside"))
    with pytest.raises(UndeterminedError, match="'joint-beside' does not lie between any sensor and a pattern"):
        build(replace(scene, joints=(*scene.joints, beside)).dataset())


def test_two_arms_of_which_each_camera_sees_its_own_joints():
    """The joints on a chain are not neighbours among the parameters."""
    one = jointed_arm(free={"j2": ("position_bias",), "j3": ("position_bias",), "j4": ("position_bias",)})
    names = {edge[1]: f"other_{edge[1]}" for edge in one.dataset().transforms} | {"world": "world"}
    transforms = dict(one.transforms)
    transforms |= {(names[p], names[c]): T for (p, c), T in one.transforms.items()}
    third = replace(one.joints[1], name="other_j3", edge=("other_j2", "other_j3"), values=one.joints[1].values + 0.01)
    transforms |= {(names[j.edge[0]], names[j.edge[1]]): j.transform for j in (one.joints[0], one.joints[2])}
    sensors = [*one.sensors, replace(camera("other_cam", "other_j6"))]
    patterns = [*one.patterns, replace(board("other_board", fixed=True, square=0.12), link="other_board_link")]
    scene: Scene = replace(
        one,
        transforms=transforms,
        joints=(one.joints[0], third, one.joints[1], one.joints[2]),
        sensors=sensors,
        patterns=patterns,
        sees=lambda s, p, _: s.startswith("other") == p.startswith("other"),
    )
    dataset = scene.dataset()
    result = calibrate(nominal(dataset, 0.02))
    assert np.abs(joint_errors(result, dataset)).max() < 1e-8
    assert len(result.joints) == 4
