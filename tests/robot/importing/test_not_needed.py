"""What an import does not need cannot stop it: it is left out, counted, and named."""

import json
import re
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg

from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.rotations import exp
from calibration.engine.geometry.transforms import distance, transform
from calibration.robot.importing.bags.bag import VIDEO_TYPES
from calibration.robot.importing.bags.motion import MotionLog
from calibration.robot.importing.bags.survey import IMAGE_TYPES
from calibration.robot.importing.image_views import decoded_image
from calibration.robot.importing.importing import import_data
from calibration.robot.importing.results import ImportResults
from tests.robot.importing.arm import ON_FLANGE, SYSTEM, keys, record_arm
from tests.robot.importing.bags import BEGIN, SECOND, BagFile
from tests.robot.importing.conftest import CAMERAS, FOCAL
from tests.robot.importing.test_bags import FRAMES, T2RGB, describe, file_of, image, record, refusal

ROOT = Path(__file__).parents[3]
EDGES = {edge: T[0] for edge, T in read_dataset(T2RGB).transforms.items() if edge[1] != "pattern_link"}
GRIPPER = """
  <link name="finger"/><link name="other_finger"/><link name="wheel"/><link name="drone"/>
  <joint name="finger_joint" type="prismatic"><parent link="flange"/><child link="finger"/></joint>
  <joint name="other" type="prismatic"><parent link="flange"/><child link="other_finger"/>
    <mimic joint="finger_joint" multiplier="-1"/></joint>
  <joint name="wheel_joint" type="continuous"><parent link="base_link"/><child link="wheel"/></joint>
  <joint name="flies" type="floating"><parent link="base_link"/><child link="drone"/></joint>
</robot>"""


def stereo_bag(folder: Path, stamps: list[float], **more: Any) -> Path:
    """A bag of t2rgb's left camera, with images at these stamps (s)."""
    path = file_of(folder, "mcap")
    with BagFile(path, "mcap") as bag:
        bag.transforms("/tf_static", BEGIN, more.get("edges", EDGES))
        for number, second in enumerate(stamps):
            stamp, recorded = BEGIN + int(second * SECOND), BEGIN + number * SECOND
            for camera in CAMERAS:
                frame = FRAMES[camera]
                bag.camera_info(f"/{camera}/camera_info", stamp, frame, (640, 480), more.get("focal", 1.0) * 500)
                topic = f"/{camera}/image_raw"
                bag.image(topic, stamp, image(camera, number % 8), frame, "mono8", recorded - stamp)
    return path


def counts(results: ImportResults) -> dict[tuple[str, str], int]:
    return {(each.rule, each.place): each.count for each in results.left_out}


@pytest.mark.parametrize("odd", [3.0, 2.998])
def test_stamps_that_do_not_rise_are_left_out(tmp_path: Path, odd: float) -> None:
    results = import_data(describe(stereo_bag(tmp_path, [0, 1, 2, 3, odd, 5, 6, 7])), tmp_path / "out", jobs=1)
    assert results.collections == 7
    (first, second) = results.left_out
    assert (first.count, second.count) == (1, 1)
    assert "not later" in first.rule
    assert first.first_s == pytest.approx(BEGIN / SECOND + odd)


def test_what_is_off_the_chain_is_no_matter(tmp_path: Path) -> None:
    """An arm whose root is base_link, with a gripper, wheels without a number, and a frame without an orientation."""
    path = file_of(tmp_path, "mcap")
    record_arm(path, "mcap", keys()[:6])
    with BagFile(tmp_path / "more", "mcap") as bag:
        urdf = (SYSTEM / "robot.urdf").read_text().replace("</robot>", GRIPPER)
        bag.text("/robot_description", BEGIN, urdf)
        bag.joints("/joint_states", BEGIN, {"wheel_joint": float("nan")})
        nowhere = np.eye(4)
        nowhere[:3, :3] = 0
        bag.transforms("/tf", BEGIN, {("base_link", "imu_link"): np.full((4, 4), np.nan)})
        bag.transforms("/tf", BEGIN, {("base_link", "box"): np.eye(4), ("flange", "box"): np.eye(4)})
    bags = {"files": ["more", path.name]}
    results = import_data(describe(path, patterns={"board": ON_FLANGE}, bags=bags), tmp_path / "out", jobs=1)
    assert results.collections == 6
    found = {place: count for (_, place), count in counts(results).items()}
    assert found == {"wheel_joint": 1, "base_link -> imu_link": 1, "box": 1}


def test_a_description_that_cannot_be_read_is_a_note_where_frames_are_recorded(tmp_path: Path) -> None:
    path = record(tmp_path, "mcap", poses=5)
    with BagFile(tmp_path / "more", "mcap") as bag:
        bag.text("/robot_description", BEGIN, '<robot><link name="a"/><joint type="odd" name="j"/></robot>')
    results = import_data(describe(path, bags={"files": ["more", path.name]}), tmp_path / "out", jobs=1)
    (note,) = results.notes
    assert "joint 'j': type 'odd'" in note


def test_without_frames_the_fault_of_the_description_is_named(tmp_path: Path) -> None:
    path = file_of(tmp_path, "mcap")
    record_arm(path, "mcap", keys()[:3], urdf=False)
    with BagFile(tmp_path / "more", "mcap") as bag:
        bag.text("/robot_description", BEGIN, '<robot><link name="a"/><joint type="odd" name="j"/></robot>')
    config = describe(path, patterns={"board": ON_FLANGE}, bags={"files": ["more", path.name]})
    assert "found no frame 'flange'" in (error := refusal(config))
    assert "joint 'j': type 'odd'" in error


def test_the_root_is_the_root_whatever_its_name(tmp_path: Path) -> None:
    named = {tuple({"world": "odom"}.get(frame, frame) for frame in edge): T for edge, T in EDGES.items()}
    path = stereo_bag(tmp_path, [0, 1, 2, 3, 4], edges=named)
    import_data(describe(path), tmp_path / "out", jobs=1)
    dataset = read_dataset(tmp_path / "out")
    assert dataset.world == "odom"
    assert dataset.patterns["board"].parent_link == "odom"
    assert not dataset.patterns["board"].fixed


def test_of_two_parents_on_the_chain_one_is_chosen(tmp_path: Path) -> None:
    (parent, child), T = next(iter(EDGES.items()))
    path = stereo_bag(tmp_path, [0, 1, 2, 3, 4], edges={**EDGES, ("elsewhere", child): T})
    assert f"choose it, parents: {{{child}: " in refusal(describe(path))
    assert "expected one that was recorded" in refusal(describe(path, parents={child: "nowhere"}))
    import_data(describe(path, parents={child: parent}), tmp_path / "out", jobs=1)
    assert (parent, child) in read_dataset(tmp_path / "out").transforms


def test_clocks_that_do_not_agree(tmp_path: Path) -> None:
    """The right camera's stamps count from its start; both are recorded at the same times."""
    path = file_of(tmp_path, "mcap")
    with BagFile(path, "mcap") as bag:
        for number in range(5):
            for camera, start in zip(CAMERAS, (BEGIN, 0), strict=True):
                stamp = start + (number + 1) * SECOND
                late = BEGIN + (number + 1) * SECOND - stamp
                bag.camera_info(f"/{camera}/camera_info", stamp, camera, (640, 480), FOCAL)
                bag.image(f"/{camera}/image_raw", stamp, image(camera, number), camera, "mono8", late)
    assert "'stamps: recorded'" in refusal(describe(path))
    sensors = {
        "left": {"topic": "/left_camera/image_raw", "stamps": "recorded"},
        "right": {"topic": "/right_camera/image_raw", "stamps": "recorded"},
    }
    assert import_data(describe(path, sensors=sensors), tmp_path / "out", jobs=1).together == 5


def test_images_without_a_pattern_are_named(tmp_path: Path) -> None:
    path = file_of(tmp_path, "mcap")
    with BagFile(path, "mcap") as bag:
        for number in range(7):
            shown = image("left_camera", number) if number != 3 else np.full((480, 640, 3), 90, np.uint8)
            bag.camera_info("/left/camera_info", BEGIN + number * SECOND, "left", (640, 480), FOCAL)
            bag.image("/left/image_raw", BEGIN + number * SECOND, shown, "left", "mono8")
    results = import_data(describe(path), tmp_path / "out", jobs=1)
    (rejected,) = results.sensors["left"].rejected
    assert rejected.file == f"/left/image_raw at {BEGIN // SECOND + 3}.000"
    assert counts(results) == {("no pattern is detected in it", "left"): 1}


def test_intrinsics_that_change_are_an_error_with_the_time(tmp_path: Path) -> None:
    path = file_of(tmp_path, "mcap")
    with BagFile(path, "mcap") as bag:
        for number in range(6):
            stamp = BEGIN + number * SECOND
            focal = 0.0 if number == 0 else 500.0 if number < 4 else 510.0
            bag.camera_info("/left/camera_info", stamp, "left", (640, 480), focal)
            bag.image("/left/image_raw", stamp, image("left_camera", number), "left", "mono8")
    error = refusal(describe(path))
    assert f"at {BEGIN // SECOND + 4}.000" in error
    assert "fx 510" in error
    assert "fx 500" in error


def test_between_two_records_a_pose_is_interpolated() -> None:
    log = MotionLog()
    log.add_transform(("a", "b"), 0, np.eye(4))
    turned = transform(exp(np.array([0.0, 0.0, 0.4])), [1.0, 0, 0])
    log.add_transform(("a", "b"), SECOND // 10, turned)
    expected = transform(exp(np.array([0.0, 0.0, 0.1])), [0.25, 0, 0])
    m, rad = distance(log.transform(("a", "b"), SECOND / 40), expected)
    assert m < 1e-12
    assert rad < 1e-12
    log.add_joint_position("j", 0, np.radians(179))
    log.add_joint_position("j", SECOND // 10, np.radians(-179))
    found = log.joints["j"].at(SECOND / 20)
    assert found is not None
    np.testing.assert_allclose(np.degrees(found), 180)


def page_lines(word: str) -> str:
    """The import.yml of docs/your-data.md that has a word, as a user copies it."""
    blocks = re.findall(r"```yaml\n(.*?)```", (ROOT / "docs" / "your-data.md").read_text(), re.DOTALL)
    return next(block for block in blocks if word in block)


def test_a_newcomers_bag_takes_the_lines_of_the_page(tmp_path: Path) -> None:
    """A robot with root base_link, mimic joints in the gripper, wheels without a number, before a fisheye."""
    bag_file = tmp_path / "poses.bag"
    tangent = np.array([1 / 3, 2 / 15, 17 / 315, 62 / 2835])  # equidistant coefficients of a lens without distortion
    record_arm(bag_file, "bag", keys(), urdf=False, info={"distortion_model": "fisheye", "d": tangent})
    urdf = (SYSTEM / "robot.urdf").read_text().replace("</robot>", GRIPPER)
    (tmp_path / "robot.urdf").write_text(urdf)
    with BagFile(tmp_path / "wheels.bag", "bag") as bag:
        bag.joints("/joint_states", BEGIN, {"wheel_joint": float("nan"), "finger_joint": 0.01})
    config = tmp_path / "import.yml"
    config.write_text(page_lines("poses.bag").replace("[poses.bag]", "[poses.bag, wheels.bag]"))
    assert import_data(config, tmp_path / "out", jobs=1).collections == len(keys())
    dataset = read_dataset(tmp_path / "out")
    (sensor,) = dataset.sensors.values()
    assert sensor.camera is not None
    assert sensor.camera.distortion.ros_name == "equidistant"
    assert calibrate(dataset, Options()).rms_px < 0.3


def test_two_cameras_on_a_base_link_take_the_two_lines_of_the_page(tmp_path: Path) -> None:
    named = {tuple({"world": "base_link"}.get(frame, frame) for frame in edge): T for edge, T in EDGES.items()}
    (storage,) = stereo_bag(tmp_path, [0, 1, 2, 3, 4], edges=named).glob("*.mcap")
    storage.rename(tmp_path / "poses.mcap")
    config = tmp_path / "import.yml"
    config.write_text(page_lines("poses.mcap"))
    assert import_data(config, tmp_path / "out", jobs=1).collections == 5
    assert read_dataset(tmp_path / "out").world == "base_link"


def one_camera(folder: Path, topic: str, **info: Any) -> Path:
    """A bag of t2rgb's left camera with this camera_info."""
    path = file_of(folder, "mcap")
    with BagFile(path, "mcap") as bag:
        for number in range(5):
            stamp = BEGIN + number * SECOND
            size = info.get("size", (640, 480))
            fields = {key: value for key, value in info.items() if key != "size"}
            bag.camera_info("/left/camera_info", stamp, "left", size, 500, **fields)
            bag.image(topic, stamp, image("left_camera", number), "left", "mono8")
    return path


def imported_camera(path: Path) -> Camera:
    import_data(describe(path), path.parent / "out", jobs=1)
    (sensor,) = read_dataset(path.parent / "out").sensors.values()
    assert sensor.camera is not None
    return sensor.camera


P = np.array([480, 0, 310, 0, 0, 470, 230, 0, 0, 0, 1, 0.0])


def test_rectified_images_have_the_projection_and_no_distortion(tmp_path: Path) -> None:
    found = imported_camera(one_camera(tmp_path, "/left/image_rect_color", d=np.full(5, 0.1), p=P))
    np.testing.assert_allclose(found.intrinsics[:4], [480, 470, 310, 230])
    assert not found.distortion.coefficients.any()


@pytest.mark.parametrize(
    ("info", "message"),
    [
        ({"p": P, "r": exp(np.array([0.01, 0, 0])).ravel()}, "turned by 0.57 deg"),
        ({}, "found no projection P"),
    ],
)
def test_rectified_images_that_are_turned_or_without_projection(
    tmp_path: Path, info: dict[str, Any], message: str
) -> None:
    assert message in refusal(describe(one_camera(tmp_path, "/left/image_rect", **info)))


def test_binning_divides_the_intrinsics(tmp_path: Path) -> None:
    found = imported_camera(one_camera(tmp_path, "/left/image_raw", size=(1280, 960), binning_x=2, binning_y=2))
    np.testing.assert_allclose(found.intrinsics[:4], [250, 250, 320.25, 240.25])
    assert (found.width, found.height) == (640, 480)


def test_a_compressed_image_of_16_bits_is_stretched() -> None:
    true = image("left_camera", 0)
    levels = true.astype(np.uint16) * 4  # 10 bits
    found = decoded_image(cv2.imencode(".png", levels)[1].tobytes(), "here")
    assert abs(found.astype(float) * np.quantile(true, 0.999) / 255 - true).mean() < 1


def test_a_topic_is_one_word(tmp_path: Path) -> None:
    results = import_data(describe(one_camera(tmp_path, "image_raw")), tmp_path / "out", jobs=1)
    assert list(results.sensors) == ["image_raw"]


def test_rectified_images_beside_raw_ones_are_left_out(tmp_path: Path) -> None:
    """They would be a second camera at the same place; these could not even be read."""
    path = file_of(tmp_path, "mcap")
    with BagFile(path, "mcap") as bag:
        for number in range(5):
            stamp = BEGIN + number * SECOND
            turned = exp(np.array([0.01, 0, 0])).ravel()
            bag.camera_info("/left/camera_info", stamp, "left", (640, 480), 500, p=P, r=turned)
            for topic in ("/left/image_raw", "/left/image_rect_color"):
                bag.image(topic, stamp, image("left_camera", number), "left", "mono8")
    results = import_data(describe(path), tmp_path / "out", jobs=1)
    assert list(results.sensors) == ["left"]
    assert [each.place for each in results.left_out] == ["/left/image_rect_color"]


@pytest.mark.parametrize("kind", ["ffmpeg_image_transport_msgs/msg/FFMPEGPacket", "foxglove_msgs/msg/CompressedVideo"])
def test_a_video_says_what_to_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    path = file_of(tmp_path, "mcap")
    with BagFile(path, "mcap") as bag:
        bag.types.register(get_types_from_msg("uint32 width", kind))
        bag.write("/camera/ffmpeg", BEGIN, bag.make(kind, width=0))
    assert "record Image or" in (error := refusal(describe(path)))
    assert "pip install av" in error


def test_frames_of_a_video_in_compressed_images(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    path = file_of(tmp_path, "mcap")
    with BagFile(path, "mcap") as bag:
        data = np.zeros(9, np.uint8)
        header = bag.header("left", BEGIN)
        bag.write("/left/h264", BEGIN, bag.make(f"{IMAGE_TYPES[1]}", header=header, format="h264", data=data))
    assert "found a frame of a video, h264" in (error := refusal(describe(path)))
    assert "pip install av" in error


@pytest.mark.parametrize("topic", ["/left/image_raw/ffmpeg", "/other/image_raw/ffmpeg"])
def test_a_video_beside_images_cannot_stop_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, topic: str) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    path = one_camera(tmp_path, "/left/image_raw")
    with BagFile(tmp_path / "more", "mcap") as bag:
        kind = next(iter(VIDEO_TYPES))
        bag.types.register(get_types_from_msg("uint32 width", kind))
        bag.write(topic, BEGIN, bag.make(kind, width=0))
    config = describe(path, bags={"files": ["more", path.name]})
    assert list(import_data(config, tmp_path / "out", jobs=1).sensors) == ["left"]


def test_of_two_images_recorded_at_one_time_the_first_is_labelled(tmp_path: Path) -> None:
    """As it is the first that is written; another one's corners would be those of another image."""
    found = []
    for name, twice in (("once", False), ("twice", True)):
        (tmp_path / name).mkdir()
        path = file_of(tmp_path / name, "mcap")
        with BagFile(path, "mcap") as bag:
            for number in range(5):
                stamp = BEGIN + number * SECOND
                bag.camera_info("/left/camera_info", stamp, "left", (640, 480), FOCAL)
                bag.image("/left/image_raw", stamp, image("left_camera", number), "left", "mono8", late=0)
                if twice:
                    other = image("left_camera", number + 5)
                    bag.image("/left/image_raw", stamp + 1, other, "left", "mono8", late=-1)
        results = import_data(describe(path), tmp_path / name / "out", jobs=1)
        assert sum(each.count for each in results.left_out) == 5 * twice
        found.append(json.loads((tmp_path / name / "out" / "dataset.json").read_text())["collections"]["003"]["labels"])
    assert found[0] == found[1]
