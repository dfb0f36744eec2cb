"""Videos as the images of cameras: the moments at standstill, the chosen ones, and files that are none."""

import json
import stat
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from calibration.base import InputError
from calibration.engine.dataset.reading import read_dataset
from calibration.robot.importing.files import confined_decoding
from calibration.robot.importing.importing import import_data
from calibration.robot.importing.videos import decoded_frames
from tests.robot.importing.conftest import BOARD, CAMERAS, DATASETS, camera_info

POSES, HELD, RATE = 3, 4, 10
"""Poses of the board, frames of each, and frames a second."""


def write_video(path: Path, images: list[np.ndarray[Any, Any]]) -> Path:
    codec = "MJPG" if path.suffix == ".avi" else "mp4v"
    height, width = images[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), RATE, (width, height))
    for image in images:
        writer.write(image)
    writer.release()
    return path


def recorded(folder: Path, suffix: str, **videos: Any) -> Path:
    """The import.yml of t2rgb's cameras as videos in which the board stands still at each pose."""
    for camera in CAMERAS:
        shown = [cv2.imread(str(DATASETS / "t2rgb" / f"{camera}_{i:03d}.jpg")) for i in range(POSES)]
        write_video(folder / f"{camera}{suffix}", [np.asarray(image) for image in shown for _ in range(HELD)])
    (folder / "camera.yaml").write_text(yaml.safe_dump(camera_info()))
    document: dict[str, Any] = {
        "sensors": {camera: {"images": f"{camera}{suffix}", "intrinsics": "camera.yaml"} for camera in CAMERAS},
        "patterns": {"board": BOARD},
    }
    (folder / "import.yml").write_text(json.dumps({**document, **({"videos": videos} if videos else {})}))
    return folder / "import.yml"


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("suffix", [".avi", ".mp4"])
def test_each_standstill_is_a_collection(tmp_path: Path, suffix: str) -> None:
    results = import_data(recorded(tmp_path, suffix), tmp_path / "out", jobs=1)
    assert results.collections == POSES
    dataset = read_dataset(tmp_path / "out")
    assert len(dataset.keys) == POSES
    assert results.lag_ms == 0
    written = sorted(path.name for path in (tmp_path / "out").glob("left_camera_*"))
    assert len(written) == POSES
    shown = cv2.imread(str(tmp_path / "out" / written[1]))
    original = cv2.imread(str(DATASETS / "t2rgb" / "left_camera_001.jpg"))
    assert shown is not None
    assert original is not None
    assert np.abs(shown.astype(float) - original).mean() < 5


@pytest.mark.thorough
def test_moments_by_time_and_by_number(tmp_path: Path) -> None:
    """A moment each 0.6 s of a video of 1.2, and only every third frame searched."""
    results = import_data(recorded(tmp_path, ".avi", every=0.6, step=3), tmp_path / "out", jobs=1)
    assert results.collections == 2
    (tmp_path / "times.txt").write_text("0.3\n0.7\n1.0\n")
    results = import_data(recorded(tmp_path, ".avi", at="times.txt", step=3), tmp_path / "at", jobs=1)
    assert results.collections == 3


@pytest.mark.thorough
def test_stamps_shift_a_video(tmp_path: Path) -> None:
    """The right camera's clock is 0.05 s ahead, and that of the left one in nanoseconds."""
    config = recorded(tmp_path, ".avi")
    document = json.loads(config.read_text())
    begin = 1_700_000_000
    for camera, lines in zip(
        CAMERAS,
        (
            [f"{begin * 10**9 + i * 10**8}" for i in range(POSES * HELD)],
            [f"{begin + i / RATE + 0.05:.3f}" for i in range(POSES * HELD)],
        ),
        strict=True,
    ):
        (tmp_path / f"{camera}.txt").write_text("\n".join(lines))
        document["sensors"][camera]["stamps"] = f"{camera}.txt"
    config.write_text(json.dumps(document))
    results = import_data(config, tmp_path / "out", jobs=1)
    assert results.collections == POSES
    assert results.lag_ms == pytest.approx(50, abs=1)
    (tmp_path / "left_camera.txt").write_text("1\n2\n")
    with pytest.raises(InputError, match=r"left_camera\.txt: found 2 times, expected 12"):
        import_data(config, tmp_path / "again", jobs=1)
    (tmp_path / "left_camera.txt").write_text("1\n0.5\n")
    with pytest.raises(InputError, match=r"left_camera\.txt:2: found '0\.5' after a later time"):
        import_data(config, tmp_path / "again", jobs=1)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "it is no mp4"),
        (b"no video at all", "it is no mp4"),
        (b"#EXTM3U\n#EXTINF:1,\nfile:///etc/passwd\n#EXT-X-ENDLIST\n", "it is no mp4"),
        (b"ffconcat version 1.0\nfile 'other.avi'\n", "it is no mp4"),
    ],
)
def test_what_is_no_video_is_one_line(tmp_path: Path, content: bytes, message: str) -> None:
    write_video(tmp_path / "other.avi", [np.zeros((48, 64, 3), np.uint8)] * 3)
    (tmp_path / "a.mp4").write_bytes(content)
    with pytest.raises(InputError, match=message) as error:
        list(decoded_frames(tmp_path / "a.mp4", [0]))
    assert str(error.value).startswith(f"{tmp_path / 'a.mp4'}: ")
    assert "\n" not in str(error.value)


def test_a_container_of_matroska_has_the_times_of_its_frames(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mkv", [np.full((48, 64, 3), 40 * i, np.uint8) for i in range(5)])
    frames = list(decoded_frames(path, [1, 3]))
    assert [round(frame.time) for frame in frames] == [0, 100, 200, 300, 400]
    shades = {frame.index: frame.image.mean() for frame in frames if frame.image is not None}
    assert shades == {1: pytest.approx(40, abs=3), 3: pytest.approx(120, abs=3)}


def test_a_missing_video(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file, expected a video"):
        list(decoded_frames(tmp_path / "a.mp4", [0]))


def test_frames_that_are_too_large_are_not_decoded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_video(tmp_path / "a.avi", [np.zeros((48, 64, 3), np.uint8)])
    monkeypatch.setattr("calibration.robot.importing.videos.MAX_FRAME_PIXELS", 1000)
    with pytest.raises(InputError, match="frames of 64 x 48 pixels, expected 1000 at most"):
        list(decoded_frames(path, [0]))


def test_decoding_that_stalls_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    silent = tmp_path / "silent"
    silent.write_text("#!/bin/sh\nexec sleep 1000\n")
    silent.chmod(silent.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setattr(confined_decoding.sys, "executable", str(silent))
    monkeypatch.setattr(confined_decoding, "MAX_STALLED_SECONDS", 0.2)
    path = write_video(tmp_path / "a.avi", [np.zeros((48, 64, 3), np.uint8)])
    with pytest.raises(InputError, match="decoding it stalls"):
        list(decoded_frames(path, [0]))


def test_decoding_that_takes_too_long_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    busy = (
        "confined_decoding._DECODER_OF_KIND = {'video': lambda: lambda *_: max(iter(int, 1))}; confined_decoding.main()"
    )
    child = (
        "import sys; sys.path.insert(0, sys.argv.pop(1)); "
        f"from calibration.robot.importing.files import confined_decoding; {busy}"
    )
    monkeypatch.setattr(confined_decoding, "_CHILD_CODE", child)
    monkeypatch.setattr(confined_decoding, "CPU_SECONDS", 1)
    (tmp_path / "a.mp4").write_bytes(b"0")
    with pytest.raises(InputError, match=r"a\.mp4: a video was expected, but decoding it takes more than 1 s: cut it"):
        list(decoded_frames(tmp_path / "a.mp4", ()))


def test_a_video_stands_beside_videos_only(tmp_path: Path) -> None:
    config = recorded(tmp_path, ".avi")
    document = json.loads(config.read_text())
    for change, message in (
        ({"images": "left"}, "'left_camera': expected a video as its 'images'"),
        ({"stamps": "a.txt", "images": "left"}, "'left_camera': found 'stamps', expected a video"),
    ):
        sensors = {**document["sensors"], "left_camera": change}
        config.write_text(json.dumps({**document, "sensors": sensors}))
        with pytest.raises(InputError, match=message):
            import_data(config, tmp_path / "out", jobs=1)
