"""A recording of one camera before a moving pattern, as an import leaves it, from simulated corners."""

from pathlib import Path

import numpy as np

from calibration.engine.dataset.configuration import Configuration, PatternConfiguration, SensorConfiguration
from calibration.engine.dataset.model import CornerLabels
from calibration.engine.dataset.reading import FILE_NAME
from calibration.engine.dataset.writing import write_document
from calibration.engine.estimation.start.lens_choice import fitting_lens
from calibration.engine.geometry.cameras import Camera
from calibration.robot.importing.document import Imported, dataset_document
from calibration.robot.importing.image_views import FoundCorners, LabelledMoment, View
from tests.engine.estimation.systems import covering

LENS = Camera(600.0, 590.0, 640.0, 480.0, 1280, 960)


def one_camera(folder: Path, model: Camera = LENS, views: int = 25, seed: int = 0, noise: float = 0.15) -> Path:
    """Write a dataset without intrinsics, and return its folder."""
    scene = covering(views, seed, 1, model=model, pixel_noise=noise).dataset(seed)
    (truth,) = scene.patterns.values()
    corners = truth.corners[:, :2]
    columns = int((np.abs(corners[:, 1] - corners[0, 1]) < 1e-9).sum())
    size = float(np.linalg.norm(corners[1] - corners[0]))
    dimension = columns, len(corners) // columns
    board = PatternConfiguration("board", "chessboard", "board_link", "world", False, dimension, size)
    labels = [each for c in scene.collections for each in c.labels.values() if isinstance(each, CornerLabels)]
    found = [FoundCorners(tuple(each.ids.tolist()), tuple(each.pixels.ravel().tolist())) for each in labels]
    # Of the true model only: which one an import chooses is another room's matter, and takes a second.
    choice = fitting_lens(
        "camera", model.width, model.height, [(truth, each) for each in labels], (type(model.distortion),)
    )
    assert choice is not None
    sensor = SensorConfiguration("camera", "rgb", "camera_optical_frame", "world", "camera_optical_frame")
    moments = [
        LabelledMoment({"camera": View(f"{i}.png", model.width, model.height, {"board": each})})
        for i, each in enumerate(found)
    ]
    imported = Imported(
        robot="camera",
        configuration=Configuration(
            world_link="world", sensors={"camera": sensor}, patterns={"board": board}, anchored_sensor="camera"
        ),
        cameras={"camera": choice.guess},
        estimated={"camera": choice.reason},
        moments=moments,
        ranges=[{} for _ in moments],
        transforms={("world", "camera_optical_frame"): np.broadcast_to(np.eye(4), (len(moments), 4, 4))},
        rough=True,
    )
    folder.mkdir(parents=True)
    write_document(dataset_document(imported), folder / FILE_NAME)
    return folder
