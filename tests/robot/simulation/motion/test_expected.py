import math
from dataclasses import replace

import numpy as np
import pytest

from calibration.engine.dataset.modalities import DEPTH
from calibration.engine.dataset.model import CornerLabels, PointLabels
from calibration.engine.geometry.transforms import apply, inverse
from calibration.robot.labelling.depth import label_depth
from calibration.robot.labelling.points import PatternPoints
from calibration.robot.simulation.board import Board
from calibration.robot.simulation.motion.expected import expected_dataset
from calibration.robot.simulation.motion.sequence import Motion
from calibration.robot.simulation.placement import place
from calibration.robot.simulation.random_streams import stream
from calibration.robot.simulation.scene import Box, Scene
from calibration.robot.simulation.sensors import SimulatedDepthCamera, SimulatedLidar
from calibration.robot.simulation.system import System
from tests.robot.simulation.conftest import SYSTEMS, one_view


def lidar_of(system: System) -> SimulatedLidar:
    lidar = system.sensors["lidar_right"]
    assert isinstance(lidar, SimulatedLidar)
    return lidar


def depth_of(system: System) -> SimulatedDepthCamera:
    sensor = system.sensors["right_camera"]
    assert isinstance(sensor, SimulatedDepthCamera)
    return sensor


@pytest.mark.parametrize("name", SYSTEMS)
def test_expected_corners_equal_their_projections(
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
    lidar = replace(lidar_of(system), noise=0.0, resolution=0.0)
    pattern = system.patterns["pattern_1"]
    placement = place(system, motions["rlbot"])
    lidar = replace(lidar, reach=(1.5, lidar.reach[1]))  # so that the range cuts some patterns
    cut = 0
    for i in range(24):
        T_world_lidar, T_world_pattern = placement.sensors["lidar_right"][i], placement.patterns["pattern_1"][i]
        board = Board(system.configuration.patterns["pattern_1"], pattern, T_world_pattern)
        measured = lidar.scan(T_world_lidar, system.scene, [board], stream(0))
        on_board = measured.board == 0
        expected = (measured.ranges[..., None] * lidar.directions())[on_board]
        labels = lidar.points_on(one_view(system, T_world_lidar, T_world_pattern, system.scene), 0)
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
    lidar, pattern = lidar_of(system), system.patterns["pattern_1"]
    placement = place(system, motions["rlbot"])
    T_world_lidar, T_world_pattern = placement.sensors["lidar_right"][0], placement.patterns["pattern_1"][0]
    edge = apply(T_world_pattern, np.array([[0.0, pattern.centre[1], 0]]))[0]
    at = np.eye(4)
    at[:3, 3] = (T_world_lidar[:3, 3] + edge) / 2
    post = Scene(boxes=(Box(at, np.array([0.15, 0.15, 3.0])),))
    free, hidden = (
        lidar.points_on(one_view(system, T_world_lidar, T_world_pattern, scene), 0) for scene in (Scene(), post)
    )
    assert 10 < len(hidden.points) < len(free.points)
    assert 0 < len(hidden.limits) < len(free.limits)
    kept = {tuple(p) for p in np.round(free.points[free.limits], 9)}
    assert {tuple(p) for p in np.round(hidden.points[hidden.limits], 9)} < kept


def test_on_the_seam_of_the_azimuth(systems: dict[str, System]) -> None:
    """A pattern behind the sensor is hit as one before it."""
    system = systems["rlbot"]
    lidar = lidar_of(system)
    ahead = np.array([[0, 0, 1, 2.0], [-1, 0, 0, 0.3], [0, -1, 0, 0.2], [0, 0, 0, 1]])
    half = np.diag([-1.0, -1, 1, 1])
    found = [lidar.points_on(one_view(system, np.eye(4), T, Scene()), 0) for T in (ahead, half @ ahead)]
    assert abs(len(found[0].points) - len(found[1].points)) <= 2 * 16  # the steps fall otherwise
    assert (found[1].points[:, 0] < -1.9).all()
    assert np.ptp(np.arctan2(found[1].points[:, 1], -found[1].points[:, 0])) == pytest.approx(
        2 * math.atan(0.37 / 2), abs=0.05
    )


def with_depth(system: System, scene: Scene | None = None) -> System:
    """t2rgb, whose right camera measures depths instead, without noise."""
    depth = SimulatedDepthCamera(system.cameras["right_camera"].camera, noise=0.0, noise_growth=0.0)
    return replace(
        system, sensors={**system.sensors, "right_camera": depth}, scene=system.scene if scene is None else scene
    )


def test_points_of_a_depth_camera_are_those_of_its_image(
    systems: dict[str, System], motions: dict[str, Motion]
) -> None:
    system = with_depth(systems["t2rgb"])
    placement = place(system, motions["t2rgb"])
    dataset = expected_dataset(system, placement)
    assert dataset.sensors["right_camera"].modality == DEPTH
    sensor, pattern = depth_of(system), system.patterns["pattern_1"]
    for i, collection in enumerate(dataset.collections[:6]):
        labels = collection.labels["pattern_1", "right_camera"]
        assert isinstance(labels, PointLabels)
        T_world_camera, T_world_pattern = placement.sensors["right_camera"][i], placement.patterns["pattern_1"][i]
        board = Board(system.configuration.patterns["pattern_1"], pattern, T_world_pattern)
        depth = sensor.render(T_world_camera, system.scene, [board], stream(0))
        u, v = np.rint(sensor.camera.project(labels.points)).astype(int).T
        np.testing.assert_allclose(labels.points[:, 2], depth[v, u] * 1e-4, atol=0.6e-4)
        found = label_depth(depth, sensor.camera, pattern, inverse(T_world_camera) @ T_world_pattern)
        assert isinstance(found, PatternPoints)
        assert len(labels.points) == pytest.approx(len(found.on_pattern), rel=0.1)
        border = v[labels.limits] * sensor.camera.width + u[labels.limits]
        assert len(np.setxor1d(border, found.on_border)) < 0.1 * len(border)


def test_a_post_hides_pixels(systems: dict[str, System], motions: dict[str, Motion]) -> None:
    system = with_depth(systems["t2rgb"], Scene())
    placement = place(system, motions["t2rgb"])
    T_world_camera, T_world_pattern = placement.sensors["right_camera"][0], placement.patterns["pattern_1"][0]
    at = np.eye(4)
    at[:3, 3] = (T_world_camera[:3, 3] + apply(T_world_pattern, system.patterns["pattern_1"].centre[None])[0]) / 2
    post = Scene(boxes=(Box(at, np.array([0.1, 0.1, 3.0])),))
    free, hidden = (
        depth_of(system).points_on(one_view(system, T_world_camera, T_world_pattern, scene), 0)
        for scene in (Scene(), post)
    )
    assert 100 < len(hidden.points) < 0.9 * len(free.points)
    assert 0 < len(hidden.limits) < len(free.limits)
    assert {tuple(p) for p in hidden.points} < {tuple(p) for p in free.points}
