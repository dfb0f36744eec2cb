"""Cameras: images of patterns, and the corners in them.

A detector finds a corner by what is printed around it, so a corner counts as seen where its four squares (of an
aprilgrid the tag, the gaps and the square between them) are on the image, large enough, with nothing before them. Ours
finds nearly all of these, and some more.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.dataset.configuration import PatternConfiguration
from calibration.dataset.modalities import RGB, Modality, NoiseKind
from calibration.dataset.model import CornerLabels, Labels
from calibration.dataset.pattern import Pattern, grid, tag_lines
from calibration.errors import InputError
from calibration.geometry.cameras import Camera
from calibration.geometry.transforms import apply
from calibration.geometry.types import Array, BoolArray
from calibration.labelling.corner_detector import corner_detector
from calibration.labelling.detection import CornerDetector, Image
from calibration.records import between, field, record
from calibration.simulation.board import Board
from calibration.simulation.rendering.background import STEPS
from calibration.simulation.rendering.image import radiance
from calibration.simulation.scene import Scene
from calibration.simulation.sensors.drawing import HEIGHT, blank, draw_corner
from calibration.simulation.sensors.lens import LENS
from calibration.simulation.sensors.sensor import (
    LEAST_SHARE,
    Data,
    Found,
    SimulatedSensor,
    Views,
    corners_in_image,
    facing,
)

CORNER_NOISE = 0.05
"""The standard deviation of a corner that is detected in a simulated image, each of x and y, px: 0.035 to 0.05 in
the systems that ship."""
JPEG_QUALITY = 88
CELLS = (4, 3)
"""An image's columns and rows of cells: a motion shows the pattern's corners in each."""
LEAST_SQUARE = 14.0
"""The width of a square in the image, px. At 12 our detector finds 98 % of the corners (markers of 7 bits
on 3/4 of a square, blur 0.65 px), at 10 it finds 60 %."""
LEAST_TAG = 18.0
"""The width of an aprilgrid's tag in the image, px. At 17 our detector finds all corners, at 14 a quarter of them."""
_ROWS = 64
"""So many rows of an image are worked on at a time: they stay in the cache."""
_OPTICS = {"exposure": "exposure", "noise_levels": "noise", "blur_px": "blur", "vignetting": "vignetting"}
"""The fields of a camera by a scenario's keys."""
_COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3")
"""A scenario's keys for those of the distortion."""


@record(case="snake", nulls=True)
class SimulatedCamera(SimulatedSensor):
    """A camera, and what its lens and its chip make of the light."""

    modality: ClassVar[Modality] = RGB
    label_name: ClassVar[str] = "corners"
    file_ending: ClassVar[str] = "jpg"
    scenario_group: ClassVar[str] = "cameras"

    camera: Annotated[Camera, LENS] = field(flat=True)
    blur: Annotated[float, between(0, 20)] = field(
        "Standard deviation of the lens's Gaussian blur, px.", default=0.65, key="blur_px"
    )
    noise: Annotated[float, between(0, 255)] = field(
        "Standard deviation of a pixel's brightness, grey levels; the same on its three colours.",
        default=2.0,
        key="noise_levels",
    )
    vignetting: Annotated[float, between(0, 1)] = field(
        "How much darker the corners of the image are than its middle, 0 to 1.", default=0.1
    )
    exposure: Annotated[float, between(0, 100)] = field("Factor on the light.", default=1.0)

    def with_values(self, name: str, values: Mapping[str, float]) -> Self:
        """With other optics, and other coefficients of its distortion."""
        lens = self.camera.distortion
        coefficients = dict(zip(lens.names(), lens.coefficients.tolist(), strict=True))
        for key in _COEFFICIENTS:
            if key in values and key not in coefficients:
                raise InputError(f"scenario: '{key}' of '{name}': its distortion model {lens.ros_name} has none")
            coefficients.update({key: values[key]} if key in values else {})
        distortion = lens.with_coefficients(np.array(list(coefficients.values())))
        optics = {field: values[key] for key, field in _OPTICS.items() if key in values}
        return replace(self, camera=replace(self.camera, distortion=distortion), **optics)

    @property
    def intrinsics(self) -> Camera:
        """The lens."""
        return self.camera

    def render(
        self, T_world_sensor: Array, scene: Scene, boards: Sequence[Board], random: np.random.Generator
    ) -> Image:
        """The image (height, width, 3) in blue, green, red.

        Raises:
            InputError: a pattern cannot be printed (see `calibration.simulation.rendering.texture.texture`).
        """
        return self.expose(radiance(self.camera, T_world_sensor, scene, boards), random)

    def expose(self, light: NDArray[np.uint16], random: np.random.Generator) -> Image:
        """The image (height, width, 3) of light (height, width, 3) in `STEPS` of a grey level.

        Blur, vignetting, exposure, noise, 8 bits. The noise is of brightness: one number for each pixel, the same on
        its three colours, and drawn for every pixel whatever it sees. What is too bright is white.
        """
        noise = random.standard_normal(light.shape[:2], dtype=np.float32)
        noise *= np.float32(self.noise)
        gain = _gain(self.camera, self.vignetting) * np.float32(self.exposure / STEPS)
        planes = [np.empty(noise.shape, np.uint8) for _ in range(3)]
        for blurred, levels in zip(cv2.split(_blurred(light, self.blur)), planes, strict=True):
            for row in range(0, len(levels), _ROWS):
                part = slice(row, row + _ROWS)
                # the sum is rounded and kept within 8 bits
                exposed = cv2.multiply(blurred[part], gain[part], dtype=cv2.CV_32F)
                cv2.add(exposed, noise[part], levels[part], dtype=cv2.CV_8U)
        return np.asarray(cv2.merge(planes), np.uint8)

    def message(self, data: Data) -> dict[str, Any]:
        """Of an Image."""
        del data
        return image_message(self.camera, "bgr8", 3)

    def encode(self, data: Data) -> bytes:
        """JPEG."""
        return encode_image(data, ".jpg", [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])

    def label(self, data: Data, pattern: PatternConfiguration, T_sensor_pattern: Array) -> Found:
        """The corners, wherever the pattern is."""
        del T_sensor_pattern
        return _detector(pattern).detect(data)

    def label_document(self, found: Found) -> dict[str, Any]:
        """The corners by id."""
        if not isinstance(found, CornerLabels):
            return {"detected": False, "idxs": []}
        rows = zip(found.ids.tolist(), found.pixels.tolist(), strict=True)
        return {"detected": True, "idxs": [{"id": i, "x": x, "y": y} for i, (x, y) in rows]}

    def detects(self, views: Views) -> BoolArray:
        """Where it sees enough corners, from in front."""
        return self.corner_views(views).detectable

    def expected_labels(self, views: Views) -> dict[int, Labels]:
        """The corners that are seen."""
        corners = self.corner_views(views)
        found: dict[int, Labels] = {}
        for pose in np.flatnonzero(corners.detectable).tolist():
            ids = np.flatnonzero(corners.seen[pose])
            found[pose] = CornerLabels(ids, corners.pixels[pose, ids])
        return found

    def noise_levels(self, distance: float) -> dict[NoiseKind, float]:
        """Of corners."""
        del distance
        return {"pixel": CORNER_NOISE}

    def shows_centre(self, views: Views) -> BoolArray:
        """At which poses (N,) the pattern's centre is on the image and turned to it; quick to tell."""
        centre = views.pattern.centre
        _, visible = corners_in_image(self.camera, apply(views.T_sensor_pattern, centre[None]))
        return visible[:, 0] & facing(views.T_sensor_pattern, centre)

    def corner_views(self, views: Views) -> "CornerViews":
        """What it sees of a pattern's corners."""
        squares, least = square_corners(views.configuration, views.pattern), least_widths(views.configuration)
        rows, columns = squares.shape[:2]
        places = squares.reshape(-1, 3)
        pixels, visible = corners_in_image(self.camera, apply(views.T_sensor_pattern, places))
        visible &= ~views.hidden(places)
        pixels, visible = pixels.reshape(-1, rows, columns, 2), visible.reshape(-1, rows, columns)
        with np.errstate(invalid="ignore"):
            clear = _all_four(visible) & (_widths(pixels) >= least)
        seen = _all_four(clear).reshape(len(clear), (rows - 2) * (columns - 2))
        share = 1.0 if views.pattern.kind == "chessboard" else LEAST_SHARE  # one is found whole or not at all
        front = facing(views.T_sensor_pattern, views.pattern.centre)
        return CornerViews(
            pixels=pixels[:, 1:-1, 1:-1].reshape(*seen.shape, 2),
            seen=seen,
            partial=~np.all(visible[:, 1:-1, 1:-1], axis=(1, 2)),
            detectable=front & (seen.mean(-1) >= share),
        )

    def draw(
        self, message: Mapping[str, Any], labels: Sequence[Mapping[str, Any]], patterns: Sequence[Pattern], files: Path
    ) -> Image:
        """The image with the corners in the colours of their order."""
        scale = HEIGHT / self.camera.height
        size = (max(1, round(scale * self.camera.width)), HEIGHT)
        file = files / message["data_file"]
        image = cv2.imread(str(file), cv2.IMREAD_COLOR) if file.is_file() else None  # it warns of one that is not there
        picture = blank(size[0]) if image is None else cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        paler = cv2.convertScaleAbs(picture, alpha=0.8, beta=40)  # so that the marks stand out
        drawn: Image = np.asarray(paler, np.uint8)
        for label, pattern in zip(labels, patterns, strict=True):
            for corner in label["idxs"]:
                at = scale * (np.array([corner["x"], corner["y"]]) + 0.5) - 0.5
                draw_corner(drawn, at, corner["id"] / len(pattern.corners))
        return drawn


@dataclass(frozen=True, eq=False)
class CornerViews:
    """The K corners of a pattern in a camera's images at N poses."""

    pixels: Array
    """(N, K, 2); NaN behind the camera."""
    seen: BoolArray
    """(N, K): those that are surely found."""
    partial: BoolArray
    """(N,): some corners are off the image or hidden."""
    detectable: BoolArray
    """(N,): enough corners, from in front."""

    def cells(self, camera: Camera) -> BoolArray:
        """In which cells (N, columns * rows) of the image there is a corner."""
        columns, rows = CELLS
        with np.errstate(invalid="ignore"):
            place = (self.pixels + 0.5) / [camera.width, camera.height] * CELLS
        column, row = np.moveaxis(np.where(self.seen[..., None], place, -1).astype(int), -1, 0)
        cell = np.where(self.seen, row.clip(max=rows - 1) * columns + column.clip(max=columns - 1), -1)
        occupied: BoolArray = (cell[..., None] == np.arange(columns * rows)).any(-2)
        return occupied


@lru_cache
def _detector(pattern: PatternConfiguration) -> CornerDetector:
    return corner_detector(pattern)


def image_message(camera: Camera, encoding: str, bytes_per_pixel: int) -> dict[str, Any]:
    """The fields of a ROS Image."""
    image = {"height": camera.height, "width": camera.width, "is_bigendian": 0}
    return {**image, "encoding": encoding, "step": bytes_per_pixel * camera.width}


def encode_image(image: Data, ending: str, options: list[int]) -> bytes:
    """The content of a file of an image."""
    done, data = cv2.imencode(ending, image, options)
    if not done:
        raise AssertionError(f"OpenCV cannot write {ending}")
    return bytes(data)


def _blurred(light: NDArray[np.uint16], sigma: float) -> NDArray[np.uint16]:
    """OpenCV's blur of whole numbers, which every machine computes alike."""
    if sigma <= 0:
        return light
    size = 2 * math.ceil(3 * sigma) + 1
    return np.asarray(cv2.GaussianBlur(light, (size, size), sigma), np.uint16)


@lru_cache(maxsize=8)
def _gain(camera: Camera, vignetting: float) -> NDArray[np.float32]:
    """(height, width): 1 on the optical axis, falling like cos^4 of the angle to it down to the farthest corner."""
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height)[:, None] - camera.cy) / camera.fy
    loss = 1 - 1 / (1 + x * x + y * y) ** 2
    gain: NDArray[np.float32] = (1 - vignetting * loss / max(float(loss.max()), 1e-12)).astype(np.float32)
    return gain


def square_corners(configuration: PatternConfiguration, pattern: Pattern) -> Array:
    """(rows + 2, columns + 2, 3): the corners of all squares, the pattern's (rows, columns) of them inside.

    Of an aprilgrid: of the tags, of the gaps between them and around them, and of the squares where these cross.
    """
    (columns, rows), square = configuration.dimension, configuration.size
    if configuration.kind == "aprilgrid":
        x, y = (_tag_lines(configuration, n) for n in (columns, rows))
        lines = np.meshgrid(pattern.corners[0, 0] + x, pattern.corners[0, 1] - y)
        return np.stack([*lines, np.zeros(lines[0].shape)], -1)
    x, y = pattern.corners[0, :2] - square
    return grid(columns + 2, rows + 2, square, (float(x), float(y))).reshape(rows + 2, columns + 2, 3)


def least_widths(configuration: PatternConfiguration) -> Array:
    """(rows + 1, columns + 1) or (1, 1): how wide each of the squares of `square_corners` must be in the image, px."""
    if configuration.kind != "aprilgrid":
        return np.full((1, 1), LEAST_SQUARE)
    x, y = (np.diff(_tag_lines(configuration, n)) / configuration.size for n in configuration.dimension)
    return LEAST_TAG * np.minimum(x, y[:, None])


def _tag_lines(configuration: PatternConfiguration, count: int) -> Array:
    """Where tags begin and end, and the gaps before and behind them, m."""
    lines, gap = tag_lines(count, configuration.size, configuration.spacing), configuration.spacing * configuration.size
    return np.concatenate([[-gap], lines, [lines[-1] + gap]])


def _all_four(of: BoolArray) -> BoolArray:
    """Which places (N, R - 1, C - 1) between the nodes of a grid (N, R, C) have all four nodes around them."""
    return of[:, :-1, :-1] & of[:, :-1, 1:] & of[:, 1:, :-1] & of[:, 1:, 1:]


def _widths(pixels: Array) -> Array:
    """(N, R - 1, C - 1): the width of each square with corners (N, R, C, 2), its area over its longer side, px."""
    along = pixels[:, :-1, 1:] - pixels[:, :-1, :-1]
    down = pixels[:, 1:, :-1] - pixels[:, :-1, :-1]
    area = np.abs(along[..., 0] * down[..., 1] - along[..., 1] * down[..., 0])
    longer = np.maximum(np.hypot(*np.moveaxis(along, -1, 0)), np.hypot(*np.moveaxis(down, -1, 0)))
    width: Array = area / np.maximum(longer, 1e-300)
    return width
