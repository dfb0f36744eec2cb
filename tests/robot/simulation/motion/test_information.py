from dataclasses import replace

import numpy as np
import pytest

from calibration.base.errors import UndeterminedError
from calibration.engine.estimation.solve.design import informations
from calibration.engine.estimation.solve.normal_equations import Weighting, assemble
from calibration.engine.estimation.start.build import build
from calibration.robot.simulation.motion.information import _true_values, expected_noise, information
from calibration.robot.simulation.motion.sequence import Motion
from calibration.robot.simulation.placement import place
from calibration.robot.simulation.sensors import SimulatedDepthCamera, SimulatedLidar
from calibration.robot.simulation.sensors.camera import CORNER_NOISE
from calibration.robot.simulation.system import System
from tests.engine.estimation.scenes import board, looks, true_values
from tests.engine.estimation.systems import STEREO, stereo
from tests.robot.simulation.conftest import SYSTEMS


@pytest.mark.parametrize("name", SYSTEMS)
def test_the_poses_add_up_to_what_the_engine_knows(
    systems: dict[str, System], motions: dict[str, Motion], name: str
) -> None:
    system, motion = systems[name], motions[name]
    placement = place(system, motion)
    found = information(system, placement)
    problem, noise = found.setup.problem, expected_noise(system)
    equations = assemble(problem, _true_values(system, found.setup, placement, found.poses), noise)
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
    values, noise = _true_values(system, found.setup, placement, found.poses), expected_noise(system)
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
