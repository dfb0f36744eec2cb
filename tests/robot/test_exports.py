"""Transforms and cameras in others' files: read back by their own readers, equal."""

import ast
from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml
from defusedxml.ElementTree import fromstring

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.geometry.lenses import Rational
from calibration.engine.geometry.rotations import from_quaternion, from_rpy
from calibration.engine.geometry.transforms import from_xyz_rpy, inverse, transform
from calibration.robot.exports import FILES, FORMATS, Calibrated, calibrated, file_name
from tests.pipeline.conftest import DATASETS
from tests.robot.test_calibrated_urdf import moved, pose


@pytest.fixture(scope="module")
def of() -> Calibrated:
    return calibrated(moved(read_dataset(DATASETS / "softbot")))


def text(of: Calibrated, name: str) -> str:
    [found] = FILES[name](of).values()
    return found


def equal(of: Calibrated, found: dict[tuple[str, str], Array]) -> None:
    assert found.keys() == of.transforms.keys()
    for edge, T in of.transforms.items():
        np.testing.assert_allclose(found[edge], T, atol=1e-12)


def from_arguments(arguments: list[str]) -> tuple[tuple[str, str], Array]:
    """Of ROS 2's static_transform_publisher."""
    given = dict(zip(arguments[::2], arguments[1::2], strict=True))
    quat, xyz = ([float(given[f"--{k}"]) for k in keys] for keys in (("qx", "qy", "qz", "qw"), ("x", "y", "z")))
    return (given["--frame-id"], given["--child-frame-id"]), transform(from_quaternion(quat), xyz)


def test_launch_files_of_ros_2(of: Calibrated) -> None:
    nodes = fromstring(text(of, "ros2-xml")).iter("node")
    equal(of, dict(from_arguments(node.attrib["args"].split()) for node in nodes))
    [lists] = [node for node in ast.walk(ast.parse(text(of, "ros2"))) if isinstance(node, ast.Assign)][:1]
    equal(of, dict(map(from_arguments, ast.literal_eval(lists.value))))


def test_the_launch_file_of_ros_1(of: Calibrated) -> None:
    found = {}
    for node in fromstring(text(of, "ros1")).iter("node"):
        *numbers, parent, child = node.attrib["args"].split()
        x = [float(each) for each in numbers]
        found[parent, child] = transform(from_quaternion(x[3:]), x[:3])
    equal(of, found)


def test_every_format_has_its_files() -> None:
    assert tuple(FILES) == FORMATS


def test_messages_of_tf_static(of: Calibrated) -> None:
    found = {}
    for each in yaml.safe_load(text(of, "tf-static"))["transforms"]:
        xyz, quat = (list(each["transform"][k].values()) for k in ("translation", "rotation"))
        found[each["header"]["frame_id"], each["child_frame_id"]] = transform(from_quaternion(quat), xyz)
    equal(of, found)


def test_autoware_has_what_hangs_on_the_base_apart(of: Calibrated) -> None:
    edges = list(of.transforms)
    other = replace(of, transforms={**of.transforms, ("base_link", "kit"): of.transforms[edges[0]]})
    files = {name: yaml.safe_load(text) for name, text in FILES["autoware"](other).items()}
    assert list(files["sensors_calibration.yaml"]) == ["base_link"]
    for parent, child in edges:
        found = files["sensor_kit_calibration.yaml"][parent][child]
        T = from_xyz_rpy([found[axis] for axis in "xyz"], [found[axis] for axis in ("roll", "pitch", "yaw")])
        assert of.transforms[parent, child] == pytest.approx(T, abs=1e-12)


def test_properties_for_xacro(of: Calibrated) -> None:
    found = yaml.safe_load(text(of, "xacro"))
    for (parent, child), T in of.transforms.items():
        xyz, rpy = ([float(v) for v in found[f"{parent}_to_{child}"][k].split()] for k in ("xyz", "rpy"))
        np.testing.assert_allclose(transform(from_rpy(rpy), xyz), T, atol=1e-12)


def test_a_camera_info_projects_as_the_camera_does(of: Calibrated) -> None:
    points = np.random.default_rng(1).normal(0, 0.3, (20, 3)) + np.array([0.0, 0.0, 2.0])
    of = replace(of, cameras={name: replace(camera, skew=-0.6) for name, camera in of.cameras.items()})
    for name, content in FILES["camera-info"](of).items():
        document = yaml.safe_load(content)
        camera = of.cameras[document["camera_name"]]
        assert name == f"camera_info_{document['camera_name']}.yaml"
        K = np.array(document["camera_matrix"]["data"]).reshape(3, 3)
        D = np.array(document["distortion_coefficients"]["data"])
        seen, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.eye(3), D)
        pixels = cv2.convertPointsToHomogeneous(seen[:, 0])[:, 0] @ K.T  # OpenCV leaves the skew of K out
        np.testing.assert_allclose(pixels[:, :2], camera.project(points), atol=1e-9)


def test_opencv_reads_its_storage(of: Calibrated) -> None:
    storage = cv2.FileStorage(text(of, "opencv"), cv2.FileStorage_READ | cv2.FileStorage_MEMORY)
    first, second = of.cameras
    np.testing.assert_array_equal(storage.getNode("K_1").mat(), of.cameras[second].K)
    X = np.array([0.1, -0.2, 3.0])
    there = storage.getNode("R_0_1").mat() @ X + storage.getNode("T_0_1").mat().ravel()
    T = inverse(of.poses[second]) @ of.poses[first]
    np.testing.assert_allclose(there, (T @ [*X, 1.0])[:3], atol=1e-12)


def test_kalibr_has_each_camera_from_the_one_before(of: Calibrated) -> None:
    chain = yaml.safe_load(text(of, "kalibr"))
    first, second = of.poses.values()
    np.testing.assert_allclose(chain["cam1"]["T_cn_cnm1"], inverse(second) @ first, atol=1e-12)
    assert chain["cam0"]["distortion_model"] == "radtan"
    assert len(chain["cam0"]["distortion_coeffs"]) == 4
    name, camera = next(iter(of.cameras.items()))
    rational = replace(of, cameras={name: replace(camera, distortion=Rational(0.1, 0, 0, 0, 0.01))})
    with pytest.raises(InputError, match=f"camera '{name}': Kalibr's radtan has k1, k2, p1, p2"):
        FILES["kalibr"](rational)
    with pytest.raises(InputError, match=f"camera '{name}': found a skew of -0.6 px, Kalibr has none"):
        FILES["kalibr"](replace(of, cameras={name: replace(camera, skew=-0.6)}))


@pytest.mark.parametrize("hostile", ['"/><evil/>', "a\nb", "a'b", "{{x}}", "a: [b", "${x}", "$(eval 1)", "../../up"])
def test_names_of_frames_stay_names(hostile: str) -> None:
    of = Calibrated(hostile, {(hostile, "child"): pose(1.0, 2.0, 3.0)}, {}, {}, {}, {})
    for name in ("ros1", "ros2-xml"):
        if hostile == "../../up":
            assert [node.tag for node in fromstring(text(of, name))] == ["node"]
        else:
            with pytest.raises(InputError, match="in a frame of a launch file"):
                text(of, name)
    lists = next(node for node in ast.walk(ast.parse(text(of, "ros2"))) if isinstance(node, ast.Assign))
    assert hostile in ast.literal_eval(lists.value)[0]
    assert yaml.safe_load(text(of, "tf-static"))["transforms"][0]["header"]["frame_id"] == hostile
    assert "/" not in file_name(hostile)
