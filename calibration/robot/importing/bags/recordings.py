"""Second pass over a bag: detect the patterns in every image, choose the moments, and extract their images."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from calibration.base import InputError, read_bytes
from calibration.base.records import field, read, result
from calibration.ci.execution.tasks import Task, run_tasks
from calibration.engine.dataset.model import Edge
from calibration.robot.importing.bags.bag import NS_PER_S, Bag
from calibration.robot.importing.bags.motion import MotionLog
from calibration.robot.importing.bags.range_views import RANGE_MODALITIES, RangeView
from calibration.robot.importing.bags.stillness import BagImage, BagMoment, evenly, moments_at, still_moments
from calibration.robot.importing.bags.survey import SensorTopic, Survey
from calibration.robot.importing.bags.video_packets import ImageReader
from calibration.robot.importing.description import (
    MomentChoice,
)
from calibration.robot.importing.image_views import (
    LabelledMoment,
    View,
    view_of_image,
    write_image,
)
from calibration.robot.importing.results import RejectedView
from calibration.robot.labelling.detection import CornerDetector, Image

AT_ONCE = 20
"""Images of one task, whose result is stored; a long last task leaves the other processes idle."""
LIDAR_LAG = 0.2
"""s: a rotating LiDAR takes 0.1 s for one cloud, and nothing moves meanwhile."""
MAX_TIMES = 1_000_000
MAX_NAMED_IMAGES = 200
"""Images without a pattern that are named, of each camera; the others are only counted."""


@result
class SeenImage:
    """Image of a bag, and the patterns in it."""

    sensor: str = field("The camera.")
    recorded: int = field("When it was recorded, ns.")
    view: View = field("What is in it.")


@result
class SeenImages:
    """Images of a part of a bag."""

    images: tuple[SeenImage, ...] = field("In the order in which they were recorded.")


def decoded_images(text: bytes) -> SeenImages:
    """Decode the stored result of an earlier run."""
    return read(SeenImages, json.loads(text), "finished images")


def detection_tasks(bag: Bag, found: Survey, detectors: Mapping[str, CornerDetector]) -> list[Task[SeenImages]]:
    """Return the tasks that search every image, each for an interval of time."""
    times = sorted({recorded for camera in found.cameras.values() for recorded in camera.stamps})
    bounds = [*times[::AT_ONCE], times[-1] + 1]
    topics = {camera.topic: name for name, camera in found.cameras.items()}
    reader = ImageReader(bag, found.key_frames)

    def detect(start: int, stop: int) -> SeenImages:
        images: dict[tuple[str, int], SeenImage] = {}
        for message, image in reader.images(topics, start, stop):
            key = name, recorded = topics[message.topic], message.recorded
            if recorded in found.cameras[name].stamps and key not in images:
                view = view_of_image(image(), bag.place(message), detectors)
                images[key] = SeenImage(name, recorded, view)
        return SeenImages(tuple(images.values()))

    return [Task.call(f"{i}", partial(detect, *ends)) for i, ends in enumerate(pairwise(bounds))]


def images_by_camera(
    stamps: Mapping[str, Mapping[int, int] | Sequence[int]], seen: Sequence[SeenImages]
) -> dict[str, list[BagImage]]:
    """Return the images of each camera, sorted by stamp.

    Args:
        stamps: by camera; of each image, by its recording time or the number of a video's frame.
        seen: the images.
    """
    images: dict[str, list[BagImage]] = {name: [] for name in stamps}
    for part in seen:
        for image in part.images:
            stamp = stamps[image.sensor][image.recorded]
            images[image.sensor].append(BagImage(image.sensor, stamp, image.recorded, image.view))
    return {name: sorted(own, key=lambda image: image.stamp) for name, own in images.items()}


def images_without_pattern(
    found: Survey, images: Mapping[str, Sequence[BagImage]], log: MotionLog
) -> dict[str, list[RejectedView]]:
    """Return the images of each camera in which no pattern is detected, and count them as left out."""
    rejected = {}
    for name, own in images.items():
        missed = [image for image in own if not image.view.labelled]
        if missed:
            log.left_out.add("no pattern is detected in it", name, missed[0].stamp, len(missed))
        topic = found.cameras[name].topic
        rejected[name] = [
            RejectedView(f"{topic} at {image.stamp / NS_PER_S:.3f}", image.view.reason)
            for image in missed[:MAX_NAMED_IMAGES]
        ]
    return rejected


def chosen_moments(
    described: MomentChoice,
    images: Mapping[str, Sequence[BagImage]],
    log: MotionLog,
    edges: Sequence[Edge],
    where: str,
) -> list[BagMoment]:
    """Return the moments that may become collections: all at standstill, or the requested times.

    Raises:
        InputError: there is no standstill, or no image near the requested times.
    """
    if described.only_standstill:
        still = still_moments(images)
        kept = [moment for moment in still if log.is_still(list(edges), moment.time)]
        for moment in still:
            if moment not in kept:
                log.left_out.add("the pattern stays where it is, but the robot moves", "moments", moment.time)
        if not kept:
            why = (
                f"the corners stay {len(still)} times, but the robot moves then" if still else "the corners always move"
            )
            raise InputError(
                f"{where}: found no moment at which all stands still ({why}); stop at each pose, or 'every'"
            )
        return kept
    stamps = [image.stamp for own in images.values() for image in own]
    start, end = min(stamps), max(stamps)
    if described.at is not None:
        times = _read_times(described.at, start)
    else:
        step = int((described.every or 1.0) * NS_PER_S)
        times = [float(start + i * step) for i in range(min((end - start) // step + 1, MAX_TIMES))]
    moments = moments_at(images, times)
    if not moments:
        raise InputError(f"{where}: no image with a pattern is near the times that are asked for")
    return evenly(moments, described.most)


def _read_times(path: Path, start: int) -> list[float]:
    """Read times from a file, s, one per line; small ones are relative to the start of the bag."""
    times = []
    text = read_bytes(path, 10_000_000, "a file of times").decode("utf-8", "replace")
    for line, word in enumerate(text.split("\n"), 1):
        if not word.strip():
            continue
        try:
            seconds = float(word)
        except ValueError:
            seconds = math.nan
        if not 0 <= seconds < 1e11:
            raise InputError(f"{path}:{line}: found '{word.strip()[:80]}', expected seconds")
        times.append(seconds * NS_PER_S + (start if seconds < 1e8 else 0))
    return times


def extracted_images(
    bag: Bag, found: Survey, moments: Sequence[BagMoment], folder: Path, jobs: int | None
) -> list[LabelledMoment]:
    """Extract the chosen images as files into a folder, each with a thumbnail; existing ones are kept.

    Args:
        bag: the recording.
        found: the result of the first pass.
        moments: the chosen ones.
        folder: for the images.
        jobs: number of processes; None for one per core.

    Raises:
        InputError: the bag is damaged.
        InfrastructureError: a file cannot be written, or a process died.
    """
    reader = ImageReader(bag, found.key_frames)

    def extract(some: Sequence[BagMoment]) -> list[LabelledMoment]:
        labelled = []
        for moment in some:
            views = {}
            for name, image in moment.images.items():
                path = folder / f"{name.replace('/', '_')}_{image.recorded}.png"
                if not path.exists():
                    write_image(image_at(bag, found.cameras[name].topic, image.recorded, reader), path)
                views[name] = replace(image.view, file=str(path))
            labelled.append(LabelledMoment(views))
        return labelled

    parts = [moments[i : i + AT_ONCE] for i in range(0, len(moments), AT_ONCE)]
    tasks = [Task.call(f"{i}", partial(extract, part)) for i, part in enumerate(parts)]
    return [moment for part in run_tasks(tasks, workers=jobs).values() for moment in part]


def extracted_ranges(bag: Bag, found: Survey, moments: Sequence[BagMoment], folder: Path) -> list[dict[str, RangeView]]:
    """Extract the data of LiDARs and depth cameras nearest to each moment, within `LIDAR_LAG`; all but scans as files.

    Raises:
        InputError: the bag is damaged, or a message is wrong.
        InfrastructureError: a file cannot be written.
    """
    views: list[dict[str, RangeView]] = [{} for _ in moments]
    for name, lidar in found.range_sensors.items():
        recorded = np.array(list(lidar.stamps))
        stamps = np.array(list(lidar.stamps.values()))
        for own, moment in zip(views, moments, strict=True):
            nearest = int(abs(stamps - moment.time).argmin())
            if abs(stamps[nearest] - moment.time) <= LIDAR_LAG * NS_PER_S:
                own[name] = _range_view(bag, name, lidar, int(recorded[nearest]), folder)
            else:
                rule = f"moments without its data within {LIDAR_LAG:g} s"
                found.log.left_out.add(rule, name, moment.time)
    return views


def _range_view(bag: Bag, name: str, lidar: SensorTopic, recorded: int, folder: Path) -> RangeView:
    for message in bag.messages({lidar.topic}, recorded, recorded + 1):
        stem = folder / f"{name.replace('/', '_')}_{recorded}"
        return RANGE_MODALITIES[lidar.modality.name].view(bag.decode(message), bag.place(message), lidar, stem)
    raise InputError(f"{bag.path}: {lidar.topic}: the message at {recorded / NS_PER_S:.3f} is gone")


def image_at(bag: Bag, topic: str, recorded: int, reader: ImageReader) -> Image:
    """Return an image of a bag by its recording time, ns.

    Raises:
        InputError: the bag is damaged.
    """
    if images := [image for _, image in reader.images({topic}, recorded, recorded + 1)]:
        return images[0]()
    raise InputError(f"{bag.path}: {topic}: the image at {recorded / NS_PER_S:.3f} is gone")
