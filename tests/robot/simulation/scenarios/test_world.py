from dataclasses import replace

import numpy as np
import pytest

from calibration.base import InputError
from calibration.engine.geometry.lenses import Equidistant
from calibration.engine.geometry.transforms import apply, from_xyz_rpy, inverse, local
from calibration.robot.simulation.motion_generation import filling_distances
from calibration.robot.simulation.scenarios.scenario import Scenario, build_world, clearance, scenario_motion
from calibration.robot.simulation.sensors import SimulatedCamera, SimulatedLidar
from calibration.robot.simulation.system import System
from calibration.robot.urdf import compose

EDGE = ("camera_left_link", "camera_left_rgb_frame")


def world(system: System, **values: float) -> System:
    """The world of parameters whose names have a dot for the two underscores."""
    return build_world(system, Scenario(1, 0, {name.replace("__", "."): value for name, value in values.items()}))


def test_an_empty_scenario_changes_nothing(systems: dict[str, System]) -> None:
    system = systems["t2rgb"]
    same = world(system)
    assert same.robot is system.robot
    assert (same.sensors, same.motion, same.bows, same.sway) == (system.sensors, system.motion, {}, system.sway)
    assert same.scene.boxes == system.scene.boxes
    light, described = same.scene.light, system.scene.light
    assert (light.ambient, light.intensity, *light.direction) == (
        described.ambient,
        described.intensity,
        *described.direction,
    )


def test_the_robot_is_put_together_with_errors_but_its_design_stays(systems: dict[str, System]) -> None:
    described = systems["t2rgb"]
    turned = [  # so that its child frame is another than its parent frame
        replace(joint, T_parent_joint=from_xyz_rpy((1, 2, 3), (0.5, 1, -2))) if joint.edge == EDGE else joint
        for joint in described.robot.joints
    ]
    robot = replace(described.robot, joints=tuple(turned))
    system = replace(described, robot=robot, nominal=robot)
    bent = world(
        system,
        left_camera__translation_x_mm=1,
        left_camera__translation_z_mm=-3,
        left_camera__rotation_y_deg=2,
    )
    assert bent.nominal is system.nominal
    before, after = system.robot.transforms({}), bent.robot.transforms({})
    twist = local(before[EDGE], after[EDGE])[0]  # in the child frame
    np.testing.assert_allclose(twist, [0.001, 0, -0.003, 0, np.radians(2), 0], atol=1e-15)
    for edge in set(before) - {EDGE}:
        np.testing.assert_array_equal(before[edge], after[edge])


def test_the_light_comes_from_its_elevation_and_azimuth(systems: dict[str, System]) -> None:
    light = world(systems["t2rgb"], light__elevation_deg=30, light__azimuth_deg=90, light__ambient=0.2).scene.light
    np.testing.assert_allclose(light.direction, [0, np.cos(np.pi / 6), 0.5], atol=1e-15)
    assert light.ambient == 0.2
    assert light.intensity == systems["t2rgb"].scene.light.intensity


def test_cameras_have_their_own_optics_and_distortion(systems: dict[str, System]) -> None:
    system = systems["t2rgb"]
    changed = world(
        system,
        left_camera__exposure=1.5,
        left_camera__noise_levels=4,
        left_camera__blur_px=0.9,
        left_camera__vignetting=0.3,
        left_camera__k1=-0.1,
        left_camera__p2=0.01,
    )
    left, right = changed.sensors["left_camera"], changed.sensors["right_camera"]
    assert isinstance(left, SimulatedCamera)
    assert (left.exposure, left.noise, left.blur, left.vignetting) == (1.5, 4, 0.9, 0.3)
    assert (left.camera.distortion.k1, left.camera.distortion.p2, left.camera.distortion.k2) == (-0.1, 0.01, 0)
    assert right == system.sensors["right_camera"]


def test_a_coefficient_that_a_lens_does_not_have(systems: dict[str, System]) -> None:
    system = systems["t2rgb"]
    left = system.cameras["left_camera"]
    fisheye = replace(left, camera=replace(left.camera, distortion=Equidistant(0.1, 0.2)))
    system = replace(system, sensors={**system.sensors, "left_camera": fisheye})
    changed = world(system, left_camera__k2=-0.1).sensors["left_camera"]
    assert isinstance(changed, SimulatedCamera)
    assert changed.camera.distortion == Equidistant(0.1, -0.1)
    with pytest.raises(InputError, match="scenario: 'p1' of 'left_camera': its distortion model equidistant has none"):
        world(system, left_camera__p1=0.01)


def test_lidars_have_their_own_noise(systems: dict[str, System]) -> None:
    lidar = world(systems["rlbot"], lidar_right__noise_m=0.02).sensors["lidar_right"]
    assert isinstance(lidar, SimulatedLidar)
    assert lidar == replace(systems["rlbot"].sensors["lidar_right"], noise=0.02)


def test_patterns_are_bent_and_sway(systems: dict[str, System]) -> None:
    changed = world(systems["t2rgb"], pattern_1__bow_x_mm=2, pattern_1__bow_y_mm=-1, motion__sway_mm=0.5)
    assert changed.bows == {"pattern_1": (0.002, -0.001)}
    assert changed.sway == 0.0005


def test_motions_are_within_the_ranges_of_their_scenario(systems: dict[str, System]) -> None:
    changed = world(
        systems["t2rgb"],
        motion__nearest_m=2,
        motion__farthest_m=1.5,
        motion__tilt_deg=30,
        motion__roll_deg=10,
        motion__partial=0.5,
        motion__poses=5,
    )
    ranges = changed.motion
    assert ranges.distance == (1.5, 2)
    np.testing.assert_allclose(np.degrees([ranges.tilt, ranges.roll]), [30, 10])
    assert ranges.partial == 0.5
    scenario = Scenario(1, 0, {"motion.poses": 5})
    motion = scenario_motion(changed, scenario)
    assert len(motion) == 5
    np.testing.assert_array_equal(scenario_motion(changed, scenario).positions, motion.positions)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["t2rgb", "rlbot", "riwbot"])
def test_occluders_are_between_a_camera_and_the_pattern(systems: dict[str, System], name: str) -> None:
    system = systems[name]
    scenario = Scenario(1, 3, {"occluders.count": 20, "occluders.size_m": 0.1})
    built = build_world(system, scenario)
    boxes = built.scene.boxes[len(system.scene.boxes) :]
    assert len(boxes) == 20
    pattern = next(iter(system.patterns.values()))
    rest = system.robot.transforms({})
    for box in boxes:
        assert box.size.tolist() == [0.1, 0.1, 0.1]
        before = []
        for camera, sensor in system.cameras.items():
            link = system.configuration.sensors[camera].link
            T_world_camera = compose(system.robot.tree, rest, system.configuration.world_link, link)[0]
            point = apply(inverse(T_world_camera), box.T_world_box[None, :3, 3])
            nearest, _ = system.motion.distance or filling_distances(sensor.camera, pattern)
            seen = sensor.camera.contains(sensor.camera.project(point))[0]
            before.append(seen and 0.3 * nearest < np.linalg.norm(point) < 0.8 * nearest)
        assert any(before)
    more = build_world(system, replace(scenario, values={**scenario.values, "occluders.count": 21}))
    for one, other in zip(built.scene.boxes, more.scene.boxes, strict=False):  # one more leaves the others
        np.testing.assert_array_equal(one.T_world_box, other.T_world_box)


def test_occluders_need_a_camera(systems: dict[str, System]) -> None:
    blind = replace(systems["rlbot"], sensors={"lidar_right": systems["rlbot"].sensors["lidar_right"]})
    with pytest.raises(InputError, match="rlbot has no camera"):
        world(blind, occluders__count=1, occluders__size_m=1)


def test_the_clearance_is_the_least_distance_to_a_box(systems: dict[str, System]) -> None:
    system = systems["t2rgb"]
    assert clearance(system) == np.inf
    many = build_world(system, Scenario(1, 0, {"occluders.count": 5, "occluders.size_m": 0.2}))
    rest = system.robot.transforms({})
    cameras = [
        compose(system.robot.tree, rest, "world", system.configuration.sensors[name].link)[0, :3, 3]
        for name in system.sensors
    ]
    grid = np.stack(np.meshgrid(*[np.linspace(-0.1, 0.1, 41)] * 3), -1).reshape(-1, 3)
    points = np.concatenate([apply(box.T_world_box, grid) for box in many.scene.boxes])
    nearest = min(np.linalg.norm(points - camera, axis=-1).min() for camera in cameras)
    assert clearance(many) == pytest.approx(nearest, abs=0.002)
    inside = replace(
        system,
        scene=replace(many.scene, boxes=(replace(many.scene.boxes[0], T_world_box=np.eye(4), size=np.full(3, 9.0)),)),
    )
    assert clearance(inside) == 0


def test_joints_differ_from_their_description(systems: dict[str, System]) -> None:
    """A scenario's parameters override the simulation's; others are unchanged."""
    system = systems["spjbot"]
    assert world(system).robot is system.robot
    values = {"j2_joint.origin_yaw.rotation_deg": -1.0, "j3_joint.origin_z.translation_mm": 4.0}
    bent = build_world(system, Scenario(1, 0, values))
    assert bent.joint_errors == {
        "j2_joint": {"origin_yaw": np.radians(-1.0)},
        "j3_joint": {"origin_z": 0.004},
        "j4_joint": {"origin_yaw": -0.015},
    }
    assert bent.nominal is system.nominal
    T = bent.robot.movable["j3_joint"].T_parent_joint
    np.testing.assert_allclose(T[:3, 3], [0, 0, 0.104], atol=1e-15)
    moved = build_world(system, Scenario(1, 0, {**values, "rgb_hand.translation_x_mm": 1.0}))
    np.testing.assert_array_equal(moved.robot.movable["j3_joint"].T_parent_joint, T)
    mount = ("end_effector_link", "rgb_hand_link")
    shift = local(bent.robot.transforms({})[mount], moved.robot.transforms({})[mount])[0]
    np.testing.assert_allclose(shift, [0.001, 0, 0, 0, 0, 0], atol=1e-15)
