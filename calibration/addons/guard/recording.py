"""The images of an ordinary recording, a bounded number of each camera's: of a bag, a video, or a folder."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.base import InputError
from calibration.robot.importing.bags.bag import BAG_ENDINGS, LIVOX_TYPES, NS_PER_S, Bag, open_bag
from calibration.robot.importing.bags.messages import image_of
from calibration.robot.importing.bags.survey import cameras_of, no_images
from calibration.robot.importing.bags.video_packets import KeyFrames
from calibration.robot.importing.description import SensorDescription
from calibration.robot.importing.look.images import ImageSource, images_at, topic_images
from calibration.robot.labelling.detection import Image, grey

CLOUD_TYPES = ("sensor_msgs/msg/PointCloud2", *LIVOX_TYPES)
MAX_CLOCK_JUMP = 1.0
"""s: largest change of a topic's stamps against the clock of the recording, between two images that are looked at."""


@dataclass(frozen=True)
class CameraImages:
    """Images of one camera, of which some are decoded."""

    place: str
    """Topic, folder or file."""
    seconds: float
    """From the first image to the last."""
    read: Callable[[float, float, int], Iterator[tuple[float, Image]]]
    """Function of a span, s from the first image, and a number: yields at most so many grey images with their times."""


def open_recordings(recordings: Sequence[str], rate: float = 1.0) -> dict[str, CameraImages]:
    """Return the cameras of recordings, by the names that these have for them.

    Args:
        recordings: bags, videos and folders of images, each after the sensor's name if it is of one (``cam=x``).
        rate: images a second of folders, whose images have no times.

    Raises:
        InputError: one is none of them, or a name occurs twice.
    """
    found: dict[str, CameraImages] = {}
    for value in recordings:
        sensor, equals, place = value.partition("=")
        named = bool(equals) and not Path(value).exists()
        own = _cameras_at(Path(place if named else value), rate)
        if named:
            if len(own) != 1:
                raise InputError(f"{place}: found {len(own)} cameras ({', '.join(own)}), expected one: '{sensor}'")
            own = {sensor: next(iter(own.values()))}
        if twice := found.keys() & own.keys():
            raise InputError(
                f"{value}: found a second recording of '{min(twice)}', expected one: name each, SENSOR=PATH"
            )
        found |= own
    return found


def camera_named(
    cameras: Mapping[str, CameraImages], sensor: str, place: str | None, others: int
) -> CameraImages | None:
    """Return the images of a sensor: those of its name, those of the same topic, or the only ones of an only camera.

    Args:
        cameras: of the recording.
        sensor: its name.
        place: topic, folder or file in which the reference had them; None if there is none.
        others: number of cameras of which this is one.
    """
    if sensor in cameras:
        return cameras[sensor]
    of_place = [each for each in cameras.values() if place and each.place == place]
    if of_place:
        return of_place[0]
    return next(iter(cameras.values())) if len(cameras) == 1 and others == 1 else None


def no_such_camera(cameras: Mapping[str, CameraImages], sensor: str) -> str:
    """Return what is wrong with a recording that lacks a sensor."""
    known = ", ".join(f"{name} ({each.place})" for name, each in cameras.items())
    return f"found no images of '{sensor}', only of {known}: name it, '{sensor}=PATH'"


def path_of_recording(value: str) -> Path:
    """Return the path of a recording, which may be after the name of a sensor."""
    place = value.partition("=")[2]
    return Path(place) if place and not Path(value).exists() else Path(value)


def is_bag(path: Path) -> bool:
    """Whether a path is a bag."""
    return path.suffix.lower() in BAG_ENDINGS or (path / "metadata.yaml").is_file()


def _cameras_at(path: Path, rate: float) -> dict[str, CameraImages]:
    if is_bag(path):
        with open_bag([path]) as bag:
            cameras = cameras_of(bag)
            if not cameras and not bag.of_type(*CLOUD_TYPES):
                raise InputError(f"{path}: {no_images(bag)}")
            return {each.name: found for each in cameras if (found := _images_of_topic(bag, each)) is not None}
    return {name: _images_of_source(source, rate) for name, source in images_at(path).items()}


def _images_of_source(source: ImageSource, rate: float) -> CameraImages:
    times = np.arange(source.count) / rate if source.times is None else np.array(source.times, float) / NS_PER_S
    times = times - times[0]

    def read(first: float, last: float, most: int) -> Iterator[tuple[float, Image]]:
        inside = np.flatnonzero((times >= first) & (times <= last))
        chosen = inside[np.unique(np.linspace(0, len(inside) - 1, min(most, len(inside))).round().astype(int))]
        for index, image in zip(chosen.tolist(), source.images(chosen.tolist()), strict=False):
            yield float(times[index]), grey(image)

    return CameraImages(source.place, float(times[-1]), read)


def _images_of_topic(bag: Bag, camera: SensorDescription) -> CameraImages | None:
    """Return the images of a topic, which are sought by their recording times; of a video all packets are read."""
    topic, span, path = camera.topic or "", bag.span, bag.path
    first = next(iter(bag.messages({topic})), None)
    if first is None or span is None:
        return None
    key_frames = KeyFrames(bag)
    key_frames.add(first)
    if key_frames.recorded:
        times = [each.recorded for each in bag.messages({topic}) if key_frames.add(each)]
        return _images_of_source(topic_images([path], topic, times, key_frames.recorded), 1.0)
    begin, end = first.recorded, span[1]

    def read(start: float, stop: float, most: int) -> Iterator[tuple[float, Image]]:
        clock: float | None = None
        edges = np.linspace(begin + start * NS_PER_S, begin + stop * NS_PER_S, most).astype(np.int64).tolist()
        with open_bag([path]) as opened:
            for from_, to in zip(edges, [*edges[1:], edges[-1] + NS_PER_S], strict=True):
                if (message := next(iter(opened.messages({topic}, from_, to)), None)) is None:
                    continue
                lag = (opened.stamp(message) - message.recorded) / NS_PER_S
                if clock is not None and abs(lag - clock) > MAX_CLOCK_JUMP:
                    raise InputError(
                        f"{path}: {topic} at {(message.recorded - begin) / NS_PER_S:.1f} s: the stamps jump by "
                        f"{lag - clock:.1f} s, expected at most {MAX_CLOCK_JUMP:g}: cut the recording there"
                    )
                clock = lag
                where = f"{path}: {topic} at {(message.recorded - begin) / NS_PER_S:.1f} s"
                yield (message.recorded - begin) / NS_PER_S, grey(image_of(opened.decode(message), where))

    return CameraImages(topic, (end - begin) / NS_PER_S, read)
