"""Features of images: found, kept where they are seen again and again, and matched; and the file that keeps them.

SIFT (D. Lowe, "Distinctive image features from scale-invariant keypoints", 2004; its patent ran out in 2020) with the
square roots of its descriptors (R. Arandjelovic, A. Zisserman, "Three things everyone should know to improve object
retrieval", 2012), as OpenCV has it.

The file ``calibration-reference.json`` has what each fixed camera saw when its calibration was accepted: features and
their places, no images, so some ten kilobytes a camera. It is kept in git beside the baseline.
"""

import base64
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

import cv2
import numpy as np

from calibration.base import InputError, read_json
from calibration.base.arrays import Array, IntArray
from calibration.base.records import Misfit, at_least, between, field, length, matching, read, record, text_of
from calibration.engine.baseline.calibration_document import Name, Number
from calibration.engine.estimation.options import LensModel
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import MODELS
from calibration.robot.labelling.detection import Image

MAX_SIDE = 1280
"""px: larger images are reduced before features are looked for."""
MAX_FEATURES = 1200
"""Features of an image."""
MAX_KEPT = 500
"""Features of a camera that a reference keeps."""
MIN_SEEN_SHARE = 0.6
"""Least share of the reference's images in which a feature is seen at its place."""
PRUNED_EVERY = 4
"""Images after which features that were seen too seldom are dropped."""
SAME_PLACE_PX = 2.0
"""px: radius within which a feature of the reference is found again."""
NEAR_PX = 24.0
"""px: radius in which a match is looked for first, so that what repeats in the image is not taken for another."""
MAX_DISTANCE_RATIO = 0.8
"""Of the distances of the best and the second match (Lowe)."""
MIN_SIMILARITY = 0.75
"""Least cosine of two descriptors that match."""
SHARPNESS_FILTERS_PX = (1.5, 3.0)
"""px: standard deviations of the filters by which sharpness is measured."""
SHARPNESS_WINDOW_PX = 15
DESCRIPTOR_SIZE = 128
GRID = (12, 9)
"""Columns and rows of cells: features are spread over them, and those of one are taken for parts of one thing."""
REFERENCE_FILE = "calibration-reference.json"
MAX_REFERENCE_BYTES = 32_000_000
DESCRIPTOR_SCALE = 512
"""An element of a descriptor as a byte, as SIFT has them."""
Pixels = Annotated[int, between(1, 100_000)]
Base64 = Annotated[str, length(0, 4 * MAX_KEPT * DESCRIPTOR_SIZE)]


@dataclass(frozen=True, eq=False)
class Features:
    """Features of an image or of a scene."""

    pixels: Array
    """(N, 2)."""
    descriptors: Array
    """(N, 128), of length 1."""

    def __len__(self) -> int:
        return len(self.pixels)

    def taken(self, which: IntArray) -> "Features":
        """Return some of them."""
        return Features(self.pixels[which], self.descriptors[which])


NO_FEATURES = Features(np.zeros((0, 2)), np.zeros((0, DESCRIPTOR_SIZE), np.float32))


@cache
def _sift() -> Any:
    return cv2.SIFT.create(MAX_FEATURES, contrastThreshold=0.015, enable_precise_upscale=True)


def find_features(image: Image) -> Features:
    """Return the features of a grey image."""
    scale = max(1.0, max(image.shape) / MAX_SIDE)
    if scale > 1:
        image = np.asarray(cv2.resize(image, None, fx=1 / scale, fy=1 / scale, interpolation=cv2.INTER_AREA))
    points, found = _sift().detectAndCompute(image, None)
    if not points:
        return NO_FEATURES
    pixels = (np.array([each.pt for each in points]) + 0.5) * scale - 0.5
    _, once = np.unique(pixels.round(1), axis=0, return_index=True)  # one of several orientations
    return Features(pixels[once], _as_unit(found[once]))


def sharpness_at(image: Image, pixels: Array) -> float:
    """Return the sharpness of a grey image about places (N, 2), whatever its contrast: smaller where it is blurred.

    It is the median ratio of the gradient's energies after a narrow and a wide filter, of which a blur takes more from
    the first (S. Zhuo, T. Sim, "Defocus map estimation from a single image", 2011).
    """
    across, down = np.clip(pixels.round().astype(int), 0, np.array(image.shape[::-1]) - 1).T
    energies = []
    for width in SHARPNESS_FILTERS_PX:
        smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), width)
        energy = cv2.Scharr(smooth, -1, 1, 0) ** 2 + cv2.Scharr(smooth, -1, 0, 1) ** 2
        energies.append(cv2.blur(energy, (SHARPNESS_WINDOW_PX, SHARPNESS_WINDOW_PX))[down, across])
    return float(np.median(energies[0] / np.maximum(energies[1], 1e-6)))


def _as_unit(descriptors: Array) -> Array:
    """Return the square roots of descriptors, which are of length 1."""
    sums = np.maximum(descriptors.sum(1, keepdims=True), 1e-6)
    return np.asarray(np.sqrt(descriptors / sums), np.float32)


def match(kept: Features, seen: Features, radius: float | None = None) -> tuple[IntArray, IntArray]:
    """Return the indices of features that match, each the other's best; within a radius, px, if one is given."""
    if not len(kept) or len(seen) < 2:
        return np.zeros(0, int), np.zeros(0, int)
    alike = kept.descriptors @ seen.descriptors.T
    if radius is not None:
        apart = ((kept.pixels[:, None] - seen.pixels[None]) ** 2).sum(-1)
        alike = np.where(apart <= radius**2, alike, -1)
    best = alike.argmax(1)
    rows = np.arange(len(kept))
    score = alike[rows, best]
    mutual = alike.argmax(0)[best] == rows
    alike[rows, best] = -1
    second = alike.max(1)
    distinct = (1 - score) < MAX_DISTANCE_RATIO**2 * (1 - second)
    found = np.flatnonzero((score >= MIN_SIMILARITY) & mutual & distinct)
    return found, best[found]


def stable_features(images: Iterable[Image]) -> tuple[Features, int]:
    """Return the features that are at their place in most images, spread over the image, and the number of images."""
    known, counts, number = NO_FEATURES, np.zeros(0), 0
    sums = np.zeros((0, 2))
    for image in images:
        seen, number = find_features(image), number + 1
        at, other = match(known, seen, SAME_PLACE_PX)
        counts[at] += 1
        sums[at] += seen.pixels[other]
        new = np.setdiff1d(np.arange(len(seen)), other)
        descriptors = known.descriptors.copy()
        descriptors[at] += (seen.descriptors[other] - descriptors[at]) / counts[at][:, None]
        if number % PRUNED_EVERY == 0:
            often = np.flatnonzero(counts >= MIN_SEEN_SHARE * number / 2)
            known, sums, counts, descriptors = known.taken(often), sums[often], counts[often], descriptors[often]
        known = Features(
            np.concatenate([sums / counts[:, None], seen.pixels[new]]),
            np.concatenate([descriptors, seen.descriptors[new]]),
        )
        sums, counts = np.concatenate([sums, seen.pixels[new]]), np.concatenate([counts, np.ones(len(new))])
    often = np.flatnonzero(counts >= max(2, MIN_SEEN_SHARE * number))
    return known.taken(often[_spread(known.pixels[often], counts[often])]), number


def _spread(pixels: Array, counts: Array) -> IntArray:
    """Return the indices of features, the most often seen of each cell first, at most `MAX_KEPT`."""
    if not len(pixels):
        return np.zeros(0, int)
    cells = cells_of(pixels, pixels.max(0) + 1)
    order = np.lexsort((-counts, cells))
    starts = np.concatenate([[0], np.cumsum(np.bincount(cells))])
    rank = np.empty(len(pixels), int)
    rank[order] = np.arange(len(pixels)) - starts[cells[order]]
    return np.sort(np.lexsort((-counts, rank))[:MAX_KEPT])


def cells_of(pixels: Array, size: Array) -> IntArray:
    """Return the cell of the `GRID` in which each pixel (N, 2) is."""
    across, down = np.clip((pixels / size * GRID).astype(int), 0, np.array(GRID) - 1).T
    return np.asarray(down * GRID[0] + across)


@record(kw_only=True)
class KeptCamera:
    """A camera, and what it saw."""

    system: Name = field("Its system in the baseline.")
    sensor: Name = field("Its name there.")
    data: Annotated[str, matching("[0-9a-f]{64}", "64 hexadecimal digits")] = field(
        "SHA-256 of the labels of the accepted calibration."
    )
    place: Name = field("Topic, folder or file of its images.")
    width: Pixels = field("Of its images.", unit="px")
    height: Pixels = field("Of its images.", unit="px")
    model: LensModel = field("Lens model, as ROS names it.")
    intrinsics: Annotated[tuple[Number, ...], length(4, 40)] = field(
        "fx, fy, cx, cy and the coefficients, as accepted."
    )
    skew: Number = field("Lean of a pixel column.", unit="px", default=0.0)
    images: Annotated[int, at_least(1)] = field("Images that were looked at.")
    sharpness: Annotated[float, between(0, 1000)] = field("Median sharpness at the features.")
    pixels: Base64 = field("Places of the features: pairs of float32, little endian, in base64.")
    descriptors: Base64 = field("Their descriptors: 128 bytes each, in base64.")

    def __post_init__(self) -> None:
        """Refuse arrays that do not fit together.

        Raises:
            Misfit: names the key.
        """
        pixels = _bytes_of(self.pixels, "pixels", 8)
        if not np.isfinite(np.frombuffer(pixels, "<f4")).all():
            raise Misfit("found a number that is not finite", "pixels")
        if 16 * len(pixels) != len(_bytes_of(self.descriptors, "descriptors", DESCRIPTOR_SIZE)):
            raise Misfit(f"expected as many as pixels, {len(pixels) // 8}", "descriptors")
        if len(self.intrinsics) != len(self.camera.parameters) or min(self.intrinsics[:2]) <= 0:
            raise Misfit(f"expected {', '.join(self.camera.parameters)}, with focal lengths above 0", "intrinsics")

    @property
    def camera(self) -> Camera:
        """The camera with its accepted intrinsics."""
        lens = MODELS[self.model]()
        plain = Camera(1.0, 1.0, 0.0, 0.0, self.width, self.height, lens, self.skew)
        return plain.with_intrinsics(np.array(self.intrinsics))

    @property
    def features(self) -> Features:
        """The features, at least once with their descriptors."""
        pixels = np.frombuffer(base64.b64decode(self.pixels), "<f4").reshape(-1, 2).astype(float)
        values = (
            np.frombuffer(base64.b64decode(self.descriptors), np.uint8).reshape(-1, DESCRIPTOR_SIZE).astype(np.float32)
        )
        return Features(pixels, values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-6))


@record
class Reference:
    """What fixed cameras saw when their calibration was accepted."""

    version: Literal[1] = field("Version of this format.")
    cameras: Annotated[tuple[KeptCamera, ...], length(0, 1000)] = field("The cameras.")

    def updated(self, cameras: tuple[KeptCamera, ...]) -> "Reference":
        """Return it with other or further cameras."""
        known = {(each.system, each.sensor): each for each in (*self.cameras, *cameras)}
        return replace(self, cameras=tuple(known[key] for key in sorted(known)))

    @property
    def text(self) -> str:
        """The document."""
        return text_of(self)


def encoded_features(features: Features) -> tuple[str, str]:
    """Return the places and the descriptors of features in base64."""
    values = np.clip(np.round(features.descriptors * DESCRIPTOR_SCALE), 0, 255).astype(np.uint8)
    return _text_of_array(features.pixels.astype("<f4")), _text_of_array(values)


def read_reference(path: Path) -> Reference | None:
    """Read a reference; None if there is none.

    Raises:
        InputError: it is not valid; names file and key.
    """
    if path.is_symlink():
        raise InputError(f"{path}: found a symbolic link, expected the reference itself")
    if not path.exists():
        return None
    return read(Reference, read_json(path, MAX_REFERENCE_BYTES, "a reference"), str(path))


def _text_of_array(values: np.ndarray) -> str:
    return base64.b64encode(values.tobytes()).decode()


def _bytes_of(text: str, key: str, size: int) -> bytes:
    try:
        found = base64.b64decode(text, validate=True)
    except ValueError:  # of binascii too, and of letters beyond ASCII
        raise Misfit("found no base64, expected it", key) from None
    if len(found) % size or len(found) > MAX_KEPT * size:
        raise Misfit(f"found {len(found)} bytes, expected {size} for each of at most {MAX_KEPT} features", key)
    return found
