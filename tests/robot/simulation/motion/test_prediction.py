from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from calibration.base.errors import InputError
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.geometry.transforms import distance
from calibration.robot.simulation.motion.expected import expected_dataset
from calibration.robot.simulation.motion.information import information, predicted_sigmas
from calibration.robot.simulation.motion.sequence import Motion
from calibration.robot.simulation.placement import place
from calibration.robot.simulation.sensors import SimulatedDepthCamera
from calibration.robot.simulation.system import System
from tests.robot.simulation.conftest import SYSTEMS
from tests.robot.simulation.exact_labels import noisy

NOTHING = (np.inf, np.inf)


@pytest.mark.parametrize("name", SYSTEMS)
def test_what_is_predicted_is_what_a_calibration_states(
    systems: dict[str, System], motions: dict[str, Motion], name: str
) -> None:
    system = systems[name]
    exact = expected_dataset(system, place(system, motions[name]))
    predicted = predicted_sigmas(system, motions[name])
    assert list(predicted) == list(system.sensors)
    for seed in range(2):
        result = calibrate(noisy(exact, system, seed), Options(loss="linear"))
        assert result.converged
        for sensor, (translation, rotation) in predicted.items():
            edge = exact.sensors[sensor].edge
            factor = 1.5 if sensor not in system.cameras else 1.15  # the border's noise is less than its step's
            for stated, expected in (
                (result.label_sigma_mm(edge), 1e3 * translation),
                (result.label_sigma_mrad(edge), 1e3 * rotation),
            ):
                assert expected / factor <= stated <= expected * factor
            off, turned = distance(result.transforms[edge], exact.transforms[edge][0])
            assert off <= 4 * translation + 1e-12
            assert turned <= 4 * rotation + 1e-12


def test_a_fixed_sensor_has_no_uncertainty(systems: dict[str, System], motions: dict[str, Motion]) -> None:
    assert predicted_sigmas(systems["t2rgb"], motions["t2rgb"])["left_camera"] == (0, 0)  # it fixes the gauge
    assert predicted_sigmas(systems["rlbot"], motions["rlbot"])["rgb_left"] == (0, 0)  # it is anchored
    assert min(predicted_sigmas(systems["riwbot"], motions["riwbot"])["rgb_world"]) > 0


@pytest.mark.parametrize("name", SYSTEMS)
def test_more_poses_never_know_less(systems: dict[str, System], motions: dict[str, Motion], name: str) -> None:
    system = systems[name]
    sigmas = [predicted_sigmas(system, motions[name].take(range(n))) for n in (3, 5, 8, 14, 24)]
    for fewer, more in pairwise(sigmas):
        for sensor in system.sensors:
            assert more[sensor][0] <= fewer[sensor][0] * (1 + 1e-9)
            assert more[sensor][1] <= fewer[sensor][1] * (1 + 1e-9)


@pytest.mark.parametrize("count", [0, 1])
def test_too_few_poses_determine_nothing(systems: dict[str, System], motions: dict[str, Motion], count: int) -> None:
    for name, system in systems.items():
        few = motions[name].take(range(count))
        assert predicted_sigmas(system, few) == dict.fromkeys(system.sensors, NOTHING)


def test_where_nothing_is_seen_nothing_is_known(systems: dict[str, System], motions: dict[str, Motion]) -> None:
    away = motions["t2rgb"]
    assert away.positions is not None
    away = replace(away, positions=away.positions + 50.0)
    assert predicted_sigmas(systems["t2rgb"], away) == dict.fromkeys(systems["t2rgb"].sensors, NOTHING)


def test_an_arm_that_turns_its_pattern_about_one_axis_leaves_it_open(
    systems: dict[str, System], motions: dict[str, Motion]
) -> None:
    """The wrist's last joint alone does not tell how far along its axis, and turned how, the pattern is mounted."""
    system = systems["riwbot"]
    first = motions["riwbot"].take([0])
    joints = {name: np.repeat(position, 12) for name, position in first.joints.items()}
    joints["wrist_3_joint"] = joints["wrist_3_joint"] + np.linspace(-0.6, 0.6, 12)
    turning = replace(first, joints=joints)
    assert len(information(system, place(system, turning)).poses) > 4
    assert predicted_sigmas(system, turning) == {"rgb_world": NOTHING}


def test_two_unknowns_in_a_row_are_open(systems: dict[str, System], motions: dict[str, Motion]) -> None:
    """A mount that is calibrated too, and never moves against the camera on it."""
    system = systems["t2rgb"]
    config = system.configuration
    mount = {"mount": ("right_support", "camera_right_link")}
    doubled = replace(system, configuration=replace(config, additional_tfs=mount))
    found = predicted_sigmas(doubled, motions["t2rgb"])
    assert found["right_camera"] == NOTHING
    assert found["left_camera"] == (0, 0)


def test_a_depth_cameras_prediction_equals_a_calibration_with_its_noise(
    systems: dict[str, System], motions: dict[str, Motion]
) -> None:
    system = systems["t2rgb"]
    depth = SimulatedDepthCamera(system.cameras["right_camera"].camera, noise=0.006, noise_growth=0.0)
    mixed = replace(system, sensors={**system.sensors, "right_camera": depth})
    predicted = predicted_sigmas(mixed, motions["t2rgb"])
    assert predicted["left_camera"] == (0, 0)
    dataset = noisy(expected_dataset(mixed, place(mixed, motions["t2rgb"])), mixed, 1)
    found = calibrate(dataset)
    edge = dataset.sensors["right_camera"].edge
    assert found.label_sigma_mm(edge) == pytest.approx(1e3 * predicted["right_camera"][0], rel=0.15)
    assert found.label_sigma_mrad(edge) == pytest.approx(1e3 * predicted["right_camera"][1], rel=0.15)


def test_a_motion_that_does_not_fit(systems: dict[str, System], motions: dict[str, Motion]) -> None:
    with pytest.raises(InputError, match="every pattern of riwbot is fixed"):
        predicted_sigmas(systems["riwbot"], motions["t2rgb"])
