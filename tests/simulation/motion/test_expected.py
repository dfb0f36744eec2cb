import math
from dataclasses import replace

import numpy as np
import pytest

from calibration.dataset.model import CornerLabels, PointLabels
from calibration.geometry.transforms import apply, inverse
from calibration.simulation.board import Board
from calibration.simulation.motion.expected import expected_dataset, points_on
from calibration.simulation.motion.sequence import Motion
from calibration.simulation.placement import place
from calibration.simulation.random_streams import stream
from calibration.simulation.rendering.lidar import scan
from calibration.simulation.scene import Box, Scene
from calibration.simulation.sensors import SimulatedDepthCamera
from calibration.simulation.system import System
from tests.simulation.conftest import SYSTEMS


@pytest.mark.parametrize("name", SYSTEMS)
def test_corners_stand_where_they_are_projected(
    systems: dict[str, System], motions: dict[str, Motion], name: str
) -> None:
    system = systems[name]
    placement = place(system, motions[name])
    dataset = expected_dataset(system, placement)
    assert dataset.keys == tuple(map(str, range(24)))
    assert list(dataset.sensors) == list(system.sensors)
    for i, collection in enumerate(dataset.collections):
        for camera, simulated in system.cameras.items():
            labels = collection.labels["pattern_1", camera]
            assert isinstance(labels, CornerLabels)
            T = dataset.transform(dataset.sensors[camera].frame, dataset.world)[i] @ placement.patterns["pattern_1"][i]
            projected = simulated.camera.project(apply(T, system.patterns["pattern_1"].corners))
            np.testing.assert_allclose(labels.pixels, projected[labels.ids], atol=1e-8)
            assert simulated.camera.contains(labels.pixels).all()


def test_points_are_those_of_a_scan(systems: dict[str, System], motions: dict[str, Motion]) -> None:
    system = systems["rlbot"]
    lidar = replace(system.lidars["lidar_right"], noise=0.0, resolution=0.0)
    pattern = system.patterns["pattern_1"]
    placement = place(system, motions["rlbot"])
    lidar = replace(lidar, least_range=1.5)  # so that the range cuts some patterns
    cut = 0
    for i in range(24):
        T_world_lidar, T_world_pattern = placement.sensors["lidar_right"][i], placement.patterns["pattern_1"][i]
        board = Board(system.configuration.patterns["pattern_1"], pattern, T_world_pattern)
        measured = scan(lidar, T_world_lidar, system.scene, [board], stream(0))
        on_board = measured.board == 0
        expected = (measured.ranges[..., None] * lidar.directions())[on_board]
        labels = points_on(lidar, pattern, inverse(T_world_lidar) @ T_world_pattern, system.scene, T_world_lidar)
        order, other = (np.lexsort(np.round(p, 6).T) for p in (labels.points, expected))
        np.testing.assert_allclose(labels.points[order], expected[other], atol=2e-6)
        cut += int((measured.crossed == 0).sum() > on_board.sum())
        assert len(labels.limits) <= 2 * on_board.any(1).sum()
    assert 3 <= cut <= 20


def test_the_outermost_points_of_each_ring(systems: dict[str, System], motions: dict[str, Motion]) -> None:
    system = replace(systems["rlbot"], scene=Scene())
    dataset = expected_dataset(system, place(system, motions["rlbot"]))
    for collection in dataset.collections:
        labels = collection.labels["pattern_1", "lidar_right"]
        assert isinstance(labels, PointLabels)
        ring = np.round(np.degrees(np.arctan2(labels.points[:, 2], np.hypot(*labels.points[:, :2].T)))).astype(int)
        azimuth = np.arctan2(labels.points[:, 1], labels.points[:, 0])
        ends = [
            each
            for r in np.unique(ring)
            for on in [np.flatnonzero(ring == r)]
            for each in {on[azimuth[on].argmin()], on[azimuth[on].argmax()]}
        ]
        assert sorted(labels.limits.tolist()) == sorted(ends)


def test_a_post_hides_points_and_ends(systems: dict[str, System], motions: dict[str, Motion]) -> None:
    system = replace(systems["rlbot"], scene=Scene())
    lidar, pattern = system.lidars["lidar_right"], system.patterns["pattern_1"]
    placement = place(system, motions["rlbot"])
    T_world_lidar, T_world_pattern = placement.sensors["lidar_right"][0], placement.patterns["pattern_1"][0]
    T = inverse(T_world_lidar) @ T_world_pattern
    edge = apply(T_world_pattern, np.array([[0.0, pattern.centre[1], 0]]))[0]
    at = np.eye(4)
    at[:3, 3] = (T_world_lidar[:3, 3] + edge) / 2
    post = Scene(boxes=(Box(at, np.array([0.15, 0.15, 3.0])),))
    free, hidden = (points_on(lidar, pattern, T, scene, T_world_lidar) for scene in (Scene(), post))
    assert 10 < len(hidden.points) < len(free.points)
    assert 0 < len(hidden.limits) < len(free.limits)
    kept = {tuple(p) for p in np.round(free.points[free.limits], 9)}
    assert {tuple(p) for p in np.round(hidden.points[hidden.limits], 9)} < kept


def test_on_the_seam_of_the_azimuth(systems: dict[str, System]) -> None:
    """A pattern behind the sensor is hit as one before it."""
    lidar, pattern = systems["rlbot"].lidars["lidar_right"], systems["rlbot"].patterns["pattern_1"]
    ahead = np.array([[0, 0, 1, 2.0], [-1, 0, 0, 0.3], [0, -1, 0, 0.2], [0, 0, 0, 1]])
    half = np.diag([-1.0, -1, 1, 1])
    found = [points_on(lidar, pattern, T, Scene(), np.eye(4)) for T in (ahead, half @ ahead)]
    assert abs(len(found[0].points) - len(found[1].points)) <= 2 * 16  # the steps fall otherwise
    assert (found[1].points[:, 0] < -1.9).all()
    assert np.ptp(np.arctan2(found[1].points[:, 1], -found[1].points[:, 0])) == pytest.approx(
        2 * math.atan(0.37 / 2), abs=0.05
    )


def test_depth_cameras_are_left_out(systems: dict[str, System], motions: dict[str, Motion]) -> None:
    system = systems["t2rgb"]
    depth = SimulatedDepthCamera(system.cameras["right_camera"].camera)
    mixed = replace(system, sensors={**system.sensors, "right_camera": depth})
    dataset = expected_dataset(mixed, place(mixed, motions["t2rgb"]))
    assert list(dataset.sensors) == ["left_camera"]
    assert all(list(collection.labels) == [("pattern_1", "left_camera")] for collection in dataset.collections)
