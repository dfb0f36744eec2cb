"""Second pass over a bag: detect the patterns in every image, choose the moments, and extract their images."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from calibration.base import InputError, read_bytes
from calibration.base.arrays import Array
from calibration.base.records import field, read, result
from calibration.ci.execution.tasks import Task, run_tasks
from calibration.engine.dataset.configuration import Configuration, PatternConfiguration, SensorConfiguration
from calibration.engine.dataset.model import Edge
from calibration.engine.geometry.frames import FrameTree
from calibration.robot.importing.bags.bag import NS_PER_S, Bag
from calibration.robot.importing.bags.motion import MotionLog
from calibration.robot.importing.bags.range_views import RANGE_MODALITIES, RangeView
from calibration.robot.importing.bags.stillness import BagImage, BagMoment, evenly, moments_at, still_moments
from calibration.robot.importing.bags.survey import SensorTopic, Survey
from calibration.robot.importing.bags.video_packets import ImageReader
from calibration.robot.importing.description import (
    ImportDescription,
    MomentChoice,
    SensorDescription,
    body_edges,
    carriers,
    moving_bodies,
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


@dataclass(frozen=True, eq=False)
class Mounting:
    """Sensors of a bag in its tree of frames."""

    configuration: Configuration
    edges: tuple[Edge, ...]
    """Known edges from the world to the sensors and to the patterns' parents."""

    def transforms(self, log: MotionLog, times: Sequence[float]) -> dict[Edge, Array]:
        """Return (N, 4, 4) at each of the times, ns; the identity for unknown transforms.

        Raises:
            InputError: there is no record of one near a time.
        """
        found = {edge: np.stack([log.transform(edge, time) for time in times]) for edge in self.edges}
        sensors = self.configuration.sensors.values()
        calibrated = [(each.parent_link, each.child_link) for each in sensors]
        for edge in (*calibrated, *self.configuration.additional_tfs.values()):
            if edge not in found:
                found[edge] = np.broadcast_to(np.eye(4), (len(times), 4, 4))
        return found

    def motions(self, log: MotionLog, times: Sequence[float]) -> dict[Edge, Array]:
        """Return velocity, acceleration and jerk (N, 3, 6) of the edges that move at any of the times, ns."""
        found = {edge: np.stack([log.motion(edge, time) for time in times]) for edge in self.edges if log.moves(edge)}
        return {edge: motion for edge, motion in found.items() if motion.any()}


def mounting(
    described: ImportDescription, patterns: Mapping[str, PatternConfiguration], found: Survey, where: str
) -> Mounting:
    """Return the calibrated transforms: of each sensor the one below its parent.

    Raises:
        InputError: a named frame is not in the recording, or is not above the sensor's.
    """
    chosen, several = found.log.tree_edges(described.parents)
    edges = [edge for edge in chosen if edge[1] not in {pattern.link for pattern in patterns.values()}]
    tree, parent_of = FrameTree(edges), {child: parent for parent, child in edges}
    known, world = set(tree.frames), described.root
    sensors = {
        name: _sensor_configuration(each, world, parent_of, found.log, where) for name, each in found.sensors.items()
    }
    bodies = body_edges(described)
    carrying = [bodies[parent][0] if (parent := each.parent_link) in bodies else parent for each in patterns.values()]
    ends = [*(sensor.parent_link for sensor in sensors.values()), *carrying]
    if stray := [frame for frame in ends if frame != world and frame not in known]:
        fault = f"; the robot description cannot be read: {found.log.robot_fault}" if found.log.robot_fault else ""
        raise InputError(
            f"{where}: found no frame '{stray[0]}', expected one of those that were recorded: "
            f"{', '.join(sorted(known)) or 'none'}{fault}"
        )
    ends += [sensor.link for sensor in sensors.values() if sensor.link in known]
    used = dict.fromkeys((step.parent, step.child) for end in ends if end != world for step in tree.path(world, end))
    for _, child in used:
        if child in several:
            parents = " and ".join(f"'{parent}'" for parent in several[child])
            raise InputError(
                f"{where}: found '{child}' below {parents}, expected one parent on the way to a sensor or a pattern: "
                f"choose it, parents: {{{child}: {several[child][0]}}}"
            )
    for child in several:
        found.log.left_out.add("a second parent", child)
    mounted = carriers(described, [each.parent_link for each in patterns.values() if each.fixed])
    anchored = described.anchored or (None if mounted else next(iter(sensors)))
    moving = moving_bodies(described)
    return Mounting(Configuration(world, sensors, patterns, anchored, bodies, moving), tuple(used))


def root_of(described: ImportDescription, found: Survey) -> str:
    """Return the root frame: the named one, if it was recorded; else the root above the first sensor.

    Raises:
        InputError: a chosen parent was not recorded, or the frames form a loop.
    """
    parent_of = {child: parent for parent, child in found.log.tree_edges(described.parents)[0]}
    frames = {*parent_of, *parent_of.values()}
    if described.root in frames or not frames:
        return described.root
    frame = next((each.frame for each in found.sensors.values() if each.frame in frames), next(iter(frames)))
    while frame in parent_of:
        frame = parent_of[frame]
    return frame


def _sensor_configuration(
    camera: SensorTopic, world: str, parent_of: Mapping[str, str], log: MotionLog, where: str
) -> SensorConfiguration:
    described: SensorDescription = camera.described
    name, frame = described.name, camera.frame
    if frame not in parent_of:
        parent, child = described.parent or world, frame
    elif described.parent is None:
        parent, child = _above_optical(frame, parent_of, log)
    else:
        child = frame
        while parent_of.get(child) not in (described.parent, None):
            child = parent_of[child]
        if child not in parent_of:
            raise InputError(f"{where}: '{described.parent}' is not above '{frame}', the frame of '{name}'")
        parent = described.parent
    return SensorConfiguration(name, camera.modality.name, frame, parent, child, camera.topic)


def _above_optical(frame: str, parent_of: Mapping[str, str], log: MotionLog) -> Edge:
    """Return the transform that mounts a camera: not the one that only rotates its axes to those of an image."""
    edge = (parent_of[frame], frame)
    if edge[0] in parent_of and not log.moves(edge) and not log.transform(edge, 0.0)[:3, 3].any():
        return (parent_of[edge[0]], edge[0])
    return edge
