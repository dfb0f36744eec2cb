"""Poses that can be had next: where the sensors see them, within the joints' limits; in words and as a motion."""

import csv
import io
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from calibration.engine.dataset.model import CornerLabels, PointLabels
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.geometry.transforms import distance
from calibration.robot.next_pose.candidates import PoseCandidates, candidates_of
from calibration.robot.next_pose.expected_labels import expected_labels
from calibration.robot.next_pose.plan import instruction, motion_of, patterns_in_view, poses_csv
from calibration.robot.simulation.kinematics import place
from calibration.robot.simulation.motion_information import expected_dataset
from calibration.robot.simulation.system import read_system

DATASETS = Path(__file__).resolve().parents[3] / "datasets"
COUNT = 20


@cache
def calibrated(system: str) -> Calibration:
    """A system calibrated by its first collections."""
    return calibrate(read_dataset(DATASETS / system).with_collections(range(10)))


@cache
def found(system: str) -> PoseCandidates:
    """Its candidates, with its own description."""
    return candidates_of(calibrated(system), read_system(DATASETS / system).nominal, count=COUNT)


@pytest.mark.parametrize("system", ["t2rgb", "rlbot"])
def test_expected_labels_are_those_that_were_recorded(system: str) -> None:
    """Where the pattern was: the same corners to the noise of their detection, as many points of a LiDAR."""
    dataset = calibrated(system).solution.dataset
    (pattern,) = dataset.patterns.values()
    for sensor in dataset.sensors.values():
        expected, compared = expected_labels(dataset, dataset, sensor, pattern), 0
        for i, label in dataset.detections(pattern.name, sensor.name):
            if (own := expected.get(i)) is None:
                continue
            compared += 1
            if isinstance(label, CornerLabels) and isinstance(own, CornerLabels):
                _, a, b = np.intersect1d(label.ids, own.ids, return_indices=True)
                assert len(a) > 0.5 * len(own.ids)
                assert np.abs(label.pixels[a] - own.pixels[b]).max() < 1.0
            elif isinstance(label, PointLabels) and isinstance(own, PointLabels):
                assert len(own.points) == pytest.approx(len(label.points), rel=0.1)
                assert len(own.limits) == len(label.limits)
        assert compared > 1


@pytest.mark.parametrize("system", ["t2rgb", "riwbot", "spjbot"])
def test_a_simulated_robot_takes_the_poses_and_sees_what_is_expected(system: str) -> None:
    """The motion brings the pattern where the candidate has it, within the joints' limits, and sensors detect it."""
    described, candidates = read_system(DATASETS / system), found(system)
    assert len(candidates) == COUNT
    motion = motion_of(candidates, range(COUNT), described.T_model_pattern)
    assert motion is not None
    placement = place(described, motion)
    seen = expected_dataset(described, placement)
    dataset = candidates.dataset
    (pattern,) = dataset.patterns.values()
    for sensor in dataset.sensors.values():
        there = placement.pattern_in(sensor.name, pattern.name)
        assert np.max(distance(there, dataset.transform(sensor.frame, pattern.link))) < 0.03  # the mount is calibrated
    labels = [key for each in dataset.collections for key in each.labels]
    detected = [
        key for a, b in zip(dataset.collections, seen.collections, strict=True) for key in a.labels if key in b.labels
    ]
    assert len(detected) > 0.95 * len(labels)


def test_joints_without_a_description_stay_near_where_they_were() -> None:
    candidates = candidates_of(calibrated("spjbot"), None, count=5)
    assert candidates.without_limits == candidates.moved
    assert candidates.joints == {}
    assert motion_of(candidates, [0]) is None
    (row,) = csv.DictReader(io.StringIO(poses_csv(candidates, [0])))
    assert len(row) == 1 + 7 * len(candidates.moved)


def test_nothing_moves_where_all_collections_are_alike() -> None:
    calibration = calibrated("riwbot")
    still = calibration.solution.dataset.with_collections([0] * 10)
    stood = replace(calibration, solution=replace(calibration.solution, dataset=still))
    assert len(candidates_of(stood)) == 0


def test_a_pose_in_words() -> None:
    """They say the distance, the place in the image and the tilt, as a person understands them."""
    candidates = found("t2rgb")
    for pose in range(3):
        text = instruction(candidates, pose)
        first = min(patterns_in_view(candidates.dataset, pose), key=lambda each: each.distance)
        assert f"{first.distance:.2g} m before {first.camera}" in text
        u, v = first.outline.mean(0)
        camera = candidates.dataset.sensors[first.camera].camera
        assert camera is not None
        assert ("left" in first.place) == (u < camera.width / 3) or abs(u - camera.width / 3) < 60
        assert ("top" in first.place) == (v < camera.height / 3) or abs(v - camera.height / 3) < 60
