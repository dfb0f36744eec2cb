"""A textured room, its reference, and recordings of it as files."""

import json
import shutil
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from benchmarks.guard.clips import FOCAL_PX, Clip, Displacement, Disturbances, Room, as_recorded
from calibration.addons.guard.features import REFERENCE_FILE, KeptCamera, Reference
from calibration.addons.guard.fixed_check import kept_camera
from calibration.engine.geometry.cameras import Camera
from calibration.robot.labelling.detection import Image

BASELINE = Path(__file__).parents[3] / "calibration-baseline.json"
DATA = "0" * 64
SECONDS, CHANGE = 3.0, 1.5
CAMERA = Camera(FOCAL_PX, FOCAL_PX, 319.5, 239.5, 640, 480)
"""That of t2rgb."""
STILL = Displacement()


@cache
def room() -> Room:
    """Return the room."""
    return Room.drawn(np.random.default_rng(3), CAMERA)


@cache
def clip(moved: Displacement = STILL, since: float | None = None, seed: int = 1) -> tuple[Image, ...]:
    """Return the images of 3 s, which are 0.5 s apart."""
    return tuple(Clip(room(), moved, since, SECONDS, Disturbances(), seed).images())


@cache
def reference() -> KeptCamera:
    """Return the reference of the room."""
    images = list(Clip(room(), Displacement(), None, 3.0, Disturbances(moved_objects=0), 9).images())
    return kept_camera("robot", "left_camera", CAMERA, as_recorded(images), DATA)


def folder_of_images(folder: Path, images: Sequence[Image]) -> Path:
    """Write images into a folder."""
    folder.mkdir(parents=True)
    for i, image in enumerate(images):
        cv2.imwrite(str(folder / f"{i:04d}.png"), image)
    return folder


def accepted_in(folder: Path) -> Path:
    """Write the accepted calibration of t2rgb into a folder, and the reference of its left camera."""
    shutil.copy(BASELINE, folder)
    data = json.loads(BASELINE.read_text())["systems"]["t2rgb"]["data"]
    document = json.loads(Reference(1, (reference(),)).text)
    document["cameras"][0] |= {"system": "t2rgb", "data": data}
    (folder / REFERENCE_FILE).write_text(json.dumps(document))
    return folder
