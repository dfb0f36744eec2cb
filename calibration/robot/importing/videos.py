"""Videos as the images of cameras: their times, the patterns in their frames, and the frames of chosen moments."""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from calibration.base import InputError, read_bytes
from calibration.ci.execution.tasks import Task, run_tasks
from calibration.robot.importing.bags.bag import NS_PER_S
from calibration.robot.importing.bags.recordings import SeenImage, SeenImages
from calibration.robot.importing.bags.stillness import BagMoment
from calibration.robot.importing.description import SensorDescription
from calibration.robot.importing.files.confined_decoding import FRAME_HEADER, confined_decoding
from calibration.robot.importing.image_views import (
    LabelledMoment,
    view_of_image,
    write_image,
)
from calibration.robot.labelling.detection import CornerDetector, Image

MAX_FRAMES = 200_000
"""Limit of a video's frames: those of two hours."""
MAX_FRAME_PIXELS = 40_000_000
"""Limit of the pixels of a frame: 8K has 33 million."""
MAX_STAMPS_BYTES = 10_000_000
PARTS_PER_VIDEO = 4
"""Tasks of one video. Each decodes what comes before its part, as no codec finds a frame by its number for certain."""
_MIN_NANOSECOND_STAMP = 1e14
"""Stamps from here on are in nanoseconds; as seconds they would be three million years."""


@dataclass(frozen=True)
class VideoFrame:
    """Frame of a video."""

    index: int
    time: float
    """As the video has it, ms."""
    rate: float
    """Frames a second, by the video's header."""
    width: int
    height: int
    image: Image | None
    """(H, W, 3), BGR; None if it was not asked for."""


@dataclass(frozen=True)
class Video:
    """Video of one camera."""

    path: Path
    stamps: tuple[int, ...]
    """Time of each frame, ns; rising."""
    files: tuple[Path, ...]
    """The video, and the file of its stamps if there is one."""

    def frame(self, index: int) -> Image:
        """Return a frame (H, W, 3), BGR.

        Raises:
            InputError: it is gone.
        """
        for frame in decoded_frames(self.path, [index], index + 1):
            if frame.image is not None:
                return frame.image
        raise InputError(f"{self.path}: frame {index} is gone")


def decoded_frames(path: Path, wanted: Collection[int], stop: int = MAX_FRAMES + 1) -> Iterator[VideoFrame]:
    """Decode the first ``stop`` frames of a video, of which the wanted ones have their pixels.

    Raises:
        InputError: it is no video, or damaged, or has too many frames or pixels.
    """
    if not path.is_file():
        raise InputError(f"{path}: found no such file, expected a video")
    request = {"wanted": sorted(wanted), "stop": stop, "pixels": MAX_FRAME_PIXELS}
    with confined_decoding("video", path, "a video", **request) as decoded:
        while len(head := decoded.read(FRAME_HEADER.size)) == FRAME_HEADER.size:
            index, time, rate, width, height, has_pixels = FRAME_HEADER.unpack(head)
            if not 0 < width * height <= MAX_FRAME_PIXELS:
                raise InputError(f"{path}: found frames of {width} x {height} pixels")
            image = None
            if has_pixels:
                data = decoded.read(3 * width * height)
                if len(data) < 3 * width * height:
                    break
                image = np.frombuffer(data, np.uint8).reshape(height, width, 3)
            yield VideoFrame(index, time, rate, width, height, image)


def survey_videos(sensors: Sequence[SensorDescription]) -> dict[str, Video]:
    """Read the times of all frames of each sensor's video.

    Raises:
        InputError: one is no video, has too many frames, or its stamps are wrong or of another number.
    """
    return {
        each.name: _survey_video(Path(each.images), each.stamps if isinstance(each.stamps, Path) else None)
        for each in sensors
        if each.images
    }


def _survey_video(path: Path, stamps: Path | None) -> Video:
    frames = list(decoded_frames(path, ()))
    if not frames:
        raise InputError(f"{path}: found no frame, expected a video")
    if len(frames) > MAX_FRAMES:
        raise InputError(f"{path}: found more than {MAX_FRAMES} frames, expected so many at most: cut it")
    if stamps is not None:
        return Video(path, _read_stamps(stamps, path, len(frames)), (path, stamps))
    times = [frame.time for frame in frames]
    if not all(math.isfinite(time) for time in times) or any(a >= b for a, b in pairwise(times)):
        rate = frames[0].rate
        if not 1e-3 < rate < 1e5:
            raise InputError(
                f"{path}: found no rising times of its frames and no rate: give a file with them, 'stamps'"
            )
        times = [1e3 * i / rate for i in range(len(times))]
    return Video(path, tuple(round(1e6 * time) for time in times), (path,))


def _read_stamps(file: Path, path: Path, count: int) -> tuple[int, ...]:
    """Read the time of each frame from a file, s or ns, one per line."""
    stamps: list[int] = []
    text = read_bytes(file, MAX_STAMPS_BYTES, "a file of stamps").decode("utf-8", "replace")
    for line, word in enumerate(text.split("\n"), 1):
        if not word.strip():
            continue
        try:
            value = float(word)
            stamp = int(word) if value >= _MIN_NANOSECOND_STAMP and word.strip().isdigit() else round(value * NS_PER_S)
        except (ValueError, OverflowError):
            value, stamp = math.nan, 0
        if not 0 <= value < 1e19:
            raise InputError(f"{file}:{line}: found '{word.strip()[:80]}', expected a time, s or ns")
        if stamps and stamp <= stamps[-1]:
            raise InputError(f"{file}:{line}: found '{word.strip()[:80]}' after a later time, expected rising ones")
        stamps.append(stamp)
    if len(stamps) != count:
        raise InputError(f"{file}: found {len(stamps)} times, expected {count}: one for each frame of {path}")
    return tuple(stamps)


def frame_tasks(
    videos: Mapping[str, Video], step: int, detectors: Mapping[str, CornerDetector]
) -> list[Task[SeenImages]]:
    """Return the tasks that search one of ``step`` frames of every video, each for a part of one."""

    def detect(name: str, frames: range) -> SeenImages:
        path = videos[name].path
        images = [
            SeenImage(name, frame.index, view_of_image(frame.image, f"{path}: frame {frame.index}", detectors))
            for frame in decoded_frames(path, frames, frames[-1] + 1)
            if frame.image is not None
        ]
        return SeenImages(tuple(images))

    tasks: list[Task[SeenImages]] = []
    for name, video in videos.items():
        searched = range(0, len(video.stamps), step)
        size = -(-len(searched) // PARTS_PER_VIDEO)
        for i in range(0, len(searched), size):
            tasks.append(Task.call(f"{len(tasks)}", partial(detect, name, searched[i : i + size])))
    return tasks


def extracted_frames(
    videos: Mapping[str, Video], moments: Sequence[BagMoment], folder: Path, jobs: int | None
) -> list[LabelledMoment]:
    """Extract the frames of moments as files into a folder, each with a thumbnail; existing ones are kept.

    Raises:
        InputError: a video is damaged.
        InfrastructureError: a file cannot be written, or a process died.
    """

    def file_of(name: str, index: int) -> Path:
        return folder / f"{name.replace('/', '_')}_{index:06d}.png"

    def extract(name: str, frames: Sequence[int]) -> int:
        for frame in decoded_frames(videos[name].path, frames, max(frames) + 1):
            if frame.image is not None:
                write_image(frame.image, file_of(name, frame.index))
        if missing := [index for index in frames if not file_of(name, index).exists()]:
            raise InputError(f"{videos[name].path}: frame {missing[0]} is gone")
        return len(frames)

    needed = {
        name: [
            i for each in moments if name in each.images and not file_of(name, i := each.images[name].recorded).exists()
        ]
        for name in videos
    }
    list(run_tasks([Task.call(name, partial(extract, name, own)) for name, own in needed.items() if own], workers=jobs))
    return [
        LabelledMoment(
            {
                name: replace(image.view, file=str(file_of(name, image.recorded)))
                for name, image in moment.images.items()
            }
        )
        for moment in moments
    ]
