"""A bag of what the example's cameras see calibrates as the dataset that its robot saves of the same images."""

import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from example_robot.board import Board
from example_robot.dataset import DatasetFolder, View

from calibration.base.arrays import Array
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import inverse
from calibration.robot.importing.importing import import_data
from calibration.robot.simulation.capture import capture
from calibration.robot.simulation.record import pose_document
from tests.examples.ros1.conftest import EXAMPLE, Collected
from tests.examples.ros1.test_collecting import BOARD, CONFIG
from tests.robot.importing.bags import BEGIN, SECOND, BagFile

STAY, PERIOD = 6, SECOND // 10
"""Images of each camera at a pose, and the time between two, ns: as the example's simulation publishes them."""
CAMERAS = ("left_camera", "right_camera")


def info(bag: BagFile, stamp: int, frame: str, camera: Camera) -> object:
    """The camera_info that simulate.py publishes."""
    roi = bag.make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    return bag.make(
        "sensor_msgs/msg/CameraInfo",
        header=bag.header(frame, stamp),
        height=camera.height,
        width=camera.width,
        distortion_model="plumb_bob",
        D=camera.distortion.coefficients,
        K=camera.K.ravel(),
        R=np.eye(3).ravel(),
        P=np.zeros(12),
        binning_x=0,
        binning_y=0,
        roi=roi,
    )


def record(path: Path, collected: Collected, seen: list[Mapping[str, Array]]) -> None:
    """Write what the simulation publishes while the board is moved from pose to pose."""
    fixed = {edge: T[0] for edge, T in collected.play.nominal.transforms.items() if edge[1] != "pattern_link"}
    with BagFile(path, "bag") as bag:
        bag.transforms("/tf_static", BEGIN, fixed)
        for number, images in enumerate(seen):
            for i in range(STAY):
                stamp = BEGIN + number * SECOND + i * PERIOD
                for name in CAMERAS:
                    sensor = collected.dataset.sensors[name]
                    assert sensor.camera is not None
                    bag.write(f"/{name}/camera_info", stamp, info(bag, stamp, sensor.frame, sensor.camera))
                    bag.image(f"/{name}/image_raw", stamp, images[name], sensor.frame)


def save(folder: Path, collected: Collected, seen: list[Mapping[str, Array]]) -> None:
    """Save what the robot finds in the same images, as in a live run."""
    board, sensors = Board(BOARD), collected.dataset.document["sensors"]
    dataset = DatasetFolder(folder, CONFIG, board)
    for number, images in enumerate(seen):
        found = {name: board.detect(image) for name, image in images.items()}
        if any(each is None for each in found.values()):
            continue
        views = {}
        for name, image in images.items():
            message = {"height": 480, "width": 640, "encoding": "bgr8", "header": {"frame_id": f"{name}_optical"}}
            views[name] = View(image, message, sensors[name]["camera_info"], *found[name])
        transforms = {
            f"{parent}-{child}": pose_document((parent, child), T[number])
            for (parent, child), T in collected.play.nominal.transforms.items()
        }
        dataset.add(views, transforms)


def between(dataset: Dataset) -> Array:
    T: Array = dataset.transform("left_camera_optical", "right_camera_optical")[0]
    return T


@pytest.mark.thorough
def test_it_calibrates_as_the_live_run(collected: Collected, tmp_path: Path) -> None:
    seen = [capture(collected.play, number).data for number in range(len(collected.play))]
    record(tmp_path / "cells.bag", collected, seen)
    shutil.copy(EXAMPLE / "import.yml", tmp_path)
    import_data(tmp_path / "import.yml", tmp_path / "imported", jobs=1)
    save(tmp_path / "live", collected, seen)
    live, imported = read_dataset(tmp_path / "live"), read_dataset(tmp_path / "imported")
    assert len(imported.collections) >= len(live.collections)
    ours, theirs = calibrate(imported, Options()), calibrate(live, Options())
    apart = inverse(between(theirs.dataset)) @ between(ours.dataset)
    mm, mrad = 1e3 * np.linalg.norm(apart[:3, 3]), 1e3 * np.linalg.norm(rotations.log(apart[:3, :3]))
    (edge,) = ours.covariances
    assert mm < min(0.1 * theirs.sigma_mm(edge), theirs.label_sigma_mm(edge))
    assert mrad < min(0.1 * theirs.sigma_mrad(edge), theirs.label_sigma_mrad(edge))
