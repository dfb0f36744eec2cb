import re
from pathlib import Path

import numpy as np
import pytest

from calibration.base import InputError
from calibration.robot.simulation.sensors import SimulatedCamera, SimulatedDepthCamera, SimulatedLidar
from calibration.robot.simulation.system import System, read_system
from tests.robot.simulation.conftest import DATASETS


def test_the_systems_that_ship_have_the_sensors_of_the_paper(systems: dict[str, System]) -> None:
    t2rgb, rlbot, riwbot = (systems[name] for name in ("t2rgb", "rlbot", "riwbot"))
    assert list(t2rgb.cameras) == ["left_camera", "right_camera"]
    camera = t2rgb.cameras["left_camera"].camera
    assert (camera.width, camera.height, camera.cx, camera.cy) == (640, 480, 320.5, 240.5)
    assert camera.fx == camera.fy == pytest.approx(554.256, abs=1e-3)
    assert rlbot.cameras["rgb_left"].camera.fx == pytest.approx(1039.23, abs=1e-2)
    lidar = rlbot.sensors["lidar_right"]
    assert isinstance(lidar, SimulatedLidar)
    assert (len(lidar.elevations), lidar.azimuths, lidar.noise, lidar.resolution) == (16, 1875, 0.008, 0.001)
    np.testing.assert_allclose(np.degrees(lidar.elevations), np.arange(-15, 16, 2), atol=1e-12)
    assert rlbot.configuration.anchored_sensor == "rgb_left"
    assert riwbot.moved_pattern is None
    assert t2rgb.moved_pattern is t2rgb.patterns["pattern_1"]
    width, height = t2rgb.patterns["pattern_1"].outline[2] - t2rgb.patterns["pattern_1"].outline[0]
    assert (width, height) == (pytest.approx(0.8), pytest.approx(0.6))


def test_another_robot_and_configuration(system_copy: Path, tmp_path: Path) -> None:
    robot = tmp_path / "other.urdf"
    robot.write_text((system_copy / "robot.urdf").read_text().replace("1.65", "2.5"))
    system = read_system(system_copy, robot=robot)
    assert system.robot.transforms({})["tripod", "tripod_plate"][0, 2, 3] == 2.5
    assert system.sources["robot.urdf"] == robot.read_bytes()
    assert system.name == "mine"


def test_a_description_may_give_k_and_elevations_and_leave_the_rest(system_copy: Path) -> None:
    (system_copy / "simulation.yml").write_text("""
sensors:
  rgb_left: {width: 8, height: 6, K: [5, 0, 3.5, 0, 6, 2.5, 0, 0, 1], distortion: [-0.1, 0, 0, 0, 0]}
  lidar_right: {elevations_deg: [-1, 0, 3], azimuths: 100}
""")
    system = read_system(system_copy)
    camera, lidar = system.sensors["rgb_left"], system.sensors["lidar_right"]
    assert isinstance(camera, SimulatedCamera)
    assert isinstance(lidar, SimulatedLidar)
    assert (camera.camera.fy, camera.camera.cx, camera.camera.distortion.k1, camera.noise) == (6, 3.5, -0.1, 2)
    np.testing.assert_allclose(np.degrees(lidar.elevations), [-1, 0, 3])
    assert system.scene.ground is None
    np.testing.assert_array_equal(system.T_model_pattern, np.eye(4))


def test_patterns_may_be_bent_and_sway(system_copy: Path) -> None:
    path = system_copy / "simulation.yml"
    text = path.read_text().replace("tilt_deg: 50", "tilt_deg: 50\n  sway_mm: 1.5")
    path.write_text(text + "patterns: {pattern_1: {bow_mm: [2, -1], legacy_layout: true}}\n")
    system = read_system(system_copy)
    (board,) = system.boards({"pattern_1": np.eye(4)})
    assert board.bow == (0.002, -0.001)
    assert board.legacy_layout
    assert system.sway == 0.0015
    (flat,) = read_system(DATASETS / "rlbot").boards({"pattern_1": np.eye(4)})
    assert flat.bow == (0, 0)
    assert not flat.legacy_layout


def test_a_depth_camera(system_copy: Path) -> None:
    for name, old, new in (
        ("config.yml", "modality: lidar3d", "modality: depth"),
        (
            "simulation.yml",
            "    rings: 16\n    vertical_deg: [-15, 15]\n    azimuths: 1875\n",
            "    width: 64\n    height: 48\n    hfov_deg: 60\n",
        ),
        ("simulation.yml", "    resolution_m: 0.001\n    margin_deg: 5\n", ""),
    ):
        path = system_copy / name
        assert old in path.read_text()
        path.write_text(path.read_text().replace(old, new))
    system = read_system(system_copy)
    depth = system.sensors["lidar_right"]
    assert isinstance(depth, SimulatedDepthCamera)
    assert depth.noise == 0.008


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("simulation.yml", "sensors:", "sensors: [", "simulation.yml:5: this is not valid YAML: "),
        (
            "simulation.yml",
            "scene:",
            "szene:",
            "unknown key 'szene': did you mean 'scene'? (known: sensors, patterns, joints, scene, motion, ",
        ),
        ("simulation.yml", "rgb_left:", "rgb:", "sensors: unknown key 'rgb' (known: lidar_right, rgb_left)"),
        ("simulation.yml", "  rgb_left: {", "  # {", "sensors: missing key 'rgb_left'"),
        (
            "simulation.yml",
            "width: 1200",
            "with: 1200",
            "sensors.rgb_left: unknown key 'with': did you mean 'width'? (known: width",
        ),
        (
            "simulation.yml",
            "width: 1200",
            "width: 0.5",
            "sensors.rgb_left.width: found 0.5, expected a whole number from 2",
        ),
        ("simulation.yml", "hfov_deg: 60", "hfov_deg: .nan", "sensors.rgb_left.hfov_deg: found nan, expected a number"),
        (
            "simulation.yml",
            "hfov_deg: 60",
            "hfov_deg: 200",
            "sensors.rgb_left.hfov_deg: found 200, expected a number from 1 to 170",
        ),
        (
            "simulation.yml",
            "hfov_deg: 60",
            "hfov_deg: 60, K: [1, 0, 1, 0, 1, 1, 0, 0, 1]",
            "sensors.rgb_left: K and hfov_deg exclude each other",
        ),
        (
            "simulation.yml",
            "hfov_deg: 60",
            "K: [1, 0, 1, 0, 0, 1, 0, 0, 1]",
            "sensors.rgb_left.K: found a list of 9, expected [fx, 0, cx, 0, fy, cy, 0, 0, 1] with fx and fy above 0",
        ),
        ("simulation.yml", "noise_m: 0.008", "noise_m: -1", "sensors.lidar_right.noise_m: found -1, expected a number"),
        (
            "simulation.yml",
            "[-15, 15]",
            "[15, -15]",
            "sensors.lidar_right.vertical_deg: found [15, -15], expected two rising numbers from -90 to 90",
        ),
        (
            "simulation.yml",
            "rings: 16",
            "rings: 1e9",
            "lidar_right.rings: found '1e9', expected a whole number",
        ),
        (
            "simulation.yml",
            "rings: 16",
            "elevations_deg: [1, 2]",
            "sensors.lidar_right: elevations_deg and vertical_deg exclude each other",
        ),
        (
            "simulation.yml",
            "rings: 16\n    vertical_deg: [-15, 15]",
            "elevations_deg: [1, 100]",
            "sensors.lidar_right.elevations_deg: found [1, 100], expected 1 to 1000 angles from -90 to 90",
        ),
        (
            "simulation.yml",
            "size: [0.2, 9.0, 3.0]",
            "size: [0.2, 0, 3.0]",
            "scene.boxes.0.size: found [0.2, 0, 3.0], expected three lengths above 0",
        ),
        (
            "simulation.yml",
            "range_m: [0.9, 130]",
            "range_m: [-1, 130]",
            "sensors.lidar_right.range_m: found [-1, 130], expected two rising numbers of at least 0",
        ),
        ("simulation.yml", "distance_m: [1.2, 3.0]", "distance_m: [1.2]", "motion.distance_m: found a list of 1"),
        ("simulation.yml", "tilt_deg: 50", "partial: 2", "motion.partial: found 2, expected a number from 0 to 1"),
        ("config.yml", "modality: lidar3d", "modality: radar", "sensors/lidar_right/modality: found 'radar', expected"),
        (
            "simulation.yml",
            "scene:",
            "patterns: {p: {}}\nscene:",
            "patterns: unknown key 'p' (known: pattern",
        ),
        (
            "simulation.yml",
            "scene:",
            "patterns: {pattern_1: {bow: 1}}\nscene:",
            "patterns.pattern_1: unknown key 'bow': did you mean 'bow_mm'? (known: bow_mm, legacy_layout)",
        ),
        (
            "simulation.yml",
            "scene:",
            "patterns: {pattern_1: {bow_mm: [0, 101]}}\nscene:",
            "patterns.pattern_1.bow_mm: found [0, 101], expected two numbers from -100 to 100",
        ),
        (
            "simulation.yml",
            "scene:",
            "patterns: {pattern_1: {legacy_layout: 1}}\nscene:",
            "patterns.pattern_1.legacy_layout: found 1, expected true or false",
        ),
        ("simulation.yml", "tilt_deg: 50", "sway_mm: -1", "motion.sway_mm: found -1, expected a number from 0 to 1000"),
        (
            "config.yml",
            "    link: rgb_left_optical_frame",
            "    link: eye",
            "sensors/rgb_left/link: frame 'eye' is not in",
        ),
        (
            "config.yml",
            "child_link: rgb_left_link",
            "child_link: tripod",
            "sensors/rgb_left: no joint from 'tripod_left_support' to 'tripod' lies between 'world' and 'rgb_left_opt",
        ),
        ("config.yml", "world_link: world", "world_link: map", "world_link: frame 'map' is not in"),
        (
            "config.yml",
            "additional_tfs:",
            "additional_tfs: {a: {parent_link: x, child_link: y}}",
            "additional_tfs/a: no",
        ),
        ("config.yml", "joints:", "joints: {a: {params_to_calibrate: [origin_x]}}", "joints/a: "),
        (
            "config.yml",
            "fixed: false",
            "fixed: true",
            "calibration_patterns/pattern_1/link: frame 'pattern_link' is not",
        ),
        (
            "config.yml",
            "link: pattern_link",
            "link: tripod",
            "calibration_patterns/pattern_1/fixed: found false, but",
        ),
        (
            "config.yml",
            "link: pattern_link\n    parent_link: world\n    fixed: false",
            "link: lidar_right\n    parent_link: world\n    fixed: true",
            "calibration_patterns/pattern_1: no joint from 'world' to 'lidar_right' in",
        ),
    ],
)
def test_errors_are_one_line(system_copy: Path, file: str, old: str, new: str, message: str) -> None:
    text = (system_copy / file).read_text()
    assert old in text
    (system_copy / file).write_text(text.replace(old, new))
    with pytest.raises(InputError) as error:
        read_system(system_copy)
    assert f"/{file}:" in str(error.value)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_a_sensor_whose_name_would_leave_the_folder(system_copy: Path) -> None:
    for file in ("config.yml", "simulation.yml"):
        path = system_copy / file
        path.write_text(path.read_text().replace("lidar_right:", "'../../lidar':"))
    with pytest.raises(
        InputError, match=r"a sensor's name is part of file names: expected letters, digits and _ \. - only"
    ):
        read_system(system_copy)


def test_two_patterns_that_move(system_copy: Path) -> None:
    path = system_copy / "config.yml"
    head, tail = path.read_text().split("  pattern_1:\n")
    body = tail.split("anchored_sensor")[0]
    path.write_text(f"{head}  pattern_2:\n{body.replace('link: pattern_link', 'link: other')}  pattern_1:\n{tail}")
    with pytest.raises(InputError, match="pattern_2 and pattern_1 all move; a motion sequence moves one pattern"):
        read_system(system_copy)


def test_a_scan_of_too_many_rays(system_copy: Path) -> None:
    path = system_copy / "simulation.yml"
    path.write_text(path.read_text().replace("rings: 16", "rings: 1000").replace("1875", "50000"))
    with pytest.raises(InputError, match="azimuths: found 1000 rings of 50000, expected 4000000 rays at most"):
        read_system(system_copy)


@pytest.mark.parametrize("name", ["robot.urdf", "config.yml", "simulation.yml"])
def test_a_missing_file(system_copy: Path, name: str) -> None:
    (system_copy / name).unlink()
    with pytest.raises(InputError, match=rf"{name}: .* cannot be read: No such file or directory"):
        read_system(system_copy)


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_a_joint_without_a_pose_may_stand_anywhere_but_before_a_sensor(system_copy: Path, kind: str) -> None:
    robot = system_copy / "robot.urdf"
    urdf = robot.read_text()
    box = f'<link name="box"/><joint name="toss" type="{kind}"><parent link="world"/><child link="box"/></joint>'
    robot.write_text(urdf.replace("</robot>", f"{box}</robot>"))
    assert "toss" not in read_system(system_copy).robot.movable
    name = next(joint.name for joint in read_system(system_copy).robot.joints if joint.child == "tripod")
    robot.write_text(re.sub(rf'name="{name}" type="fixed"', f'name="{name}" type="{kind}"', urdf))
    with pytest.raises(InputError, match=f"joint '{name}', which is {kind}, lies between 'world' and"):
        read_system(system_copy)
