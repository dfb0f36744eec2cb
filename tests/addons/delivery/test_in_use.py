"""What is in use is what was verified, to a tenth of a micrometre; each difference names its frame."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from calibration.addons.delivery.checking import ComparedWithUse, Tolerance, compare_with_use
from calibration.addons.delivery.in_use import (
    InUse,
    UsedTransform,
    distance_of_poses,
    pose_of,
    pose_of_angles,
    read_in_use,
)
from calibration.addons.delivery.manifest import BundledTransform
from calibration.base import InputError
from calibration.engine.geometry.rotations import from_rpy, to_quaternion, to_rpy
from calibration.robot.exports import FILES, Calibrated
from tests.robot.importing.bags import BEGIN, SECOND, BagFile, Kind

from .bundles import LEFT, RIGHT, SYSTEM, URDF, camera, camera_info, messages, write_yaml

CAMERAS = {each.name: each for each in SYSTEM.cameras}


def rotation(quat: tuple[float, ...]) -> np.ndarray:
    x, y, z, w = quat
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + 2 * w * K + 2 * K @ K)


def matrix(of: BundledTransform) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation(of.quat), of.trans
    return T


def urdf(path: Path, *changes: tuple[str, str]) -> Path:
    text = URDF.format(rpy=" ".join(map(repr, to_rpy(rotation(LEFT.quat)).tolist())))
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)
    return path


def compared(*sources: InUse) -> ComparedWithUse:
    return compare_with_use([SYSTEM], sources, Tolerance())


def found(*sources: InUse) -> dict[str, str]:
    return {each.of: each.text for each in compared(*sources).differences}


def test_angles_of_a_urdf_are_those_of_the_engine() -> None:
    for rpy in ((0.1, -0.2, 0.3), (3.0, 1.5, -2.0)):
        wanted = pose_of([0, 0, 0, *to_quaternion(from_rpy(np.array(rpy)))])
        assert distance_of_poses(pose_of_angles((0, 0, 0), rpy), wanted) == pytest.approx((0, 0), abs=1e-12)


def test_a_product_of_poses_is_that_of_matrices() -> None:
    pose = pose_of([*LEFT.trans, *LEFT.quat]) @ pose_of([*RIGHT.trans, *RIGHT.quat])
    T = matrix(LEFT) @ matrix(RIGHT)
    twice = pose_of([*LEFT.trans, *(2 * value for value in LEFT.quat)]) @ pose_of([*RIGHT.trans, *RIGHT.quat])
    assert pose.trans == pytest.approx(T[:3, 3])
    assert twice.trans == pytest.approx(T[:3, 3])
    assert rotation(pose.quat) == pytest.approx(T[:3, :3])


def test_all_that_is_in_use_is_what_was_verified(tmp_path: Path) -> None:
    path = write_yaml(tmp_path / "live.yaml", messages(LEFT), messages(RIGHT), *map(camera_info, CAMERAS.values()))
    result = compared(read_in_use(urdf(tmp_path / "robot.urdf")), read_in_use(path))
    assert result == ComparedWithUse(5, (), ())


def test_a_chain_may_go_over_several_files(tmp_path: Path) -> None:
    sensor = UsedTransform("mount", "right", pose_of([0.0, 0.0, 0.3, *RIGHT.quat]))
    mount = UsedTransform("base", "mount", pose_of([0.1, -0.2, 0.0, 0.0, 0.0, 0.0, 1.0]))
    launch = InUse("launch", (sensor,))
    assert "right" not in found(launch, InUse("urdf", (mount, _used(LEFT))))
    assert found(launch, InUse("urdf", (_used(LEFT),)))["right"] == "found it below mount, expected below base"


@pytest.mark.parametrize("name", ["ros1", "ros2", "ros2-xml", "tf-static", "autoware"])
def test_our_exports_are_read_back(name: str, tmp_path: Path) -> None:
    edges = {(each.parent, each.child): matrix(each) for each in (LEFT, RIGHT)}
    [(file, text)] = FILES[name](Calibrated("r", edges, {}, {}, {}, {})).items()
    (tmp_path / file).write_text(text)
    result = compared(read_in_use(tmp_path / file))
    assert (result.compared, result.differences) == (2, ())
    (tmp_path / file).write_text(text.replace("0.3", "0.3001", 1))
    assert len(compared(read_in_use(tmp_path / file)).differences) == 1


def test_other_launch_files_are_read(tmp_path: Path) -> None:
    python = tmp_path / "a.launch.py"
    python.write_text('x = Node(arguments=["0.1", -0.2, 0.3, 0, 0, 0.6, 0.8, "base", "/right"])\nraise SystemExit\n')
    angles = f"0.1 -0.2 0.3 {2 * math.atan2(0.6, 0.8)!r} 0 0 base right 100"
    ros1 = tmp_path / "a.launch"
    ros1.write_text(f'<launch><node pkg="tf" type="static_transform_publisher" name="n" args="{angles}"/></launch>')
    ros2 = tmp_path / "b.launch.py"
    turned = f'"--yaw", "{2 * math.atan2(0.6, 0.8)!r}", "--frame-id", "base", "--child-frame-id", "right"'
    ros2.write_text(f'x = ["--x", "0.1", "--y", "-0.2", "--z", "0.3", {turned}]\n')
    for path in (python, ros1, ros2):
        [used] = read_in_use(path).transforms
        assert (used.parent, used.child) == ("base", "right")
        assert distance_of_poses(used.pose, pose_of([*RIGHT.trans, *RIGHT.quat])) == pytest.approx((0, 0), abs=1e-6)


def moved(by: float) -> BundledTransform:
    x, y, z = LEFT.trans
    return replace(LEFT, trans=(x, y + by, z))


@pytest.mark.parametrize(
    ("transforms", "of", "text"),
    [
        ((moved(1e-4), RIGHT), "left", "found it 0.1 mm and 0 deg off its pose below base"),
        ((replace(LEFT, quat=(0.48, 0.6400001, 0.0, 0.6)), RIGHT), "left", "found it 0 mm and 1.146e-05 deg"),
        ((replace(LEFT, quat=(0.96, 1.28, 0.0, 1.2)), RIGHT), "left", "found it 0 mm and 114.6 deg"),
        ((replace(LEFT, parent="mount"), RIGHT), "left", "found it below mount, expected below base"),
        ((RIGHT,), "left", "found no such frame, expected it below base"),
        (
            (replace(LEFT, trans=RIGHT.trans, quat=RIGHT.quat), RIGHT),
            "left",
            "this is the pose of right: are they exchanged?",
        ),
        ((LEFT, RIGHT, moved(0.01)), "left", "found it 10 mm"),
        ((LEFT, replace(RIGHT, quat=(0.0, 0.0, float("nan"), 0.8))), "right", "found it"),
    ],
)
def test_a_transform_that_differs_is_found(
    transforms: tuple[BundledTransform, ...], of: str, text: str, tmp_path: Path
) -> None:
    used = InUse("live", tuple(_used(each) for each in transforms))
    [difference] = compared(used).differences
    assert difference.of == of
    assert text in difference.text
    assert difference.place == "live"


def _used(each: BundledTransform) -> UsedTransform:
    return UsedTransform(each.parent, each.child, pose_of([*each.trans, *each.quat]))


def test_the_opposite_quaternion_is_the_same_rotation() -> None:
    opposite = replace(LEFT, quat=tuple(-value for value in LEFT.quat))
    assert found(InUse("live", (_used(opposite), _used(RIGHT)))) == {}


@pytest.mark.parametrize(
    ("change", "of", "text"),
    [
        (('xyz="0.1 -0.2 0"', 'xyz="0.1001 -0.2 0"'), "right", "found it 0.1 mm"),
        (('xyz="0 0 0.5"', 'xyz="0 0 0.5001"'), "elbow", "found it 0.1 mm"),
        (('name="e" type="revolute"', 'name="e" type="fixed"'), "elbow", "by a joint that is fixed"),
        (('name="m" type="fixed"', 'name="m" type="revolute"'), "right", "found it below mount"),
        (('<parent link="base"/><child link="mount"/>', '<parent link="arm"/><child link="mount"/>'), "right", "below"),
        (('<child link="left"/>', '<child link="front"/>'), "left", "found no such frame"),
    ],
)
def test_a_urdf_that_differs_is_found(change: tuple[str, str], of: str, text: str, tmp_path: Path) -> None:
    differences = found(read_in_use(urdf(tmp_path / "robot.urdf", change)))
    assert list(differences) == [of]
    assert text in differences[of]


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"width": 320}, "width: found 320, expected 640"),
        ({"distortion_model": "equidistant"}, "distortion_model: found 'equidistant', expected 'plumb_bob'"),
        ({"d": [0.1, -0.02, 0.0, 0.001]}, "D: found 4 numbers, expected 5"),
        ({"d": [0.1, -0.02, 0.0, 0.00100001, 0.0]}, "D[3]: found 0.00100001, expected 0.001"),
        ({"k": [500.0001, *SYSTEM.cameras[0].K[1:]]}, "K[0]: found 500.0001, expected 500.0"),
        ({"p": [1.0] * 12}, "P[0]: found 1.0, expected 500.0"),
        (
            {**camera_info(CAMERAS["right_camera"]), "header": {"frame_id": "left_camera_optical"}},
            "these are the intrinsics of right_camera: are they exchanged?",
        ),
    ],
)
def test_intrinsics_that_differ_are_found(change: dict[str, object], text: str, tmp_path: Path) -> None:
    left, right = CAMERAS.values()
    path = write_yaml(tmp_path / "live.yaml", camera_info(left, **change), camera_info(right))
    differences = found(read_in_use(path))
    assert list(differences) == ["left_camera"]
    assert text in differences["left_camera"]


def test_the_file_that_a_camera_loads_is_compared_with_that_camera(tmp_path: Path) -> None:
    path = write_yaml(tmp_path / "a.yaml", camera_info(CAMERAS["right_camera"]))
    assert found(read_in_use(path, "right_camera"))["left_camera"] == "found no camera_info of it"
    assert "are they exchanged?" in found(read_in_use(path, "left_camera"))["left_camera"]


def test_what_cannot_be_compared_is_a_warning() -> None:
    result = compared(InUse("tf", (_used(LEFT), _used(RIGHT))))
    assert (result.compared, result.differences) == (2, ())
    assert [warning.partition(":")[0] for warning in result.warnings] == ["elbow", "left_camera", "right_camera"]


@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_a_bag_is_what_was_recorded_of_it(kind: Kind, tmp_path: Path) -> None:
    path = _bag(tmp_path, kind, [LEFT, RIGHT], 510.0)
    result = compared(read_in_use(path))
    assert (result.compared, result.differences) == (4, ())
    differences = found(read_in_use(_bag(tmp_path / "other", kind, [LEFT, moved(1e-4), RIGHT], 511.0)))
    assert "found it 0.1 mm" in differences["left"]
    assert differences["right_camera"] == "K[0]: found 511.0, expected 510.0"


def _bag(folder: Path, kind: Kind, transforms: list[BundledTransform], fx: float) -> Path:
    folder.mkdir(exist_ok=True)
    path = folder / f"robot{'.bag' if kind == 'bag' else ''}"
    with BagFile(path, kind) as bag:
        for number, each in enumerate(transforms):
            _write_transform(bag, BEGIN + number, each)
        for of in (camera("left_camera", 500.0), camera("right_camera", fx)):
            info = camera_info(of)
            names = {name: name.upper() if bag.ros1 else name for name in "dkrp"}
            arrays = {names[name]: np.array(info[name]) for name in "dkrp"}
            roi = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
            message = bag.make(
                "sensor_msgs/msg/CameraInfo",
                header=bag.header(of.frame, BEGIN),
                height=of.height,
                width=of.width,
                distortion_model=of.distortion_model,
                binning_x=0,
                binning_y=0,
                roi=bag.make("sensor_msgs/msg/RegionOfInterest", **roi),
                **arrays,
            )
            for later in (0, SECOND):
                bag.write(f"/{of.name}/camera_info", BEGIN + later, message)
    return path


def _write_transform(bag: BagFile, time: int, each: BundledTransform) -> None:
    transform = bag.make(
        "geometry_msgs/msg/Transform",
        translation=bag.make("geometry_msgs/msg/Vector3", **dict(zip("xyz", each.trans, strict=True))),
        rotation=bag.make("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", each.quat, strict=True))),
    )
    stamped = bag.make(
        "geometry_msgs/msg/TransformStamped",
        header=bag.header(each.parent, time),
        child_frame_id=each.child,
        transform=transform,
    )
    bag.write("/tf_static", time, bag.make("tf2_msgs/msg/TFMessage", transforms=[stamped]))


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.urdf", "<robot>"),
        ("a.urdf", "<robot><joint name='j' type='fixed'/></robot>"),
        ("a.urdf", URDF.format(rpy="0 0 nan")),
        ("a.urdf", "<!DOCTYPE a [<!ENTITY x 'y'>]><robot>&x;</robot>"),
        ("a.urdf", "<a>" * 101),
        ("a.xml", "<html/>"),
        ("a.launch.py", "def ("),
        ("a.launch.py", "\0"),
        ("a.launch.py", 'x = ["--child-frame-id", "left"]'),
        ("a.launch.py", 'x = ["--frame-id", "a", "--child-frame-id", "b", "--qx", "1e999"]'),
        ("a.yaml", "transforms: 3"),
        ("a.yaml", "transforms: [{header: 1}]"),
        ("a.yaml", yaml.safe_dump(messages(LEFT)).replace("0.48", "'x'")),
        ("a.yaml", "camera_matrix: 3"),
        ("a.yaml", "k: [a]"),
        ("a.yaml", "a: 1"),
        ("a.yaml", "{a: {b: {x: 0, y: 0, z: 0, roll: 0, pitch: 0, yaw: x}}}"),
        ("a.yaml", ""),
        ("a.yaml", "&a [*a]"),
        ("a.bag", ""),
    ],
)
def test_a_file_that_is_none_is_an_error_that_names_it(name: str, text: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InputError) as error:
        read_in_use(path)
    assert str(error.value).startswith(str(path))
