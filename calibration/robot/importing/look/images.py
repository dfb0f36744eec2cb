"""Images of a recording's cameras, whatever they are in, and a sample of them: patterns, brightness, sharpness."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from calibration.base import InputError
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.model import CornerLabels
from calibration.robot.importing import near_miss
from calibration.robot.importing.bags.bag import BAG_ENDINGS, NS_PER_S, open_bag
from calibration.robot.importing.bags.stillness import MAX_GAP_SECONDS, MAX_STILL_MOTION_PX
from calibration.robot.importing.bags.video_packets import ImageReader
from calibration.robot.importing.description import VIDEO_ENDINGS, ImportDescription, SensorDescription, is_video
from calibration.robot.importing.files.pictures import IMAGE_ENDINGS, find_pictures
from calibration.robot.importing.files.samples import read_samples
from calibration.robot.importing.files.target_files import pattern_configuration
from calibration.robot.importing.image_views import read_image
from calibration.robot.importing.videos import decoded_frames, survey_videos
from calibration.robot.labelling.corner_detector import corner_detector
from calibration.robot.labelling.detection import CornerDetector, Image, grey

MAX_CAMERAS = 16
"""Cameras that are looked at."""


@dataclass(frozen=True)
class ImageSource:
    """Images of one camera."""

    place: str
    """Topic, folder or file, for messages."""
    count: int
    """Number of images."""
    images: Callable[[Sequence[int]], Iterator[Image]]
    """Function that decodes some images, by ascending index; it raises an `InputError` for one that cannot be."""
    times: Sequence[int] | None = None
    """Time of every image, ns, in ascending order; None if they have none."""


def topic_images(
    files: Sequence[Path], topic: str, times: Sequence[int], key_frames: Mapping[str, Sequence[int]]
) -> ImageSource:
    """Return the images of a topic of a bag, by their recording times, ns, and those of the key frames of videos."""

    def images(wanted: Sequence[int]) -> Iterator[Image]:
        with open_bag(files) as bag:
            reader = ImageReader(bag, key_frames)
            for time in [times[index] for index in wanted]:
                for image in [image for _, image in reader.images({topic}, time, time + 1)][:1]:
                    yield image()

    return ImageSource(topic, len(times), images, times)


def file_images(place: str, files: Sequence[Path]) -> ImageSource:
    """Return images in files."""
    return ImageSource(place, len(files), lambda wanted: (read_image(files[index]) for index in wanted))


def video_images(sensor: SensorDescription) -> ImageSource:
    """Return the frames of a sensor's video.

    Raises:
        InputError: it is no video.
    """
    video = survey_videos([sensor])[sensor.name]

    def images(wanted: Sequence[int]) -> Iterator[Image]:
        frames = decoded_frames(video.path, wanted, wanted[-1] + 1)
        return (frame.image for frame in frames if frame.image is not None)

    return ImageSource(str(video.path), len(video.stamps), images, video.stamps)


def described_images(described: ImportDescription) -> dict[str, ImageSource]:
    """Return the images of the cameras in folders and videos that import.yml names.

    Raises:
        InputError: a folder or a file is missing or wrong, or there are no images.
    """
    found: dict[str, ImageSource] = {}
    for sensor in [each for each in described.sensors if each.images][:MAX_CAMERAS]:
        if is_video(sensor.images or ""):
            found[sensor.name] = video_images(sensor)
        else:
            pictures = find_pictures(sensor.name, sensor.images or "")
            found[sensor.name] = file_images(pictures.place, pictures.files)
    if not found and described.samples is not None:
        images = [each.image for each in read_samples(described.samples, described.in_hand) if each.image]
        if gone := [each for each in images if not each.is_file()]:
            raise InputError(f"{gone[0]}: found no such file, expected an image of {described.samples.file}")
        if images:
            found[described.sensors[0].name] = file_images(str(described.samples.file), images)
    if not found:
        place = described.samples.file if described.samples else "sensors"
        raise InputError(f"{place}: found no image, expected some to look at: poses alone tell nothing here")
    return found


def images_at(path: Path) -> dict[str, ImageSource]:
    """Return the images of a video, of a folder of images, or of each folder of images in a folder.

    Raises:
        InputError: it is none of them.
    """
    if is_video(path.name) and not path.is_dir():
        return {path.stem: video_images(SensorDescription(path.stem, images=str(path)))}
    if not path.is_dir():
        raise InputError(
            f"{path}: found no such folder or recording, expected a bag (.bag, .db3, .mcap, or a folder with "
            f"metadata.yaml), a folder of images, a video ({', '.join(VIDEO_ENDINGS)}) or an import.yml"
        )
    folders = [path, *sorted(each for each in path.iterdir() if each.is_dir())]
    with_images = [each for each in folders if any(file.suffix.lower() in IMAGE_ENDINGS for file in each.iterdir())]
    if not with_images:
        endings = (*BAG_ENDINGS, *VIDEO_ENDINGS)
        recordings = [file.name for file in sorted(path.iterdir()) if file.suffix.lower() in endings]
        hint = f"; name a recording in it: {recordings[0]}" if recordings else ""
        raise InputError(
            f"{path}: found no image in it or in its folders, expected files in {', '.join(IMAGE_ENDINGS)}{hint}"
        )
    chosen = with_images[:1] if with_images[0] == path else with_images[:MAX_CAMERAS]
    return {each.name: file_images(str(each), find_pictures(each.name, str(each)).files) for each in chosen}


MAX_SEARCHED_SIDE = 1600
"""px: larger images are reduced before they are searched for an unknown pattern."""
NO_LABELS = CornerLabels(np.zeros(0, np.int64), np.zeros((0, 2)))
MAX_IMAGES = 24
"""Images of a camera that are decoded."""
MAX_HELD_PIXELS = 200_000_000
"""Pixels of a camera's images that are held in memory together."""
MIN_SATURATED_LEVEL = 254
"""Least value of a saturated pixel."""
STEEPEST_EDGE_SHARE = 0.005
"""Share of the pixels, those of the steepest edges, on which blur is measured."""
LEAST_STEP = 4.0
"""Least slope of an edge on which blur is measured, grey values a pixel: flatter ones are noise."""
NARROW_FILTER_PX, WIDE_FILTER_PX = 1.0, 2.0
"""px: standard deviations of the two filters by which blur is measured."""
SAMPLING_VARIANCE = 5 / 12
"""px^2: what pixels add to the variance of a blur: 1/3 by differences over two, 1/12 by the edge's place among them."""


@dataclass(frozen=True)
class LookedFor:
    """Pattern that is looked for."""

    name: str
    """In words."""
    find: Callable[[Image], CornerLabels]
    """Function that returns the corners in a grey image, none if it is not there."""


def described_pattern(described: ImportDescription) -> LookedFor | None:
    """Return the patterns that import.yml describes, together; None if it describes none that is printed.

    Raises:
        InputError: a description is wrong.
    """
    detectors = {
        each.name: corner_detector(pattern_configuration(each, described.root))
        for each in described.patterns
        if each.is_printed
    }
    return LookedFor(", ".join(detectors), lambda image: _detect_best(image, detectors)) if detectors else None


def _detect_best(image: Image, detectors: Mapping[str, CornerDetector]) -> CornerLabels:
    seen = [each.detect(image) for each in detectors.values()]
    found = [(i, each) for i, each in enumerate(seen) if isinstance(each, CornerLabels)]
    if not found:
        return NO_LABELS
    ids = [each.ids + (i << 32) for i, each in found]  # of several patterns, different ones
    return CornerLabels(np.concatenate(ids), np.concatenate([each.pixels for _, each in found]))


def pattern_in(images: Sequence[Image]) -> LookedFor | None:
    """Return the pattern that grey images show; None without any.

    A board with markers of a known dictionary, a chessboard, a grid of circles, or single tags.
    """
    some = [_reduce_image(image)[0] for image in images[:: -(-len(images) // near_miss.LOOKED_AT)]] if images else []
    markers = near_miss.shown_markers(some)
    if board := near_miss.shown_board(markers):
        return _board_with(*board)
    if pattern := near_miss.shown_chessboard(some) or near_miss.shown_circles(some) or near_miss.shown_tags(markers):
        return _as_looked_for(pattern)
    board = (
        near_miss.shown_board(
            near_miss.shown_markers(some[:: -(-len(some) // near_miss.MAX_BOARD_SEARCHES)], small=True)
        )
        if some
        else None
    )
    return _board_with(*board) if board else None


def _board_with(family: near_miss.Family, highest: int) -> LookedFor:
    finder = family.finder()

    def find(image: Image) -> CornerLabels:
        small, scale = _reduce_image(image)
        found = finder.find(small)
        if len(found) < near_miss.MIN_BOARD_MARKERS:
            found = finder.find_small(small)
        if len(found) < near_miss.MIN_BOARD_MARKERS:
            return NO_LABELS
        ids = 4 * np.repeat(found.ids, 4) + np.tile(np.arange(4), len(found))
        return CornerLabels(ids, found.corners.reshape(-1, 2) * scale)

    return LookedFor(f"markers of {family.named(highest)}, ids up to {highest}", find)


def _as_looked_for(pattern: PatternConfiguration) -> LookedFor:
    columns, rows = pattern.dimension
    if pattern.tags:
        name = f"tags {', '.join(str(tag.id) for tag in pattern.tags)} of {pattern.dictionary}"
    else:
        name = f"{pattern.kind} of {columns} x {rows}" + (" corners" if pattern.kind == "chessboard" else "")
    detectors = {name: corner_detector(pattern)}

    def find(image: Image) -> CornerLabels:
        small, scale = _reduce_image(image)
        found = _detect_best(small, detectors)
        return CornerLabels(found.ids, found.pixels * scale)

    return LookedFor(name, find)


def _reduce_image(image: Image) -> tuple[Image, float]:
    """Return an image no larger than `MAX_SEARCHED_SIDE`, and the size of its pixels in those of the image."""
    scale = max(image.shape) / MAX_SEARCHED_SIDE
    if scale <= 1:
        return image, 1.0
    return np.asarray(cv2.resize(image, None, fx=1 / scale, fy=1 / scale, interpolation=cv2.INTER_AREA)), scale


@dataclass(frozen=True, eq=False)
class Sample:
    """Images of a camera, evenly chosen."""

    images: Sequence[Image]
    """Grey."""
    pairs: Sequence[tuple[int, int]]
    """Images of them that follow each other within `MAX_GAP_SECONDS`."""
    other_size: str
    """Size of an image that is not that of the first; empty if all have one."""
    fault: str
    """Why the other images cannot be decoded; empty if all can."""


@dataclass(frozen=True, eq=False)
class MeasuredImage:
    """What is measured on an image."""

    brightness: float
    """Median of the pixels."""
    white: float
    """Level that a tenth of the pixels exceeds, on the pattern if it is found."""
    saturated: float
    """Share of saturated pixels, likewise."""
    blur_px: float | None
    corners: CornerLabels


def sample(source: ImageSource) -> Sample:
    """Decode evenly chosen images; where they follow each other within `MAX_GAP_SECONDS`, pairs of consecutive ones."""
    wanted = _choose_images(source)
    images: list[Image] = []
    other, fault = "", ""
    try:
        for image in source.images(wanted):
            images.append(grey(image))
            if images[-1].shape != images[0].shape:
                other = f"{image.shape[1]} x {image.shape[0]}"
            if sum(each.size for each in images) > MAX_HELD_PIXELS:
                break
    except InputError as error:
        fault = str(error)
    pairs = [(i, i + 1) for i in range(len(images) - 1) if _are_successive(source, wanted[i], wanted[i + 1])]
    return Sample(images, pairs, other, fault)


def _choose_images(source: ImageSource) -> list[int]:
    times, count = source.times, source.count
    paired = times is not None and count > MAX_IMAGES and np.median(np.diff(times)) <= MAX_GAP_SECONDS * NS_PER_S
    most = MAX_IMAGES // 2 if paired else MAX_IMAGES
    places = np.linspace(0, count - 1 - paired, min(count, most)).round().astype(int).tolist()
    return sorted({each + more for each in places for more in range(1 + paired)})


def _are_successive(source: ImageSource, one: int, other: int) -> bool:
    return source.times is not None and source.times[other] - source.times[one] <= MAX_GAP_SECONDS * NS_PER_S


def measured(image: Image, pattern: LookedFor | None) -> MeasuredImage:
    """Measure a grey image."""
    corners = pattern.find(image) if pattern else NO_LABELS
    part = image
    if len(corners.ids):
        left, top = np.maximum(corners.pixels.min(0), 0).astype(int)
        right, bottom = np.ceil(corners.pixels.max(0)).astype(int) + 1
        part = image[top:bottom, left:right]
    return MeasuredImage(
        float(np.median(image)),
        float(np.quantile(part, 0.9)),
        float((part >= MIN_SATURATED_LEVEL).mean()),
        blur_of(part),
        corners,
    )


def blur_of(image: Image) -> float | None:
    """Return the blur of the steepest edges of a grey image, standard deviation in px; None without edges.

    A step that is blurred by ``s`` has the slope ``1 / sqrt(s^2 + f^2)`` after a filter of ``f``, so two filters give
    ``s`` (Zhuo and Sim, Defocus map estimation from a single image, 2011).
    """
    slopes = []
    for width in (NARROW_FILTER_PX, WIDE_FILTER_PX):
        smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), width)
        slopes.append(np.hypot(cv2.Scharr(smooth, -1, 1, 0), cv2.Scharr(smooth, -1, 0, 1)) / 32)
    steep = slopes[0] >= max(LEAST_STEP, float(np.quantile(slopes[0], 1 - STEEPEST_EDGE_SHARE)))
    if not steep.any():
        return None
    ratio = float(np.median(slopes[0][steep] / np.maximum(slopes[1][steep], 1e-6))) ** 2
    variance = (WIDE_FILTER_PX**2 - ratio * NARROW_FILTER_PX**2) / max(ratio - 1, 1e-3)
    return float(np.sqrt(max(variance - SAMPLING_VARIANCE, 0.0)))


def is_still(one: CornerLabels, other: CornerLabels) -> bool | None:
    """Whether the common corners of two images are where they were; None without any."""
    _, i, j = np.intersect1d(one.ids, other.ids, return_indices=True)
    if not len(i):
        return None
    return bool(np.median(np.linalg.norm(one.pixels[i] - other.pixels[j], axis=-1)) <= MAX_STILL_MOTION_PX)
