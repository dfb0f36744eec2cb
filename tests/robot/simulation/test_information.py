import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from calibration.base import InputError, UndeterminedError
from calibration.engine.dataset.modalities import DEPTH
from calibration.engine.dataset.model import CornerLabels, PointLabels
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.least_squares.normal_equations import Weighting, assemble
from calibration.engine.estimation.least_squares.observability import informations
from calibration.engine.estimation.start.build import build
from calibration.engine.geometry.transforms import apply, distance, inverse
from calibration.robot.labelling.depth import label_depth
from calibration.robot.labelling.points import PatternPoints
from calibration.robot.simulation.kinematics import place, stream
from calibration.robot.simulation.motion import Motion
from calibration.robot.simulation.motion_information import (
    expected_dataset,
    expected_noise,
    information,
    predicted_sigmas,
)
from calibration.robot.simulation.motion_information import (
    true_values as values_of_information,
)
from calibration.robot.simulation.scene import Board, Box, Scene
from calibration.robot.simulation.sensors import SimulatedDepthCamera, SimulatedLidar
from calibration.robot.simulation.sensors.camera import CORNER_NOISE
from calibration.robot.simulation.system import System
from tests.engine.estimation.scenes import board, looks, true_values
from tests.engine.estimation.systems import STEREO, stereo
from tests.robot.simulation.conftest import SYSTEMS, one_view
from tests.robot.simulation.exact_labels import noisy


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


@pytest.mark.parametrize("name", SYSTEMS)
def test_the_poses_add_up_to_what_the_engine_knows(
    systems: dict[str, System], motions: dict[str, Motion], name: str
) -> None:
    system, motion = systems[name], motions[name]
    placement = place(system, motion)
    found = information(system, placement)
    problem, noise = found.setup.problem, expected_noise(system)
    equations = assemble(problem, values_of_information(system, found.setup, placement, found.poses), noise)
    np.testing.assert_allclose(
        found.each.sum(0), equations.schur, rtol=1e-9, atol=1e-12 * np.abs(equations.schur).max()
    )
    assert found.poses.tolist() == list(range(24))
    assert found.calibrated == {"softbot": 12, "spjbot": 9}.get(name, 6)
    assert found.each.shape == (24, *2 * (sum(problem.blocks[i].dimension for i in problem.shared),))
    assert (np.linalg.eigvalsh(found.each) > -1e-9 * np.abs(found.each).max((1, 2))[:, None]).all()
    if len(system.cameras) == len(system.sensors):  # rays do not meet the border exactly
        assert equations.cost.max() < 1e-12


def test_several_transforms_per_collection_are_eliminated() -> None:
    """Two patterns that move on their own: the collections still add up to what the engine knows."""
    scene = stereo(6)
    moving = STEREO["world", "left"] @ looks(6, 9)
    transforms = {**scene.transforms, ("world", "other_link"): moving}
    setup = build(replace(scene, transforms=transforms, patterns=[*scene.patterns, board("other")]).dataset())
    assert len(setup.problem.local) == 2
    values, weighting = true_values(setup), Weighting({"pixel": 0.1}, None)
    each = informations(setup.problem, values, weighting)
    schur = assemble(setup.problem, values, weighting).schur
    np.testing.assert_allclose(each.sum(0), schur, rtol=1e-9, atol=1e-12 * np.abs(schur).max())


def test_half_the_noise_has_four_times_the_information(systems: dict[str, System], motions: dict[str, Motion]) -> None:
    system = systems["riwbot"]
    placement = place(system, motions["riwbot"])
    found = information(system, placement)
    values, noise = values_of_information(system, found.setup, placement, found.poses), expected_noise(system)
    assert noise.scales["pixel"] == CORNER_NOISE
    sharper = replace(noise, scales={**noise.scales, "pixel": CORNER_NOISE / 2})
    np.testing.assert_allclose(informations(found.setup.problem, values, sharper), 4 * found.each, rtol=1e-9)


def test_the_information_of_a_pose_does_not_depend_on_the_motion(
    systems: dict[str, System], motions: dict[str, Motion]
) -> None:
    for name, system in systems.items():
        whole = information(system, place(system, motions[name]))
        some = information(system, place(system, motions[name].take([20, 3, 7])))
        np.testing.assert_allclose(some.each, whole.each[[20, 3, 7]], rtol=1e-9, atol=1e-9 * np.abs(whole.each).max())


def test_noise_of_a_depth_camera_at_the_middle_of_the_distances(systems: dict[str, System]) -> None:
    system = systems["t2rgb"]
    depth = SimulatedDepthCamera(system.cameras["right_camera"].camera, noise=0.001, noise_growth=0.002)
    scales = expected_noise(replace(system, sensors={**system.sensors, "right_camera": depth})).scales
    assert system.motion.distance == (1.2, 3.0)
    assert scales["range"] == pytest.approx(0.001 + 0.002 * 2.1**2)
    assert scales["depth_border"] == pytest.approx(1 / depth.camera.fx / 12**0.5)


def test_noise_of_the_sensors(systems: dict[str, System]) -> None:
    lidar = systems["rlbot"].sensors["lidar_right"]
    assert isinstance(lidar, SimulatedLidar)
    scales = expected_noise(systems["rlbot"]).scales
    assert scales["range"] == pytest.approx(np.hypot(lidar.noise, lidar.resolution / 12**0.5))
    assert scales["border"] == pytest.approx(lidar.step / 12**0.5)
    exact = replace(lidar, noise=0.0, resolution=0.0)
    system = replace(systems["rlbot"], sensors={**systems["rlbot"].sensors, "lidar_right": exact})
    assert expected_noise(system).scales["range"] > 0


def test_nothing_to_calibrate(systems: dict[str, System], motions: dict[str, Motion]) -> None:
    system = systems["t2rgb"]
    config = system.configuration
    alone = replace(
        system,
        sensors={"left_camera": system.sensors["left_camera"]},
        configuration=replace(config, sensors={"left_camera": config.sensors["left_camera"]}),
    )
    with pytest.raises(UndeterminedError, match="t2rgb: nothing to calibrate"):
        information(alone, place(alone, motions["t2rgb"]))


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
