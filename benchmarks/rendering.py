"""What sensors see: images, depth images and rays a second, and where detectors find the corners.

Images are rendered as a collection renders them, in processes over the cores, each with one thread of
OpenCV; the patterns fill the images as those of a calibration do. On two cores the bars are those of
the issue; a machine with other cores has other numbers.
"""

import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from benchmarks.rows import Bar, Row
from calibration.dataset.configuration import PatternConfiguration
from calibration.execution.embedded import Embedded
from calibration.geometry import rotations
from calibration.geometry.cameras import Camera
from calibration.geometry.distortion import PlumbBob
from calibration.geometry.transforms import apply, from_xyz_rpy, transform
from calibration.geometry.types import Array
from calibration.labelling.detection import NotDetected
from calibration.simulation.board import Board
from calibration.simulation.random_streams import stream
from calibration.simulation.scene import Box, Scene
from calibration.simulation.sensors import SimulatedCamera, SimulatedDepthCamera, SimulatedLidar

PROCESSES = 2
PATTERN = PatternConfiguration(
    "pattern_1", "charuco", "pattern", "world", False, (11, 8), 0.06, 0.045, (0.04, 0.03), "DICT_5X5_100"
)
DISTORTION = PlumbBob(-0.25, 0.08, 0.0008, -0.0005, 0.0)
T_WORLD_CAMERA = from_xyz_rpy([0, 0, 1.2], [-np.pi / 2, 0, -np.pi / 2])
ROOM = Scene(
    ground=0.0,
    boxes=(
        Box(from_xyz_rpy([6.0, 0.0, 1.5], [0, 0, 0]), np.array([0.2, 9.0, 3.0])),
        Box(from_xyz_rpy([2.0, 4.5, 1.5], [0, 0, 0]), np.array([8.0, 0.2, 3.0])),
        Box(from_xyz_rpy([4.6, -1.6, 0.5], [0, 0, 0.4]), np.array([0.8, 0.6, 1.0]), (150.0, 90.0, 60.0)),
        Box(from_xyz_rpy([4.2, 1.9, 0.3], [0, 0, -0.7]), np.array([0.6, 0.6, 0.6]), (170.0, 130.0, 80.0)),
    ),
)


@dataclass(frozen=True)
class Size:
    """A camera's size and focal length, px, and how many images a second it should give."""

    width: int
    height: int
    focal: float
    least: float

    def camera(self, distorted: bool = False) -> Camera:
        """The camera, its axis through the middle."""
        cx, cy = self.width / 2 - 0.5, self.height / 2 - 0.5
        lens = DISTORTION if distorted else PlumbBob()
        return Camera(self.focal, self.focal, cx, cy, self.width, self.height, lens)


SMALL, LARGE = Size(640, 480, 550.0, 60.0), Size(1280, 720, 900.0, 20.0)


def measure(quick: bool) -> Iterator[Row]:
    """Speeds first, then the corners."""
    try:
        import cv2
    except ImportError:
        yield Row("rendering", skipped="needs opencv-python-headless")
        return
    cv2.setNumThreads(1)
    count = 40 if quick else 120
    for size in (SMALL, LARGE):
        for distorted in (False, True):
            yield _images(size, distorted, count)
    yield _moving(SMALL, count // 2)
    yield _depth_images(SMALL, count)
    yield _rays(5 if quick else 20)
    for distorted in (False, True):
        yield from _corners(LARGE.camera(distorted), 12 if quick else 40, Bar(high=0.08 if distorted else 0.06))


def poses(count: int) -> list[Array]:
    """``T_camera_pattern`` 1 to 2 m away, tilted up to 40 degrees, turned up to 30."""
    random, found = np.random.default_rng(0), []
    for _ in range(count):
        azimuth, tilt, roll = random.uniform(-1, 1, 3) * [np.pi, np.radians(40), np.radians(30)]
        axis = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        R = rotations.exp(tilt * axis) @ rotations.exp(np.array([0, 0, roll]))
        x, y, z = random.uniform([-0.15, -0.1, 1.0], [0.15, 0.1, 2.0])
        centre = np.array([x * z, y * z, z])
        found.append(transform(R, centre - R @ PATTERN.pattern().centre))
    return found


def _boards(T_camera_pattern: Array) -> list[Board]:
    return [Board(PATTERN, PATTERN.pattern(), T_WORLD_CAMERA @ T_camera_pattern)]


def _per_second(work: Callable[[int], object], count: int) -> tuple[float, str]:
    """How many calls a second the processes do, their start included; the parent has done one before them.

    Returns:
        The calls a second, and a note of what one takes of a core.
    """

    def timed(number: int) -> float:
        start = time.process_time()
        work(number)
        return time.process_time() - start

    work(0)
    start = time.perf_counter()
    seconds = [taken for _, taken in Embedded().run([partial(timed, n) for n in range(count)], workers=PROCESSES)]
    rate = count / (time.perf_counter() - start)
    return rate, f"{PROCESSES} processes, {1e3 * statistics.median(seconds):.1f} ms of a core each"


def _images(size: Size, distorted: bool, count: int) -> Row:

    sensor, views = SimulatedCamera(size.camera(distorted)), poses(count)

    def work(number: int) -> object:
        return sensor.render(T_WORLD_CAMERA, ROOM, _boards(views[number]), stream(0, number))

    name = f"rendering/images {size.width}x{size.height}{', distorted' if distorted else ''}"
    rate, note = _per_second(work, count)
    note += f"; blur, noise and vignetting included, {count} poses in a room"
    return Row(name, rate, "images/s", None if distorted else Bar(low=size.least), note)


def _moving(size: Size, count: int) -> Row:
    """As of a camera on an arm: the room is drawn anew for every image."""
    sensor, views = SimulatedCamera(size.camera()), poses(count)

    def work(number: int) -> object:
        T_world_camera = from_xyz_rpy([0.001 * number, 0, 0], [0, 0, 0]) @ T_WORLD_CAMERA
        return sensor.render(T_world_camera, ROOM, _boards(views[number]), stream(0, number))

    rate, note = _per_second(work, count)
    return Row(f"rendering/images {size.width}x{size.height}, moving", rate, "images/s", None, note)


def _depth_images(size: Size, count: int) -> Row:

    sensor, views = SimulatedDepthCamera(size.camera()), poses(count)

    def work(number: int) -> object:
        return sensor.render(T_WORLD_CAMERA, ROOM, _boards(views[number]), stream(0, number))

    rate, note = _per_second(work, count)
    return Row(f"rendering/depth {size.width}x{size.height}", rate, "images/s", Bar(low=size.least), note)


def _rays(count: int) -> Row:

    lidar, views = SimulatedLidar(tuple(np.radians(np.linspace(-15, 15, 32))), 1800), poses(count)

    def work(number: int) -> object:
        return lidar.scan(T_WORLD_CAMERA, ROOM, _boards(views[number]), stream(0, number))

    work(0)
    start = time.perf_counter()
    for number in range(count):
        work(number)
    rate = count * 32 * 1800 / (time.perf_counter() - start)
    return Row("rendering/LiDAR", rate / 1e6, "million rays/s", Bar(low=2), "one process, noise included")


def _corners(camera: Camera, count: int, bar: Bar) -> Iterator[Row]:
    """The detector that datasets are labelled with, against the projected truth."""
    from calibration.labelling.corner_detector import corner_detector

    detector, views, sensor = corner_detector(PATTERN), poses(count), SimulatedCamera(camera)
    truth = [camera.project(apply(T, PATTERN.pattern().corners)) for T in views]
    open_room = replace(ROOM, boxes=ROOM.boxes[:1])

    def work(number: int) -> Array:
        image = sensor.render(T_WORLD_CAMERA, open_room, _boards(views[number]), stream(1, number))
        labels = detector.detect(image)
        if isinstance(labels, NotDetected):
            return np.zeros((0, 2))
        return labels.pixels - truth[number][labels.ids]

    errors = [error for _, error in Embedded().run([partial(work, n) for n in range(count)], workers=PROCESSES)]
    error, of = np.concatenate(errors), sum(int(camera.contains(pixels).sum()) for pixels in truth)
    name = f"rendering/corners{', distorted' if not camera.distortion.is_identity else ''}"
    note = f"{camera.width}x{camera.height}, {len(error)} of {of} corners in {count} images"
    yield Row(f"{name}, RMS", float(np.sqrt((error**2).sum(axis=1).mean())), "px", bar, note)
    yield Row(f"{name}, bias", float(np.abs(error.mean(axis=0)).max()), "px", Bar(high=0.01), "the worse axis")
