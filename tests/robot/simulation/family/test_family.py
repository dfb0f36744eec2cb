"""ATOM's systems: each is moved, seen and calibrated from every noisy start."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.base import UndeterminedError
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.engine.evaluation.truth import find_truth, truth_error, truth_of
from calibration.engine.geometry.transforms import distance
from calibration.pipeline.collection.collecting import collect_dataset
from calibration.pipeline.collection.request import CollectionRequest
from calibration.robot.simulation.kinematics import place
from calibration.robot.simulation.motion_generation import generate_motion
from calibration.robot.simulation.motion_information import expected_dataset
from tests.robot.simulation.exact_labels import as_designed, exact_labels, noisy
from tests.robot.simulation.family.describing import Robot
from tests.robot.simulation.family.robots import FAMILY, mrbot, mrjbot, rihbot, rihmpbot

NOISES = ((0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (0.5, 0.5))


@pytest.mark.thorough(but_first=2)
@pytest.mark.parametrize("robot", FAMILY, ids=lambda robot: robot.name)
def test_from_every_start_to_the_truth(robot: Robot, tmp_path: Path) -> None:
    system = robot.system(tmp_path)
    exact = exact_labels(system)
    assert {pattern for c in exact.collections for pattern, _ in c.labels} == set(system.patterns)
    truth, start = truth_of(exact), as_designed(exact, system)
    for noise in NOISES:
        found = calibrate(start, None, StartingNoise(*noise))
        assert found.converged
        error = truth_error(found.dataset, truth)
        assert error.translation_mm < 1e-3
        assert error.rotation_deg < np.degrees(1e-6)
        assert len(error.joints) == len(robot.joints)
        assert all(each.error < 1e-6 for each in error.joints)


@pytest.mark.thorough(but_first=2)
@pytest.mark.parametrize("robot", FAMILY, ids=lambda robot: robot.name)
def test_noise_in_the_labels_leaves_what_is_stated(robot: Robot, tmp_path: Path) -> None:
    system = robot.system(tmp_path)
    exact = exact_labels(system)
    found = calibrate(noisy(as_designed(exact, system), system, seed=3))
    assert found.converged
    for edge in (sensor.edge for sensor in exact.sensors.values() if sensor.edge in found.covariances):
        translation, angle = distance(exact.transforms[edge][0], found.transforms[edge])
        assert 0 < 1e3 * translation < 4 * found.label_sigma_mm(edge)
        assert 0 < 1e3 * angle < 4 * found.label_sigma_mrad(edge)
    sigmas = [sigma for joint in found.joints.values() for sigma in joint.label_sigmas]
    errors = [each.error for each in truth_error(found.dataset, truth_of(exact)).joints]
    assert all(0 < error < 4 * sigma < 1e-3 for error, sigma in zip(errors, sigmas, strict=True))


def test_no_camera_of_a_ring_sees_every_collection(tmp_path: Path) -> None:
    dataset = exact_labels(mrbot.system(tmp_path))
    seen = [len(dataset.detections("p", sensor)) for sensor in dataset.sensors]
    assert 4 < min(seen) <= max(seen) < len(dataset.collections) / 2


def test_joints_at_both_ends_of_an_arm_are_refused_by_name(tmp_path: Path) -> None:
    """The first is degenerate with the pattern's pose, the last with the camera's."""
    system = replace(mrjbot, frames=rihbot.frames, anchored="").system(tmp_path)
    exact = expected_dataset(system, place(system, generate_motion(rihbot.system(tmp_path), 20, seed=1)))
    with pytest.raises(UndeterminedError) as error:
        calibrate(exact)
    for name in ("'joint-to_shoulder' (position_bias)", "'joint-to_flange' (position_bias)", "'p'"):
        assert name in str(error.value)


@pytest.mark.thorough
def test_several_patterns_through_images(tmp_path: Path) -> None:
    """A detector that knows one pattern does not mistake another for it; what is collected calibrates."""
    rihmpbot.system(tmp_path)
    results = collect_dataset(CollectionRequest(tmp_path, motion="generate:9", seed=3), tmp_path / "output")
    assert results.reasons == []
    assert results.proof is not None
    assert results.proof.translation_mm is not None
    assert results.proof.translation_mm < 0.5
    assert results.corner_rms is not None
    assert results.corner_rms < 0.2
    dataset = read_dataset(tmp_path / "output")
    assert {pattern for c in dataset.collections for pattern, _ in c.labels} == {"p", "q", "r"}
    truth = find_truth(dataset)
    assert truth is not None
    edges = {edge for poses in truth.patterns.values() for edge in poses}
    assert edges == {("world", f"{name}_link") for name in dataset.patterns}
