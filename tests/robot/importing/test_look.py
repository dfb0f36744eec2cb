"""A look at a recording names what it lacks for a calibration, and nothing where it lacks nothing."""

import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from calibration.__main__ import main
from calibration.robot.importing.look.images import blur_of
from calibration.robot.importing.look.looking import look
from calibration.robot.importing.results import LookResults
from tests.robot.importing.arm import keys, record_arm
from tests.robot.importing.bags import BEGIN, SECOND, BagFile
from tests.robot.importing.conftest import BOARD, CAMERAS, FOCAL, change
from tests.robot.importing.test_bags import KINDS, describe, file_of, image, record
from tests.robot.importing.test_kinds_of_patterns import views_of
from tests.robot.importing.test_videos import write_video

Change = Callable[[np.ndarray[Any, Any]], np.ndarray[Any, Any]]
POSES = 10


def needed(results: LookResults) -> str:
    return "\n".join(str(each) for each in results.missing if each.is_needed)


def one_camera(folder: Path, edit: Change = lambda shown: shown, poses: int = POSES, period: float = 1.0) -> Path:
    """A bag of one camera and its frame; each image is changed."""
    path = file_of(folder, "mcap")
    with BagFile(path, "mcap") as bag:
        bag.transforms("/tf_static", BEGIN, {("world", "left"): np.eye(4)})
        for n in range(poses):
            stamp = BEGIN + int(n * period * SECOND)
            bag.camera_info("/left/camera_info", stamp, "left", (640, 480), FOCAL)
            bag.image("/left/image_raw", stamp, edit(image("left_camera", n)), "left")
    return path


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_is_missing_in_a_good_bag(tmp_path: Path, kind: Any) -> None:
    results = look(record(tmp_path, kind, poses=POSES))
    assert needed(results) == ""
    assert results.pattern is not None
    assert "DICT_5X5" in results.pattern
    topic = results.topics["/left_camera/image_raw"]
    assert (topic.messages, topic.rate_hz, topic.largest_gap_s) == (POSES, 1.0, 1.0)
    assert results.frames is not None
    assert results.frames.roots == ("world",)
    for name in CAMERAS:
        camera = results.cameras[name]
        assert (camera.width, camera.height, camera.with_pattern) == (640, 480, POSES)
        assert camera.intrinsics.startswith("640 x 480, PlumbBob, f 554")
        assert camera.saturated < 0.1


def test_the_stays_of_an_arm_are_counted(tmp_path: Path) -> None:
    poses = keys()[:POSES]
    record_arm(tmp_path / "good.bag", "bag", poses)
    good = look(tmp_path / "good.bag")
    assert good.frames is not None
    assert good.frames.stays == POSES
    assert good.frames.robot_description == "read"
    assert "joint" in "".join(good.frames.joints)
    assert needed(good) == ""
    record_arm(tmp_path / "moving.bag", "bag", poses, moving=range(1, POSES))
    assert "stands still 1 times" in needed(look(tmp_path / "moving.bag"))


def test_a_long_stay_is_one_and_a_wheel_does_not_matter(tmp_path: Path) -> None:
    """Three stays of a second, and between them two seconds without frames; the camera is mounted on what moves."""
    path = file_of(tmp_path, "mcap")
    with BagFile(path, "mcap") as bag:
        for tenth in range(50):
            stamp, pose = BEGIN + tenth * SECOND // 10, tenth // 10
            T = np.eye(4)
            T[0, 3] = float(pose)
            if pose not in (1, 2):
                bag.transforms("/tf", stamp, {("world", "left"): T})
            T[0, 3] = tenth / 10
            bag.transforms("/tf", stamp, {("world", "wheel"): T})
            bag.image("/left/image_raw", stamp, image("left_camera", 0)[::4, ::4], "left", "mono8")
    frames = look(path).frames
    assert frames is not None
    assert frames.stays == 3
    assert set(frames.moving) == {"left", "wheel"}


def test_what_drivers_leave_out_is_named(tmp_path: Path) -> None:
    no_info = needed(look(record(tmp_path, "bag", poses=POSES, info=False)))
    assert all(f"no camera_info of '{camera}'" in no_info for camera in CAMERAS)
    path = file_of(tmp_path, "mcap")
    with BagFile(path, "mcap") as bag:
        bag.text("/chatter", BEGIN, "hello")
    assert "no topic of images" in needed(look(path))


def test_one_camera_without_frames_needs_them(tmp_path: Path) -> None:
    path, K = file_of(tmp_path, "mcap"), np.array([FOCAL, 0, 900, 0, FOCAL, 240, 0, 0, 1])
    with BagFile(path, "mcap") as bag:
        bag.text("/robot_description", BEGIN, "<robot")
        for n in range(POSES):
            stamp = BEGIN + n * SECOND
            bag.camera_info("/left/camera_info", stamp, "left", (640, 480), FOCAL, k=K)
            bag.image("/left/image_raw", stamp, image("left_camera", n), "left", "mono8")
    found = look(path)
    assert "no frames (robot_description: " in needed(found)
    assert "principal point" in needed(found)


def test_a_video_in_compressed_images_says_what_to_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    path = file_of(tmp_path, "mcap")
    with BagFile(path, "mcap") as bag:
        data, header = np.zeros(9, np.uint8), bag.header("left", BEGIN)
        message = bag.make("sensor_msgs/msg/CompressedImage", header=header, format="h264", data=data)
        bag.write("/left/h264", BEGIN, message)
    assert "'left' cannot be read: " in needed(look(path))


def _left_half(shown: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """The image a third as large, in the top left corner."""
    small = np.zeros_like(shown)
    small[:240, :320] = cv2.resize(shown, (320, 240), interpolation=cv2.INTER_AREA)
    return small


@pytest.mark.thorough(but_first=2)
@pytest.mark.parametrize(
    ("edit", "expected"),
    [
        (lambda shown: cv2.GaussianBlur(shown, (0, 0), 2.5), "is blurred by 2."),
        (lambda shown: shown // 8, "is dark"),
        (lambda shown: np.clip(shown.astype(int) * 3, 0, 255).astype(np.uint8), "of saturated pixels"),
        (_left_half, "of 12 parts of its image"),
        (lambda shown: np.zeros_like(shown), "no known pattern is in any of 10 images"),
    ],
)
def test_bad_images_are_named(tmp_path: Path, edit: Change, expected: str) -> None:
    assert expected in needed(look(one_camera(tmp_path, edit)))


def test_good_images_are_not(tmp_path: Path) -> None:
    results = look(one_camera(tmp_path))
    assert needed(results) == ""
    assert results.cameras["left"].blur_px is not None
    assert results.cameras["left"].blur_px < 1


def test_a_pattern_that_always_moves_is_named(tmp_path: Path) -> None:
    moving = needed(look(one_camera(tmp_path, poses=POSES, period=0.2)))
    assert "the pattern moves in 9 of 9 images of 'left'" in moving


def test_stamps_that_do_not_fit_are_named(tmp_path: Path) -> None:
    assert "are 0.40 s apart" in needed(look(record(tmp_path, "bag", poses=POSES, late=0.4)))
    assert "do not overlap" in needed(look(record(tmp_path, "mcap", poses=POSES, late=1000.0)))


@pytest.mark.parametrize("sigma", [0.7, 1.5, 3.0])
def test_blur_is_that_of_a_known_edge(sigma: float) -> None:
    ideal = np.full((200, 200), 40.0)
    ideal[:, 100:] = 200
    blurred = cv2.GaussianBlur(ideal, (0, 0), sigma)
    noisy = np.clip(blurred + np.random.default_rng(0).normal(0, 1, ideal.shape), 0, 255).astype(np.uint8)
    assert blur_of(noisy) == pytest.approx(sigma, rel=0.15)
    assert blur_of(np.full((50, 50), 9, np.uint8)) is None


def test_folders_of_images_and_an_import_yml(stereo: Path) -> None:
    folders = look(stereo)
    assert set(folders.cameras) == set(CAMERAS)
    assert folders.topics == {}
    assert "has 6 images, of 10 at least" in needed(folders)
    described = look(stereo / "import.yml")
    assert described.pattern == "board"
    assert described.cameras["left_camera"].intrinsics == "camera.yaml"
    assert look(stereo / "left_camera", stereo / "import.yml").pattern == "board"


def test_what_is_there_in_place_of_a_described_pattern_is_named(stereo: Path) -> None:
    change(stereo, "patterns", "board", "dictionary", to="DICT_4X4_100")
    missing = needed(look(stereo / "import.yml"))
    assert "(board) is not in any of 6 images of 'left_camera', but markers of DICT_5X5" in missing


def test_an_image_that_samples_name_and_is_gone_is_bad_input(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document = {"sensors": {"camera": {}}, "samples": {"file": "poses.csv"}, "patterns": {"board": BOARD}}
    (tmp_path / "import.yml").write_text(json.dumps(document))
    pose = "0,0,0,0,0,0,1"
    (tmp_path / "poses.csv").write_text(
        "image,x,y,z,qx,qy,qz,qw\n" + "".join(f"{n}.png,{n},{pose[2:]}\n" for n in range(3))
    )
    assert main(["look", str(tmp_path / "import.yml")]) == 2
    assert "0.png" in capsys.readouterr().err


@pytest.mark.parametrize(("columns", "rows"), [(9, 6), (12, 19)])
def test_a_chessboard_of_any_size_is_found(tmp_path: Path, columns: int, rows: int) -> None:
    board = np.kron((np.indices((rows + 1, columns + 1)).sum(0) % 2) * 180 + 40, np.ones((40, 40))).astype(np.uint8)
    shown = cv2.copyMakeBorder(board, 60, 60, 60, 60, cv2.BORDER_CONSTANT, value=220)
    turned = cv2.getRotationMatrix2D((shown.shape[1] / 2, shown.shape[0] / 2), 15, 0.6)
    cv2.imwrite(str(tmp_path / "0.png"), cv2.warpAffine(shown, turned, shown.shape[1::-1], borderValue=220))
    results = look(tmp_path)
    assert results.pattern == f"chessboard of {columns} x {rows} corners"
    assert results.cameras[tmp_path.name].with_pattern == 1


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("circles", "circles of 9 x 6"),
        ("asymmetric-circles", "asymmetric-circles of 4 x 11"),
        ("tags", "tags 7, 8, 30 of DICT_APRILTAG_36h11"),
        ("one tag", "tags 3 of DICT_4X4_50"),
    ],
)
def test_circles_and_tags_are_found_undescribed(kind: str, expected: str, tmp_path: Path) -> None:
    for i, shown in enumerate(views_of(kind, "left", count=4)):
        cv2.imwrite(str(tmp_path / f"{i}.png"), shown)
    results = look(tmp_path)
    assert results.pattern == expected
    assert results.cameras[tmp_path.name].with_pattern == 4


def test_clutter_is_no_pattern(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    for i in range(4):
        clutter = random.integers(0, 256, (48, 64), np.uint8)
        cv2.imwrite(str(tmp_path / f"{i}.png"), cv2.resize(clutter, (640, 480), interpolation=cv2.INTER_CUBIC))
    assert look(tmp_path).pattern is None


@pytest.mark.thorough
def test_a_long_video_is_looked_at_in_part(tmp_path: Path) -> None:
    video = write_video(tmp_path / "left.avi", [image("left_camera", n // 4) for n in range(40)])
    camera = look(video).cameras["left"]
    assert (camera.images, camera.looked_at) == (40, 24)
    assert 0 < camera.still <= camera.compared


@pytest.mark.parametrize("name", ["", "nothing.bag", "text.mcap", "cut.bag", "empty", "wrong.yml"])
def test_no_recording_is_bad_input(tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.mcap").write_text("no bag")
    (tmp_path / "wrong.yml").write_text("bags: 7")
    (tmp_path / "source").mkdir()
    whole = record(tmp_path / "source", "bag", poses=1)
    (tmp_path / "cut.bag").write_bytes(whole.read_bytes()[:5000])
    shutil.rmtree(tmp_path / "source")
    assert main(["look", str(tmp_path / name)]) == 2
    errors = capsys.readouterr().err.strip().splitlines()
    assert len(errors) == 1
    assert str(tmp_path) in errors[0]
    assert name or "cut.bag" in errors[0]


def test_the_command_writes_its_results(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good = record(tmp_path, "bag", poses=POSES)
    assert main(["look", str(good), "--output", str(tmp_path / "out")]) == 0
    document = json.loads((tmp_path / "out" / "results.json").read_text())
    assert (document["verdict"], document["reasons"]) == ("pass", [])
    assert document["cameras"]["left_camera"]["with_pattern"] == POSES
    assert "principal point" in (tmp_path / "out" / "summary.md").read_text()
    config = describe(record(tmp_path, "mcap", poses=POSES, info=False))
    assert main(["look", str(config)]) == 1
    assert "docs/recording.md" in capsys.readouterr().err


@pytest.mark.thorough
def test_the_real_arm_lacks_nothing() -> None:
    images = Path(__file__).resolve().parents[4] / "shared" / "data" / "real-arm" / "images"
    if not images.is_dir():
        pytest.skip("the images of a real arm are not here")
    results = look(images)
    assert needed(results) == ""
    assert results.cameras["images"].with_pattern == 16
