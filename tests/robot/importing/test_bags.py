"""Bags of ROS 1 and ROS 2 become datasets that calibrate as those that were simulated with their images."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base import CalibrationError, InputError
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.geometry.transforms import distance
from calibration.robot.importing.bags.bag import open_bag
from calibration.robot.importing.bags.messages import image_of
from calibration.robot.importing.bags.survey import IMAGE_TYPES
from calibration.robot.importing.importing import import_data
from tests.robot.importing.arm import ON_FLANGE, keys, record_arm
from tests.robot.importing.bags import BEGIN, ENCODINGS, SECOND, BagFile, Kind
from tests.robot.importing.conftest import BOARD, CAMERAS, DATASETS, FOCAL
from tests.robot.importing.test_importing import true_relative

KINDS: tuple[Kind, ...] = get_args(Kind)
FRAMES = {"left_camera": "camera_left_rgb_optical_frame", "right_camera": "camera_right_rgb_optical_frame"}
T2RGB = DATASETS / "t2rgb"


def image(camera: str, number: int) -> np.ndarray:
    return np.asarray(cv2.imread(str(T2RGB / f"{camera}_{number:03d}.jpg")))


def file_of(folder: Path, kind: Kind) -> Path:
    return folder / ("recorded.bag" if kind == "bag" else "recorded")


def record(
    folder: Path,
    kind: Kind,
    poses: int = 5,
    period: float = 1.0,
    stay: int = 1,
    encodings: tuple[str, str] = ("bgr8", "bgr8"),
    tf: bool = True,
    info: bool = True,
    late: float = 0.002,
) -> Path:
    """A recording of t2rgb: ``stay`` images of each of the poses by both cameras, one every ``period`` s.

    The right camera's stamps are a little late.
    """
    path = file_of(folder, kind)
    dataset = read_dataset(T2RGB)
    with BagFile(path, kind) as bag:
        if tf:
            edges = {edge: T[0] for edge, T in dataset.transforms.items() if edge[1] != "pattern_link"}
            bag.transforms("/tf_static", BEGIN, edges)
        for n in range(poses * stay):
            for camera, encoding, delay in zip(CAMERAS, encodings, (0.0, late), strict=True):
                stamp = BEGIN + int((n * period + delay) * SECOND)
                if info:
                    bag.camera_info(f"/{camera}/camera_info", stamp, FRAMES[camera], (640, 480), FOCAL)
                topic = f"/{camera}/image_raw" + ("/compressed" if encoding == "jpeg" else "")
                bag.image(topic, stamp, image(camera, n // stay), FRAMES[camera], encoding)
    return path


def describe(path: Path, **more: Any) -> Path:
    file = path.parent / "import.yml"
    document = {"bags": {"files": [path.name], **more.pop("bags", {})}, "patterns": {"board": BOARD}, **more}
    file.write_text(json.dumps(document))
    return file


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("kind", KINDS)
def test_a_recording_is_all_that_it_takes(tmp_path: Path, kind: Kind) -> None:
    config = describe(record(tmp_path, kind, poses=8))
    results = import_data(config, tmp_path / "out", jobs=1)
    assert (results.collections, results.together) == (8, 8)
    assert results.lag_ms == pytest.approx(2, abs=0.01)
    assert {each.intrinsics for each in results.sensors.values()} == {"given"}
    dataset = read_dataset(tmp_path / "out")
    known = read_dataset(T2RGB)
    assert dataset.world == "world"
    for name in CAMERAS:
        assert dataset.sensors[name].edge == known.sensors[name].edge  # above the optical frame, as in the tree
        assert dataset.sensors[name].frame == FRAMES[name]
    calibration = calibrate(dataset, Options())
    found = calibration.dataset.transform(FRAMES["right_camera"], FRAMES["left_camera"])[0]
    m, rad = (float(v) for v in distance(true_relative(), found))
    assert m < 1e-3
    assert np.degrees(rad) < 0.05


def test_another_lens_model_than_that_of_camera_info_is_refused(tmp_path: Path) -> None:
    sensors = {camera: {"topic": f"/{camera}/image_raw", "model": "eucm"} for camera in CAMERAS}
    with pytest.raises(InputError, match=r"has intrinsics of plumb_bob there, found 'model: eucm' in import\.yml"):
        import_data(describe(record(tmp_path, "mcap", poses=3), sensors=sensors), tmp_path / "out", jobs=1)


def test_without_frames_and_intrinsics_both_are_found(tmp_path: Path) -> None:
    config = describe(record(tmp_path, "mcap", poses=8, tf=False, info=False))
    results = import_data(config, tmp_path / "out", jobs=1)
    assert {each.intrinsics for each in results.sensors.values()} == {"estimated"}
    assert read_dataset(tmp_path / "out").anchored in CAMERAS


@pytest.mark.parametrize("encoding", [*ENCODINGS, "jpeg"])
@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_every_encoding_is_decoded(tmp_path: Path, kind: Kind, encoding: str) -> None:
    true = image("left_camera", 0)
    path = file_of(tmp_path, kind)
    with BagFile(path, kind) as bag:
        bag.image("/image", BEGIN, true, "camera", encoding)
    with open_bag([path]) as bag_:
        (message,) = bag_.messages(["/image"])
        assert bag_.topics["/image"] in IMAGE_TYPES
        assert bag_.stamp(message) == BEGIN
        found = image_of(bag_.decode(message), "here")
    grey = np.asarray(cv2.cvtColor(true, cv2.COLOR_BGR2GRAY), float)
    mine = found if found.ndim == 2 else cv2.cvtColor(found, cv2.COLOR_BGR2GRAY)
    if "16" in encoding:  # stretched to the brightest
        grey = np.minimum(grey * np.median(mine) / np.median(grey), 255)
        assert np.quantile(mine, 0.999) > 240
    assert np.abs(mine - grey).mean() < (4 if encoding.startswith(("bayer", "nv")) or encoding == "jpeg" else 0.6)


def test_each_stay_is_one_collection_and_what_moves_is_none(tmp_path: Path) -> None:
    """Ten images a second: three stays of half a second, and between them the board moves from image to image."""
    path, stamp = file_of(tmp_path, "mcap"), BEGIN
    with BagFile(path, "mcap") as bag:
        bag.camera_info("/left_camera/camera_info", stamp, "left", (640, 480), FOCAL)
        for pose in range(3):
            still = image("left_camera", pose)
            moving = [np.roll(still, 4 * (i + 1), axis=1) for i in range(4)]
            for shown in [*[still] * 5, *moving]:
                bag.image("/left_camera/image_raw", stamp, shown, "left", "mono8")
                stamp += SECOND // 10
    results = import_data(describe(path), tmp_path / "out", jobs=1)
    assert results.collections == 3
    before = describe(path, bags={"every": 0.1})
    assert import_data(before, tmp_path / "every", jobs=1).collections == 27


def test_times_are_chosen(tmp_path: Path) -> None:
    path = record(tmp_path, "bag", poses=8)
    (tmp_path / "times.txt").write_text(f"0\n1.0\n\n{BEGIN // SECOND + 4}\n5.01\n6\n")
    results = import_data(describe(path, bags={"at": "times.txt"}), tmp_path / "out", jobs=1)
    assert results.collections == 5


def test_the_moments_that_calibrate_best_are_kept(tmp_path: Path) -> None:
    """Of eight moments at one pose, and one at each of six others: those six, and one of the eight."""
    path, numbers = file_of(tmp_path, "mcap"), [0] * 8 + [1, 2, 3, 4, 5, 6]
    with BagFile(path, "mcap") as bag:
        for n, number in enumerate(numbers):
            for camera in CAMERAS:
                stamp = BEGIN + n * SECOND
                bag.camera_info(f"/{camera}/camera_info", stamp, FRAMES[camera], (640, 480), FOCAL)
                bag.image(f"/{camera}/image_raw", stamp, image(camera, number), FRAMES[camera])
    results = import_data(describe(path, bags={"most": 7}), tmp_path / "out", jobs=1)
    assert (results.found, results.collections, results.evenly) == (14, 7, None)
    images = {hash(file.read_bytes()) for file in (tmp_path / "out").glob("left_camera_*.png")}
    assert len(images) == 7


def test_moments_that_calibrate_nothing_are_chosen_evenly(tmp_path: Path) -> None:
    path = file_of(tmp_path, "mcap")
    with BagFile(path, "mcap") as bag:
        for n in range(6):
            stamp = BEGIN + n * SECOND
            bag.camera_info("/left_camera/camera_info", stamp, FRAMES["left_camera"], (640, 480), FOCAL)
            bag.image("/left_camera/image_raw", stamp, image("left_camera", n), FRAMES["left_camera"])
    results = import_data(describe(path, bags={"most": 3}), tmp_path / "out", jobs=1)
    assert (results.found, results.collections) == (6, 3)
    assert "nothing to calibrate" in str(results.evenly)


def test_joints_of_a_robot_move_a_camera(tmp_path: Path) -> None:
    """The arm's poses come from joint_states and robot_description; moments at which it moves are left out."""
    path = file_of(tmp_path, "db3")
    record_arm(path, "db3", keys(), moving=[3])
    results = import_data(describe(path, patterns={"board": ON_FLANGE}), tmp_path / "out", jobs=1)
    assert results.collections == len(keys()) - 1
    dataset = read_dataset(tmp_path / "out")
    assert dataset.patterns["board"].fixed
    calibration = calibrate(dataset, Options())
    assert calibration.rms_px < 0.3


def earlier_stamp(folder: Path, kind: Kind) -> Path:
    path = file_of(folder, kind)
    with BagFile(path, kind) as bag:
        for number, second in enumerate((0, 1, 2, 1.5)):
            stamp = BEGIN + int(second * SECOND)
            late = BEGIN + number * SECOND - stamp
            bag.image("/left/image_raw", stamp, image("left_camera", number), "left", "mono8", late)
    return path


def unknown_encoding(folder: Path, kind: Kind) -> Path:
    path = file_of(folder, kind)
    ENCODINGS_OF_NO_ROS = {"hsv8": ENCODINGS["bgr8"]}
    with BagFile(path, kind) as bag, pytest.MonkeyPatch.context() as patch:
        patch.setitem(ENCODINGS, "hsv8", ENCODINGS_OF_NO_ROS["hsv8"])  # type: ignore[arg-type]
        bag.image("/left/image_raw", BEGIN, image("left_camera", 0), "left", "hsv8")
    return path


def without_images(folder: Path, kind: Kind) -> Path:
    path = file_of(folder, kind)
    with BagFile(path, kind) as bag:
        bag.text("/robot_description", BEGIN, "<robot/>")
    return path


def short(folder: Path, kind: Kind) -> Path:
    """A recording in which nothing is wrong."""
    return record(folder, kind, poses=2)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("recording", "message"),
    [
        (earlier_stamp, "the clock jumps back by 0.500 s at 1700000002.000"),
        (unknown_encoding, "found the encoding 'hsv8'"),
        (without_images, "found no topic of images"),
    ],
)
def test_what_is_wrong_with_a_recording_is_one_line(
    tmp_path: Path, kind: Kind, recording: Callable[[Path, Kind], Path], message: str
) -> None:
    assert message in refusal(describe(recording(tmp_path, kind)))


def refusal(config: Path) -> str:
    """The error of an import, which leaves no dataset."""
    with pytest.raises(InputError) as error:
        import_data(config, config.parent / "out", jobs=1)
    assert not (config.parent / "out" / "dataset.json").exists()
    return str(error.value)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"sensors": {"left": {"topic": "/left"}}}, "topics of cameras and LiDARs: /left_camera/image_raw"),
        (
            {"sensors": {"left": {"topic": "/left_camera/image_raw", "camera-info": "/info"}}},
            "found no camera_info '/info' for 'left'; topics of that type: /left_camera/camera_info",
        ),
        (
            {"sensors": {"left": {"topic": "/left_camera/image_raw", "parent": "nowhere"}}},
            "'nowhere' is not above 'camera_left_rgb_optical_frame'",
        ),
        (
            {"sensors": {"left": {"topic": "/left_camera/image_raw", "distortion": "dist.txt"}}},
            "'left': found 'distortion', expected 'intrinsics' beside it",
        ),
        ({"patterns": {"board": {**BOARD, "parent": "hand"}}}, "found no frame 'hand'"),
        ({"patterns": {"board": {**BOARD, "dictionary": "DICT_6X6_250"}}}, "another dictionary, DICT_5X5_100"),
        ({"patterns": {"board": {**BOARD, "columns": 6}}}, "columns and rows"),
    ],
)
def test_what_is_wrong_with_the_description_is_one_line(tmp_path: Path, more: dict[str, Any], message: str) -> None:
    assert message in refusal(describe(short(tmp_path, "mcap"), **more))


def test_stamps_that_do_not_overlap(tmp_path: Path) -> None:
    config = describe(record(tmp_path, "bag", late=100.0))
    with pytest.raises(InputError, match="do not overlap: are their clocks synchronised"):
        import_data(config, tmp_path / "out", jobs=1)


def test_images_of_another_size_than_camera_info(tmp_path: Path) -> None:
    path = file_of(tmp_path, "mcap")
    with BagFile(path, "mcap") as bag:
        for number in range(4):
            stamp = BEGIN + number * SECOND
            bag.camera_info("/left/camera_info", stamp, "left", (320, 240), 300.0)
            bag.image("/left/image_raw", stamp, image("left_camera", number), "left", "mono8")
    with pytest.raises(InputError, match="found an image of 640 x 480 pixels, expected 320 x 240"):
        import_data(describe(path), tmp_path / "out", jobs=1)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.bag", b"", "this bag is empty"),
        ("a.bag", b"#ROSBAG V1.2\n", "cannot be read"),
        ("a.bag", b"no bag at all", "cannot be read"),
        ("a.mcap", b"\x89MCAP0\r\n", "cannot be read"),
        ("a.db3", b"no database", "cannot be read"),
        ("a.txt", b"x", "expected a bag: a file that ends in .bag, .db3, .mcap"),
    ],
)
def test_what_is_no_bag(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError) as error:
        import_data(describe(tmp_path / name), tmp_path / "out", jobs=1)
    assert message in str(error.value)
    assert str(tmp_path / name) in str(error.value)


def test_a_truncated_bag_and_a_folder_without_a_bag(tmp_path: Path) -> None:
    path = record(tmp_path, "bag", poses=2)
    path.write_bytes(path.read_bytes()[:-5000])
    with pytest.raises(InputError, match="cannot be read"):
        import_data(describe(path), tmp_path / "out", jobs=1)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"found no metadata\.yaml in it"):
        import_data(describe(tmp_path / "empty"), tmp_path / "out", jobs=1)
    with pytest.raises(InputError, match="found no such file"):
        import_data(describe(tmp_path / "none.bag"), tmp_path / "out", jobs=1)


def with_header(path: Path, change: Callable[[dict[bytes, bytes]], None]) -> None:
    """Change the fields of the header record of a bag of ROS 1; its padding keeps all else where it is."""
    data, start = path.read_bytes(), len(b"#ROSBAG V2.0\n")
    length = int.from_bytes(data[start : start + 4], "little")
    at, fields = start + 4, {}
    while at < start + 4 + length:
        size = int.from_bytes(data[at : at + 4], "little")
        name, _, value = data[at + 4 : at + 4 + size].partition(b"=")
        fields[name], at = value, at + 4 + size
    end = at + 4 + int.from_bytes(data[at : at + 4], "little")
    change(fields)
    entries = [name + b"=" + value for name, value in fields.items()]
    header = b"".join(len(entry).to_bytes(4, "little") + entry for entry in entries)
    padding = end - start - 8 - len(header)
    record = len(header).to_bytes(4, "little") + header + padding.to_bytes(4, "little") + b" " * padding
    path.write_bytes(data[:start] + record + data[end:])


def test_an_encrypted_bag(tmp_path: Path) -> None:
    path = record(tmp_path, "bag", poses=2)
    with_header(path, lambda fields: fields.update({b"encryptor": b"rosbag/AesCbcEncryptor"}))
    with pytest.raises(InputError, match=r"encryption .rosbag/AesCbcEncryptor. is not supported"):
        import_data(describe(path), tmp_path / "out", jobs=1)


def test_a_bag_whose_recorder_was_killed(tmp_path: Path) -> None:
    """No index was written: in ROS 1 its place is 0, in ROS 2 metadata.yaml or the end of the file is missing."""
    path = record(tmp_path, "bag", poses=2)
    with_header(path, lambda fields: fields.update({b"index_pos": bytes(8)}))
    with pytest.raises(InputError, match="not indexed, reindex before reading"):
        import_data(describe(path), tmp_path / "out", jobs=1)
    path = record(tmp_path, "mcap", poses=2)
    (file,) = path.glob("*.mcap")
    file.write_bytes(file.read_bytes()[:-200])
    with pytest.raises(InputError, match="cannot be read") as error:
        import_data(describe(path), tmp_path / "out", jobs=1)
    assert "\n" not in str(error.value)


def test_a_topic_of_another_type(tmp_path: Path) -> None:
    sensors = {"left": {"topic": "/left_camera/camera_info"}}
    path = record(tmp_path, "db3", poses=2)
    with pytest.raises(InputError, match=r"found '/left_camera/camera_info' as sensor_msgs/msg/CameraInfo, expected"):
        import_data(describe(path, sensors=sensors), tmp_path / "out", jobs=1)


def test_split_bags_are_one(tmp_path: Path) -> None:
    """Each part has half of the poses."""
    parts = []
    for part in range(2):
        with BagFile(tmp_path / f"part{part}.bag", "bag") as bag:
            parts.append(f"part{part}.bag")
            for number in range(4 * part, 4 * part + 4):
                bag.image("/left/image_raw", BEGIN + number * SECOND, image("left_camera", number), "left", "mono8")
    config = describe(tmp_path / "part0.bag", bags={"files": parts})
    assert import_data(config, tmp_path / "out", jobs=1).collections == 8


def test_a_killed_import_goes_on_where_it_was(tmp_path: Path) -> None:
    config = describe(record(tmp_path, "mcap", poses=13, stay=4, period=0.15, tf=False, encodings=("mono8", "mono8")))

    def stop(done: int, *_: object) -> None:
        if done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        import_data(config, tmp_path / "out", jobs=1, done=stop)
    kept = list((tmp_path / "out" / ".unfinished").glob("*.result.json"))
    assert kept
    stamps = {path: path.stat().st_mtime_ns for path in kept}

    def check(done: int, *_: object) -> None:
        if done == 1:
            assert {path: path.stat().st_mtime_ns for path in kept} == stamps

    assert import_data(config, tmp_path / "out", jobs=1, done=check).collections == 13
    assert not (tmp_path / "out" / ".unfinished").exists()


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Small bags of every kind, to be damaged."""
    folder = tmp_path_factory.mktemp("whole")
    for kind in KINDS:
        (folder / kind).mkdir()
        path = file_of(folder / kind, kind)
        with BagFile(path, kind) as bag:
            bag.transforms("/tf_static", BEGIN, {("world", "left"): np.eye(4)})
            for number in range(2):
                small = cv2.resize(image("left_camera", number), (64, 48))
                bag.camera_info("/left/camera_info", BEGIN + number * SECOND, "left", (64, 48), 50.0)
                bag.image("/left/image_raw", BEGIN + number * SECOND, small, "left", "mono8")
    return folder


@given(kind=st.sampled_from(KINDS), at=st.floats(0, 1), cut=st.booleans(), value=st.binary(min_size=1, max_size=4))
def test_damaged_bags_are_errors(
    whole: Path, tmp_path_factory: pytest.TempPathFactory, kind: Kind, at: float, cut: bool, value: bytes
) -> None:
    folder = tmp_path_factory.mktemp("damaged")
    shutil.copytree(whole / kind, folder / "copy")
    path = file_of(folder / "copy", kind)
    files = [path] if path.is_file() else sorted(path.iterdir())
    file = files[int(at * 7919) % len(files)]
    data = bytearray(file.read_bytes())
    place = int(at * (len(data) - 1))
    if cut:
        del data[place:]
    else:
        data[place : place + len(value)] = value
    file.write_bytes(data)
    with pytest.raises(CalibrationError):  # 48 rows show no pattern, whatever else is wrong
        import_data(describe(path), folder / "out", jobs=1)
    shutil.rmtree(folder)


def test_a_length_beyond_all_memory_is_damage(whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from rosbags.rosbag1 import Reader

    def exhausted(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(Reader, "messages", exhausted)
    shutil.copytree(whole / "bag", tmp_path / "copy")
    with pytest.raises(InputError, match="cannot be read: MemoryError; is it truncated"):
        import_data(describe(file_of(tmp_path / "copy", "bag")), tmp_path / "out", jobs=1)
