"""The nightly guard as a user runs it: a good recording is green, a turned camera red with moment and axis."""

import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import pytest
import yaml

from calibration.robot.labelling.detection import Image

from .conftest import PROJECT, Repository, calibration

pytest.importorskip("calibration.addons.guard")
NIGHTLY = PROJECT / "examples" / "guard" / "nightly.yml"
CONFIGURATION = "systems: {robot: {dataset: robot, evaluate: rgb-to-rgb:left_camera:right_camera}}\n"


def video(path: Path, images: Sequence[Image]) -> None:
    """Write images as a video of two a second."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 2.0, (640, 480), isColor=False)
    for image in images:
        writer.write(image)
    writer.release()


def steps_of_night(recording: Path) -> str:
    """Return the steps of the example after its checkout, with a recording and this Python."""
    _, step = yaml.safe_load(NIGHTLY.read_text())["jobs"]["guard"]["steps"]
    step["uses"] = step["uses"].replace("OWNER/calibration-ci", "me/suite")
    step["with"] |= {"recording": f"left_camera={recording}", "python": sys.executable}
    return yaml.safe_dump([step])


@pytest.mark.thorough
def test_a_camera_that_was_turned_is_red_the_night_after(repository: Repository, tmp_path: Path) -> None:
    from benchmarks.guard.clips import Displacement
    from tests.addons.guard.recorded import CHANGE, clip

    folder = repository.folder
    (folder / "robot").mkdir()
    shutil.copy(PROJECT / "datasets" / "t2rgb" / "dataset.json", folder / "robot")
    (folder / "calibration.yml").write_text(CONFIGURATION)
    video(tmp_path / "still.avi", clip(seed=2))
    video(tmp_path / "good.avi", clip())
    video(tmp_path / "knocked.avi", clip(Displacement((0.0, 0.3, 0.0)), CHANGE))
    calibration(folder, "run")
    calibration(folder, "accept", "--reference", f"left_camera={tmp_path / 'still.avi'}")
    shutil.rmtree(folder / "output")

    night = repository.push(steps_of_night(tmp_path / "good.avi"))
    assert night.code == 0, night.log
    assert "pass: 1 unmoved of 1 sensor" in night.log

    night = repository.push(steps_of_night(tmp_path / "knocked.avi"))
    assert night.code == 1, night.log
    [found] = night.annotations
    assert "left_camera: turned by 0.30 deg" in found
    assert f"about y (to the right), from {CHANGE} s on" in found
