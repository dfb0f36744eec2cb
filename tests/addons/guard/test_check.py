"""``accept --reference`` and ``check``: from a recording to an exit code, and what is wrong with recordings."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.guard.clips import Displacement
from calibration.__main__ import main
from calibration.addons.guard.features import REFERENCE_FILE, read_reference
from calibration.base import InputError
from tests.addons.guard.recorded import CHANGE, accepted_in, clip, folder_of_images
from tests.robot.importing.bags import BEGIN, SECOND, BagFile
from tests.thorough import thorough

ROOT = Path(__file__).parents[3]
CONFIGURATION = "systems: {t2rgb: {dataset: robot, evaluate: rgb-to-rgb:left_camera:right_camera}}\n"
TURNED = Displacement((0.0, 0.3, 0.0))


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a repository with an accepted calibration of t2rgb, and a reference of its left camera."""
    monkeypatch.chdir(tmp_path)
    return accepted_in(tmp_path)


def check(*arguments: str) -> int:
    return int(main(["check", *arguments, "--rate", "2", "--output", "output"]))


def outcomes() -> dict[str, str]:
    found = json.loads(Path("output/results.json").read_text())
    return {each["sensor"]: each["outcome"] for each in found["systems"]["t2rgb"]}


def test_a_good_night_is_green_and_a_turned_camera_red_with_its_moment(
    repository: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder_of_images(repository / "good", clip())
    assert check("good") == 0
    assert outcomes() == {"left_camera": "unmoved"}
    assert capsys.readouterr().out.splitlines()[-1].startswith("pass: 1 unmoved of 1 sensor")

    folder_of_images(repository / "knocked", clip(TURNED, CHANGE))
    assert check("left_camera=knocked") == 1
    [found] = json.loads(Path("output/results.json").read_text())["systems"]["t2rgb"]
    assert (found["outcome"], found["since"]) == ("moved", CHANGE)
    assert found["rotation_deg"][1] == pytest.approx(0.3, abs=0.02)
    assert "about y (to the right)" in capsys.readouterr().out
    assert '<testcase name="left_camera"' in Path("output/junit.xml").read_text()


def test_what_cannot_be_told_is_red_unless_it_may_pass(repository: Path) -> None:
    folder_of_images(repository / "night", [np.zeros((480, 640), np.uint8)] * 4)
    assert check("night") == 1
    assert outcomes() == {"left_camera": "cannot-tell"}
    assert check("night", "--undecided", "pass") == 0


def test_accept_keeps_a_reference_that_check_takes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot").mkdir()
    shutil.copy(ROOT / "datasets" / "t2rgb" / "dataset.json", "robot")
    Path("calibration.yml").write_text(CONFIGURATION)
    folder_of_images(tmp_path / "moving", clip(TURNED, CHANGE))
    folder_of_images(tmp_path / "still", clip())
    assert main(["run"]) == 0

    assert main(["accept", "--reference", "left_camera=moving"]) == 2
    assert "has no reference in it: " in capsys.readouterr().err
    assert not Path("calibration-baseline.json").exists()

    assert main(["accept", "--reference", "left_camera=still"]) == 0
    assert f"{REFERENCE_FILE} is written: commit it" in capsys.readouterr().out
    assert Path(REFERENCE_FILE).stat().st_size < 150_000
    kept = read_reference(Path(REFERENCE_FILE))
    assert kept is not None
    assert [(each.system, each.sensor, each.width) for each in kept.cameras] == [("t2rgb", "left_camera", 640)]
    assert check("left_camera=still") == 0


@pytest.mark.parametrize("kind", ["mcap", thorough("bag")])
def test_a_bag_is_found_by_its_topic_and_its_clock_must_not_jump(
    repository: Path, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_bag(repository / f"good.{kind}", kind, jump=0)
    assert check(path) == 0
    path = write_bag(repository / f"jump.{kind}", kind, jump=3600 * SECOND)
    assert check(path) == 2
    assert "the stamps jump by" in capsys.readouterr().err


def write_bag(path: Path, kind: str, jump: int) -> str:
    with BagFile(path, kind) as bag:  # type: ignore[arg-type]
        for i, image in enumerate(clip()):
            stamp = BEGIN + i * SECOND // 2 + (jump if i > 2 else 0)
            late = 3_000_000 - (jump if i > 2 else 0)
            bag.image("/left_camera/image_raw", stamp, np.stack([image] * 3, -1), "left", late=late)
    return str(path if path.is_file() else next(path.glob(f"*.{kind}")))


def _without_reference(folder: Path) -> str:
    (folder / REFERENCE_FILE).unlink()
    return "good"


def _without_baseline(folder: Path) -> str:
    (folder / "calibration-baseline.json").unlink()
    return "good"


def _accepted_anew(folder: Path) -> str:
    change_reference(folder, data="1" * 64)
    return "good"


def _other_size(folder: Path) -> str:
    folder_of_images(folder / "small", [image[::2, ::2] for image in clip()])
    return "small"


def _truncated_video(folder: Path) -> str:
    writer = cv2.VideoWriter(str(folder / "whole.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 2.0, (640, 480))
    for image in clip():
        writer.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    writer.release()
    (folder / "cut.avi").write_bytes((folder / "whole.avi").read_bytes()[:300])
    return "cut.avi"


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (_without_reference, f"{REFERENCE_FILE}: found no reference of a camera"),
        (_without_baseline, "calibration-baseline.json: found no such file"),
        (_accepted_anew, "'left_camera' of 't2rgb' has been accepted anew since"),
        (_other_size, "found images of 320 x 240 pixels, expected 640 x 480"),
        (_truncated_video, "cut.avi: "),
        (lambda _: "nowhere.bag", "nowhere.bag: found no such file"),
        (lambda _: "right_camera=good", "found no images of 'left_camera', only of right_camera"),
    ],
    ids=["no-reference", "no-baseline", "accepted-anew", "other-size", "truncated", "no-file", "other-sensor"],
)
def test_what_is_wrong_is_said_in_a_line(
    repository: Path, wrong: Callable[[Path], str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    folder_of_images(repository / "good", clip()[:1])
    recording = wrong(repository)
    if recording == "right_camera=good":
        change_reference(repository, place="elsewhere")
        second = json.loads((repository / REFERENCE_FILE).read_text())
        second["cameras"].append(second["cameras"][0] | {"sensor": "other"})
        (repository / REFERENCE_FILE).write_text(json.dumps(second))
    assert check(recording) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert said in line
    assert not Path("output/results.json").exists()


def change_reference(folder: Path, **changes: object) -> None:
    document = json.loads((folder / REFERENCE_FILE).read_text())
    document["cameras"][0] |= changes
    (folder / REFERENCE_FILE).write_text(json.dumps(document))


@pytest.mark.parametrize(
    "changes",
    [
        {"pixels": "!"},
        {"pixels": "AAAA"},
        {"pixels": "AADAfwAAwH8="},
        {"descriptors": ""},
        {"intrinsics": [500, 500, 320]},
        {"intrinsics": [0, 500, 320, 240, 0, 0, 0, 0, 0]},
        {"width": 0},
        {"pixels": "A" * 1_000_000},
    ],
    ids=["no-base64", "half-a-number", "nan", "no-descriptors", "few", "no-focal-length", "no-width", "huge"],
)
def test_a_damaged_reference_is_refused(repository: Path, changes: dict[str, object]) -> None:
    change_reference(repository, **changes)
    with pytest.raises(InputError, match=rf"{REFERENCE_FILE}: cameras.0.{next(iter(changes))}"):
        read_reference(repository / REFERENCE_FILE)


def test_a_reference_behind_a_link_is_refused(repository: Path) -> None:
    (repository / "link.json").symlink_to(REFERENCE_FILE)
    with pytest.raises(InputError, match="symbolic link"):
        read_reference(repository / "link.json")
