"""Errors of the corners that a detector finds in rendered images, by focus, light, motion and size."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import cv2
import numpy as np

from benchmarks.recording.curve import Curve
from benchmarks.room import LARGE, PATTERN, ROOM, T_WORLD_CAMERA, poses
from calibration.base.arrays import Array
from calibration.ci.execution.tasks import Embedded
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import apply
from calibration.robot.labelling.corner_detector import corner_detector
from calibration.robot.labelling.detection import NotDetected
from calibration.robot.simulation.kinematics import stream
from calibration.robot.simulation.rendering.image import radiance
from calibration.robot.simulation.scene import Board
from calibration.robot.simulation.sensors import SimulatedCamera

MIN_SHARE_FOUND = 0.5
"""Share of the corners in view below which an image counts as lost."""

Optics = Callable[[float], tuple[SimulatedCamera, float]]
"""From the property to the camera and the length of the motion while exposed, px."""


def curves(views: int) -> list[Curve]:
    """Measure each curve with this many images a point."""

    def measured(
        name: str, title: str, of: str, x: Sequence[float], recommended: tuple[float, float], optics: Optics
    ) -> Curve:
        y = [_corner_error_px(*optics(each), views) for each in x]
        return Curve(name, title, of, "error of a corner, px", x, y, recommended)

    camera = SimulatedCamera(LARGE.camera())
    return [
        measured(
            "focus",
            "Focus",
            "blur (standard deviation), px",
            (0.3, 0.65, 1, 1.5, 2, 3, 4, 5),
            (0.3, 1.5),
            lambda x: (replace(camera, blur=x), 0.0),
        ),
        measured(
            "exposure",
            "Exposure",
            "light, of a white that is just not saturated",
            (0.03, 0.06, 0.125, 0.25, 0.5, 0.75, 1, 1.5, 2),
            (0.25, 1),
            lambda x: (replace(camera, exposure=x), 0.0),
        ),
        measured(
            "standstill",
            "Standstill",
            "motion while exposed, px",
            (0, 1, 2, 4, 6, 8, 12),
            (0, 2),
            lambda x: (camera, x),
        ),
        measured(
            "square",
            "Size of a square",
            "width of a square in the image, px",
            (8, 10, 12, 16, 20, 30, 40),
            (20, 40),
            lambda x: (replace(camera, camera=_with_squares_of(x)), 0.0),
        ),
    ]


def _with_squares_of(pixels: float) -> Camera:
    """Return a camera whose images show the squares, 1.5 m away, this wide."""
    camera = LARGE.camera()
    focal = pixels / PATTERN.size * 1.5
    return replace(camera, fx=focal, fy=focal)


def _corner_error_px(camera: SimulatedCamera, motion: float, views: int) -> float:
    """Return the root mean square of the corners' errors, px; infinite where half of the images are lost."""
    detector, seen = corner_detector(PATTERN), poses(views)
    truth = [camera.camera.project(apply(T, PATTERN.pattern().corners)) for T in seen]

    def errors(number: int) -> Array:
        board = Board(PATTERN, PATTERN.pattern(), T_WORLD_CAMERA @ seen[number])
        light = _smeared(radiance(camera.camera, T_WORLD_CAMERA, replace(ROOM, boxes=ROOM.boxes[:1]), [board]), motion)
        found = detector.detect(camera.expose(light, stream(1, number)))
        inside = int(camera.camera.contains(truth[number]).sum())
        if isinstance(found, NotDetected) or len(found.ids) < MIN_SHARE_FOUND * inside:
            return np.zeros((0, 2))
        return found.pixels - truth[number][found.ids]

    parts = [part for _, part in Embedded().run([partial(errors, n) for n in range(views)], workers=2)]
    if sum(len(part) > 0 for part in parts) < views / 2:
        return float("inf")
    return float(np.sqrt((np.concatenate(parts) ** 2).mean()))


def _smeared(light: np.ndarray, pixels: float) -> np.ndarray:
    """Return the light of an image that has moved by some pixels to the right, about the middle of its exposure."""
    if not pixels:
        return light
    steps = np.linspace(-0.5, 0.5, 2 * int(np.ceil(pixels)) + 1) * pixels
    size = light.shape[1], light.shape[0]
    shifted = [
        cv2.warpAffine(
            light.astype(np.float32), np.array([[1, 0, s], [0, 1, 0]]), size, borderMode=cv2.BORDER_REPLICATE
        )
        for s in steps
    ]
    return np.asarray(np.mean(shifted, 0).round(), light.dtype)
