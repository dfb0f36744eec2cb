"""Images that arrive: which are used, what is waited for, what goes on, and how it ends."""

import json
import os
import shutil
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.__main__ import main
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.model import CornerLabels
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.geometry.rotations import to_quaternion
from calibration.engine.geometry.transforms import apply, from_xyz_rpy
from calibration.pipeline.watching import WatchedRecording
from calibration.robot.importing.arrivals import Arrivals
from calibration.robot.importing.look import judging
from calibration.robot.importing.look.judging import tilt_of
from tests.robot.importing.bags import BEGIN, SECOND, BagFile, Kind
from tests.robot.importing.conftest import BOARD as PRINTED
from tests.robot.importing.conftest import CAMERAS, DATASETS, FOCAL, camera_info, change
from tests.robot.importing.test_bags import FRAMES

BOARD = PatternConfiguration(
    "board", "charuco", "b", "w", False, (11, 8), 0.06, 0.045, (0, 0), "DICT_5X5_100"
).pattern()


def names_of(arrivals: Arrivals) -> list[str]:
    return [each.path.name for each in arrivals.poll()]


def lines_of(recording: WatchedRecording) -> list[str]:
    """What is said of what has arrived: it is taken at the second look."""
    return [*recording.next_lines(), *recording.next_lines()]


def only_first(folder: Path) -> WatchedRecording:
    """A recording with one image of one camera."""
    for number in range(1, 6):
        (folder / "left_camera" / f"{number}.jpg").rename(folder / f"{number}.jpg")
    shutil.rmtree(folder / "right_camera")
    change(folder, "sensors", "right_camera", to=None)
    recording = WatchedRecording(folder, Limits(), folder)
    assert ": used: " in lines_of(recording)[0]
    return recording


def test_a_file_is_taken_once_when_it_is_written(tmp_path: Path) -> None:
    arrivals = Arrivals({"left": str(tmp_path)})
    file, started = tmp_path / "a.png", tmp_path / "b.png"
    file.write_bytes(b"1")
    started.touch()
    (tmp_path / "notes.txt").write_text("no image")
    (tmp_path / "folder.png").mkdir()
    assert names_of(arrivals) == []
    file.write_bytes(b"12")
    assert names_of(arrivals) == []
    assert names_of(arrivals) == ["a.png"]
    assert names_of(arrivals) == []


def test_a_refused_file_is_taken_again_once_it_is_changed(tmp_path: Path) -> None:
    arrivals = Arrivals({"left": str(tmp_path / "*.png")})
    file = tmp_path / "a.png"
    file.write_bytes(b"1")
    found = arrivals.poll() + arrivals.poll()
    arrivals.refuse(found[0])
    assert arrivals.poll() == []
    file.write_bytes(b"12")
    assert arrivals.poll() == []
    assert names_of(arrivals) == ["a.png"]


def test_a_folder_that_vanishes_is_waited_for(tmp_path: Path) -> None:
    folder = tmp_path / "left"
    folder.mkdir()
    arrivals = Arrivals({"left": str(folder)})
    (folder / "a.png").write_bytes(b"1")
    arrivals.poll()
    (arrival,) = arrivals.poll()
    folder.rename(tmp_path / "gone")
    assert arrivals.is_gone(arrival)
    assert arrivals.poll() == []
    assert str(folder) in arrivals.faults["left"]
    (tmp_path / "gone").rename(folder)
    arrivals.poll()
    assert names_of(arrivals) == ["a.png"]
    assert not arrivals.faults


def test_tilt_by_foreshortening() -> None:
    """Of a pinhole camera, to a few degrees; corners in one line tell nothing."""
    ids = np.arange(len(BOARD.corners))
    for tilt in (0.0, 30.0, 60.0):
        points = apply(from_xyz_rpy([0, 0, 3], [np.radians(tilt), 0, 0.4]), BOARD.corners - BOARD.centre)
        pixels = 600 * points[:, :2] / points[:, 2:]
        assert tilt_of(BOARD, CornerLabels(ids, pixels)) == pytest.approx(tilt, abs=8)
    assert tilt_of(BOARD, CornerLabels(ids[:11], pixels[:11])) == 90


@pytest.mark.parametrize(
    ("kind", "edit"),
    [
        ("same as before", lambda image: np.roll(image, 2, axis=1)),
        ("blurred", lambda image: cv2.GaussianBlur(image, (0, 0), 1.7)),
        ("too oblique", lambda image: image),
        ("other size", lambda image: image[:400]),
        ("no pattern", np.zeros_like),
    ],
)
def test_a_view_that_is_not_used(stereo: Path, monkeypatch: pytest.MonkeyPatch, kind: str, edit: object) -> None:
    assert callable(edit)
    recording = only_first(stereo)
    image = np.asarray(edit(cv2.imread(str(stereo / ("left_camera/0.jpg" if kind == "same as before" else "3.jpg")))))
    monkeypatch.setattr(judging, "MAX_TILT", 15 if kind == "too oblique" else 65)  # it is tilted by 21
    cv2.imwrite(str(stereo / "left_camera" / "new.png"), image)
    (line,) = lines_of(recording)
    assert line.startswith("left_camera new.png: not used: ")
    assert recording.judge.counts == {"": 1, kind: 1}


def test_one_that_is_no_image_and_later_is_one(stereo: Path) -> None:
    recording = only_first(stereo)
    late = stereo / "left_camera" / "late.jpg"
    late.write_bytes((stereo / "1.jpg").read_bytes()[:300])
    assert ": not used: " in lines_of(recording)[0]
    shutil.copy(stereo / "1.jpg", late)
    assert ": used: " in lines_of(recording)[0]
    assert recording.judge.counts == {"": 2}


def test_a_whole_recording(stereo: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Error bars, the next pose, the page, and a dataset of the used views."""
    (stereo / "left_camera" / "99.png").write_bytes(b"no image")
    out = stereo / "out"
    arguments = ["watch", str(stereo), "--translation-mm", "2", "--idle", "0.3", "--output", str(out)]
    assert main(arguments) == 0
    said = capsys.readouterr().out
    assert said.count(": used: ") == 12
    assert "99.png: not used: " in said
    assert "6 collections: right_camera" in said
    assert "next: 1. hold the board" in said
    assert len(read_dataset(out).collections) == 6
    assert 'http-equiv="refresh"' in (stereo / "watch.html").read_text()
    assert main(arguments) == 2
    assert main(["calibrate-matrix", "--dataset", str(out), "--output", str(stereo / "cells")]) == 0


def test_ctrl_c_ends_with_a_summary(
    stereo: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stop(_: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(time, "sleep", stop)
    assert main(["watch", str(stereo / "import.yml")]) == 1
    assert "import-data --recordings" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("keys", "to"),
    [
        (("sensors", "left_camera", "images"), "nowhere"),
        (("sensors", "left_camera", "images"), "left.mp4"),
        (("sensors", "left_camera", "images"), None),
        (("patterns", "board"), {}),
        (("patterns",), None),
        (("bags",), {"files": ["a.bag"]}),
    ],
)
def test_what_cannot_be_watched(stereo: Path, keys: tuple[str, ...], to: object) -> None:
    change(stereo, *keys, to=to)
    assert main(["watch", str(stereo)]) == 2


@pytest.mark.parametrize("name", ["nowhere", ".", "import.txt"])
def test_no_description(tmp_path: Path, name: str) -> None:
    assert main(["watch", os.fspath(tmp_path / name)]) == 2


def test_an_arm_whose_poses_arrive_with_its_images(tmp_path: Path) -> None:
    """The samples are read again: more of them than at first."""
    arm = read_dataset(DATASETS / "riwbot")
    T = arm.transform("base_link", "flange")
    keys = arm.keys[:9]
    (tmp_path / "images").mkdir()
    (tmp_path / "camera.yaml").write_text(json.dumps(camera_info(1200, 800, 1039.230484541, (600.5, 400.5))))
    document = {
        "sensors": {"rgb_world": {"parent": "base_link", "images": "images", "intrinsics": "camera.yaml"}},
        "patterns": {
            "board": {
                "parent": "flange",
                "type": "charuco",
                "columns": 7,
                "rows": 7,
                "square": 0.02,
                "marker": 0.015,
                "dictionary": "DICT_4X4_100",
            }
        },
        "samples": {"file": "samples.csv", "base": "base_link", "tool": "flange"},
    }
    (tmp_path / "import.yml").write_text(json.dumps(document))

    def arrive(count: int) -> list[str]:
        rows = [",".join(map(str, [*T[i, :3, 3], *to_quaternion(T[i, :3, :3])])) for i in range(count)]
        (tmp_path / "samples.csv").write_text("\n".join(["x,y,z,qx,qy,qz,qw", *rows]))
        for key in keys[:count]:
            shutil.copy(DATASETS / "riwbot" / f"rgb_world_{key}.jpg", tmp_path / "images" / f"{key}.jpg")
        return lines_of(recording)

    recording = WatchedRecording(tmp_path, Limits(), tmp_path)
    assert "no calibration yet: " in arrive(2)[-1]
    assert any(line.startswith("9 collections: rgb_world") for line in arrive(9))


def split_bag(folder: Path, kind: Kind, poses: int, files: int) -> list[Path]:
    """Files of a bag of t2rgb's cameras, as a recorder splits it: an image of each a second."""
    dataset = read_dataset(DATASETS / "t2rgb")
    edges = {edge: T[0] for edge, T in dataset.transforms.items() if edge[1] != "pattern_link"}
    made = []
    for part, own in enumerate(np.array_split(np.arange(poses), files)):
        path = folder / (f"made_{part}.bag" if kind == "bag" else f"made_{part}")
        with BagFile(path, kind) as bag:
            if part == 0:
                bag.transforms("/tf_static", BEGIN, edges)
            for n in own.tolist():
                for camera in CAMERAS:
                    image, frame = cv2.imread(str(DATASETS / "t2rgb" / f"{camera}_{n:03d}.jpg")), FRAMES[camera]
                    bag.camera_info(f"/{camera}/camera_info", BEGIN + n * SECOND, frame, (640, 480), FOCAL)
                    bag.image(f"/{camera}/image_raw", BEGIN + n * SECOND, np.asarray(image), frame, "jpeg")
        made.append(path if kind == "bag" else next(path.glob(f"*.{kind}")))
    return made


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("kind", ["mcap", "db3", "bag"])
def test_a_bag_that_is_being_written(tmp_path: Path, kind: Kind) -> None:
    """Each of its files is read once it is finished; frames and intrinsics are the bag's."""
    first, second = split_bag(tmp_path, kind, 6, 2)
    folder = tmp_path / "recorded"
    (tmp_path / "import.yml").write_text(json.dumps({"bags": {"files": ["recorded"]}, "patterns": {"board": PRINTED}}))
    recording = WatchedRecording(tmp_path, Limits(translation_mm=2.0), tmp_path)
    assert ["waiting for it" in line for line in recording.next_lines()] == [True]
    folder.mkdir()
    shutil.copy(first, folder / first.name)
    written = folder / second.name
    written.write_bytes(second.read_bytes()[:5000])
    os.utime(written, (time.time() + 600,) * 2)  # it has just been written, however slow this machine is
    lines = list(recording.next_lines())
    assert [": used: " in line for line in lines[:6]] == [True] * 6
    assert len(lines) == 7
    assert "no calibration yet" in lines[-1]
    assert list(recording.next_lines()) == []
    shutil.copy(second, written)
    os.utime(written, (time.time() - 10,) * 2)
    lines = list(recording.next_lines())
    assert lines[0].startswith("left_camera 3.00s.png: used: ")
    assert any(line.startswith("6 collections: right_camera") for line in lines)
    assert any(line.startswith("next: 1. hold the board") for line in lines)
    assert list(recording.next_lines()) == []


def test_a_bag_without_the_topic_that_is_named(tmp_path: Path) -> None:
    """It is said, and no other camera is taken for it."""
    [file] = split_bag(tmp_path, "mcap", 1, 1)
    (tmp_path / "import.yml").write_text(
        json.dumps(
            {
                "bags": {"files": [str(file)]},
                "sensors": {"left": {"topic": "/lft/image_raw"}},
                "patterns": {"board": PRINTED},
            }
        )
    )
    os.utime(file, (time.time() - 10,) * 2)
    [line] = WatchedRecording(tmp_path, Limits(), tmp_path).next_lines()
    assert "found no topic '/lft/image_raw'" in line
