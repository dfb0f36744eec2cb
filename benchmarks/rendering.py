"""Speed of simulated images, depth images and rays, and accuracy of the corners that detectors find.

Images are rendered as a collection renders them, in processes over the cores, each with one thread of
OpenCV; the patterns fill the images as those of a calibration do. On two cores the bars are those of
the issue; a machine with other cores has other numbers.
"""

import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks import reference
from benchmarks.room import LARGE, PATTERN, ROOM, SMALL, T_WORLD_CAMERA, Size, poses
from benchmarks.rows import Bar, Row
from benchmarks.sensors import RAYS, measured
from calibration.base.arrays import Array
from calibration.ci.execution.tasks import Embedded
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import apply, from_xyz_rpy
from calibration.robot.labelling.detection import NotDetected
from calibration.robot.simulation.kinematics import stream
from calibration.robot.simulation.scene import Board
from calibration.robot.simulation.sensors import SimulatedCamera, SimulatedDepthCamera, SimulatedLidar

PROCESSES = 2


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
    yield from _beside_before(20 if quick else 60)
    for distorted in (False, True):
        yield from _corners(LARGE.camera(distorted), 12 if quick else 40, Bar(high=0.08 if distorted else 0.06))


def _boards(T_camera_pattern: Array) -> list[Board]:
    return [Board(PATTERN, PATTERN.pattern(), T_WORLD_CAMERA @ T_camera_pattern)]


def _per_second(work: Callable[[int], object], count: int) -> tuple[float, str]:
    """Calls a second of the processes, their start included; the parent has done one before them.

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
    """Measure a camera on an arm: the room is drawn anew for every image."""
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


def _beside_before(count: int) -> Iterator[Row]:
    """A camera in the hand and a LiDAR as collections have them, in CPU time, here and at the kept commit."""
    now, place = measured(count), reference.folder(reference.RECENT)
    before = measured(count, place) if place else dict.fromkeys(now, float("nan"))
    ratio, earlier = (each["in_hand"] / each["stands"] for each in (now, before))
    note = (
        f"CPU time of one image: {1e3 * now['in_hand']:.0f} ms; before {1e3 * before['in_hand']:.0f} ms, {earlier:.2f}"
    )
    yield Row("rendering/camera in the hand", ratio, "x one that stands", Bar(high=1.3), note)
    rate, earlier = (PROCESSES * RAYS / each["scan"] / 1e6 for each in (now, before))
    note = f"{PROCESSES} cores, rays of whole revolutions, cast and kept, not yet labelled; before {earlier:.1f}"
    yield Row("rendering/LiDAR in a collection", rate, "million rays/s", Bar(low=20), note)


def _corners(camera: Camera, count: int, bar: Bar) -> Iterator[Row]:
    """The detector that datasets are labelled with, against the projected truth."""
    from calibration.robot.labelling.corner_detector import corner_detector

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
