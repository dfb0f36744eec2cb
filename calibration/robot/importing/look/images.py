"""A sample of a camera's images, measured: brightness, sharpness, the pattern in them."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from calibration.base.errors import InputError
from calibration.engine.dataset.model import CornerLabels
from calibration.robot.importing.bags.stillness import MAX_GAP_SECONDS, MAX_STILL_MOTION_PX
from calibration.robot.importing.look.patterns import NO_LABELS, LookedFor
from calibration.robot.importing.look.sources import ImageSource
from calibration.robot.labelling.detection import Image, grey

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
NS_PER_S = 1e9


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
