"""AprilGrids in simulated images: how near the truth, how many corners, and whether any is another than it says.

``python -m benchmarks.aprilgrid --images 10000`` does as many images as asked.
"""

import argparse
import os
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache

import numpy as np

from benchmarks.rows import HEADER, Bar, Row
from calibration.base.arrays import Array
from calibration.engine.dataset.configuration import APRILGRID_TAGS, PatternConfiguration
from calibration.engine.dataset.model import CornerLabels
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import PlumbBob
from calibration.engine.geometry.transforms import apply, from_xyz_rpy, transform
from calibration.robot.labelling.board_image import shortest
from calibration.robot.labelling.corner_detector import corner_detector
from calibration.robot.labelling.detection import CornerDetector
from calibration.robot.simulation.kinematics import stream
from calibration.robot.simulation.scene import Board, Box, Scene
from calibration.robot.simulation.sensors import SimulatedCamera

GRID = PatternConfiguration(
    "grid", "aprilgrid", "grid", "world", False, (6, 6), 0.088, None, (0.03, 0.03), APRILGRID_TAGS, spacing=0.3
)
CAMERA = Camera(900.0, 900.0, 639.5, 359.5, 1280, 720, PlumbBob(-0.25, 0.08, 0.0008, -0.0005, 0.0))
T_WORLD_CAMERA = from_xyz_rpy([0.3, -0.2, 1.2], [-np.pi / 2, 0, -np.pi / 2])
WRONG = 2.0
"""A corner that lies farther from its place than that is another one, px; modules are wider in nearly all images."""
EDGE = 8.0
"""Corners nearer to the edge of the image need not be found, px."""
LEAST_TAG = 18.0
"""Nor those of tags that are narrower, px."""
IMAGES = 400


@dataclass(frozen=True, eq=False)
class Found:
    """Result of the detector on one image."""

    errors: Array
    """(K, 2): found less true, px."""
    shown: int
    """Corners that are on the image, large enough and not hidden."""
    seconds: float


def measure(quick: bool) -> Iterator[Row]:
    """Measure a few images; this module's own command measures more."""
    return rows(IMAGES // 10 if quick else IMAGES, os.cpu_count() or 1)


def rows(images: int, jobs: int, first: int = 0) -> Iterator[Row]:
    """Measure a number of images, from a first index."""
    with ProcessPoolExecutor(jobs) as pool:
        found = list(pool.map(look, range(first, first + images), chunksize=5))
    yield from _rows(found)


def _rows(found: Sequence[Found]) -> Iterator[Row]:
    errors = np.concatenate([each.errors for each in found])
    distances = np.linalg.norm(errors, axis=-1)
    right = errors[distances <= WRONG]
    note = f"{len(errors)} corners in {sum(len(each.errors) > 0 for each in found)} of {len(found)} images"
    yield Row("aprilgrid/RMS", float(np.sqrt((right**2).sum(-1).mean())), "px", Bar(high=0.06), note)
    note = f"median {np.median(distances):.4f}"
    yield Row("aprilgrid/bias", float(np.abs(right.mean(axis=0)).max()), "px", Bar(high=0.02), note)
    yield Row("aprilgrid/worst", float(distances.max()), "px")
    note = f"corners more than {WRONG:g} px off in {len(found)} images"
    yield Row("aprilgrid/wrong", float((distances > WRONG).sum()), "", Bar(high=0), note)
    yield Row("aprilgrid/found", 100 * len(errors) / sum(each.shown for each in found), "%", Bar(low=95))
    yield Row("aprilgrid/time", 1e3 * float(np.median([each.seconds for each in found])), "ms")


def look(number: int) -> Found:
    """Detect in an image: near or far, tilted up to 70 degrees, turned, cut off; a box hides part of every second one.

    Blur and noise are those of a simulated camera.
    """
    random = np.random.default_rng([7, number])
    T = _pose(random)
    pattern = GRID.pattern()
    board = Board(GRID, pattern, T_WORLD_CAMERA @ T)
    boxes = (_box(random, T),) if number % 2 else ()
    scene = Scene(ground=0.0, boxes=boxes)
    camera = SimulatedCamera(CAMERA, exposure=random.uniform(0.7, 1.2))
    image = camera.render(T_WORLD_CAMERA, scene, [board], stream(number))
    began = time.perf_counter()
    labels = _detector().detect(image)
    took = time.perf_counter() - began
    places = apply(T, pattern.corners)
    truth, visible = CAMERA.project_visible(places)
    size = np.array([CAMERA.width, CAMERA.height])
    with np.errstate(invalid="ignore"):
        shown = visible & ((truth > EDGE) & (truth < size - 1 - EDGE)).all(-1)
    shown &= _narrowest(T) >= LEAST_TAG
    shown &= ~scene.hides(T_WORLD_CAMERA[:3, 3], apply(T_WORLD_CAMERA, places))
    errors = labels.pixels - truth[labels.ids] if isinstance(labels, CornerLabels) else np.zeros((0, 2))
    return Found(errors, int(shown.sum()), took)


def _pose(random: np.random.Generator) -> Array:
    """``T_camera_pattern``."""
    towards, roll = random.uniform(-np.pi, np.pi, 2)
    axis = np.array([np.cos(towards), np.sin(towards), 0.0])
    R = rotations.exp(axis * np.radians(random.uniform(0, 70))) @ rotations.exp(np.array([0, 0, roll]))
    distance = float(np.exp(random.uniform(np.log(0.6), np.log(3.0))))
    middle = distance * np.array([*(random.uniform(-1, 1, 2) * [0.5, 0.25]), 1.0])
    return transform(R, middle - R @ GRID.pattern().centre)


def _narrowest(T_camera_pattern: Array) -> Array:
    """(K,): the side of a tag at each corner where it is seen at its shortest, px."""
    step, corners = 1e-5, GRID.pattern().corners
    sides = np.array([[step, 0, 0], [0, step, 0]])[:, None]
    ends = [CAMERA.project(apply(T_camera_pattern, corners + sign * sides)) for sign in (-1, 1)]
    jacobians = np.moveaxis((ends[1] - ends[0]) * (GRID.size / (2 * step)), 0, -1)
    return shortest(jacobians)


def _box(random: np.random.Generator, T_camera_pattern: Array) -> Box:
    """A box between the camera and the pattern, up to half as wide as it."""
    at = apply(T_camera_pattern, GRID.pattern().corners[random.integers(144)][None])[0] * random.uniform(0.5, 0.8)
    side = random.uniform(0.02, 0.2)
    return Box(T_WORLD_CAMERA @ transform(rotations.exp(random.normal(size=3)), at), np.full(3, side))


@cache
def _detector() -> CornerDetector:
    return corner_detector(GRID)


def main() -> None:
    """Print the rows of as many images as the command line asks for."""
    parser = argparse.ArgumentParser("python -m benchmarks.aprilgrid", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--images", type=int, default=IMAGES)
    parser.add_argument("--first", type=int, default=0, help="number of the first; the same number, the same image")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    asked = parser.parse_args()
    print(HEADER)
    for row in rows(asked.images, asked.jobs, asked.first):
        print(row.line())


if __name__ == "__main__":
    main()
