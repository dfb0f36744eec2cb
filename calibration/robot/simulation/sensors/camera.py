"""Simulated cameras: their lenses as in ``simulation.yml``, images of patterns, and the corners in them.

A detector finds a corner by the print around it, so a corner counts as seen if its four squares (for an
aprilgrid the tag, the gaps and the square between them; for a circle the four cells between it and its neighbours) are
in the image, large enough and not occluded. Our detector finds nearly all of these, and some more.
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

from calibration.base import InputError
from calibration.base.arrays import Array, BoolArray
from calibration.base.records import Converted, Misfit, between, excludes, field, one_of, record
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.modalities import RGB, Modality, NoiseKind
from calibration.engine.dataset.model import CornerLabels, Labels
from calibration.engine.dataset.pattern import UNMARKED_KINDS, Pattern, grid, staggered_grid, tag_lines
from calibration.engine.estimation.options import LensModel
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import MODELS
from calibration.engine.geometry.lenses.model import IN_FRONT
from calibration.engine.geometry.transforms import apply
from calibration.robot.labelling.corner_detector import corner_detector
from calibration.robot.labelling.detection import CornerDetector, Image
from calibration.robot.simulation.rendering.background import STEPS_PER_GREY_LEVEL
from calibration.robot.simulation.rendering.image import radiance
from calibration.robot.simulation.scene import Board, Scene, listed
from calibration.robot.simulation.sensors.sensor import (
    LEAST_SHARE,
    PICTURE_HEIGHT_PX,
    Data,
    Found,
    SimulatedSensor,
    Views,
    blank,
    corners_in_image,
    draw_corner,
    facing,
)

MAX_PIXELS = 25_000_000
"""Limit of an image's pixels: beyond it memory runs out."""
MAX_PINHOLE_HFOV_DEG, MAX_HFOV_DEG = 170, 350
"""Limits of the field of view of a pinhole and of other lenses, deg."""
_SIZE_IN_PIXELS = between(2, 100_000)


def _is_camera_matrix(K: tuple[float, ...]) -> bool:
    fx, skew, _, zero, fy, _, *last = K
    return min(fx, fy) > 0 and not skew and not zero and last == [0, 0, 1]


_CAMERA_MATRIX = listed(9, "[fx, 0, cx, 0, fy, cy, 0, 0, 1] with fx and fy above 0", _is_camera_matrix)


@record(
    case="snake",
    nulls=True,
    rules=(
        excludes("K", "hfov_deg"),
        excludes("K", "principal_point"),
        one_of("hfov_deg", "K", why="found neither hfov_deg nor K, expected one of them"),
    ),
)
class Lens:
    """Lens of a camera: its intrinsics and its distortion."""

    width: Annotated[int, _SIZE_IN_PIXELS] = field("Width of the image, px.")
    height: Annotated[int, _SIZE_IN_PIXELS] = field("Height of the image, px.")
    hfov_deg: Annotated[float, between(1, MAX_HFOV_DEG)] | None = field("Horizontal field of view, deg.", default=None)
    principal_point: Annotated[tuple[float, float], listed(2, "two numbers: cx, cy")] | None = field(
        "Principal point, px; by default Gazebo's, half a pixel beyond the centre.", default=None
    )
    K: Annotated[tuple[float, ...], _CAMERA_MATRIX] | None = field(
        "Camera matrix, row by row, in place of hfov_deg and principal_point.", default=None, key="K"
    )
    distortion_model: LensModel = field("Distortion model, by ROS's name.", default="plumb_bob")
    distortion: tuple[float, ...] | None = field(
        "Coefficients of the model; zeros where absent, but for eucm, double_sphere and omni those of the "
        "stereographic projection.",
        default=None,
    )

    def __post_init__(self) -> None:
        """Check the size of the image, and the number of coefficients."""
        if self.width * self.height > MAX_PIXELS:
            raise Misfit(f"found {self.width} x {self.height} pixels, expected {MAX_PIXELS} at most", "width")
        names = MODELS[self.distortion_model].names()
        if self.distortion is not None and len(self.distortion) != len(names):
            found = f"found a list of {len(self.distortion)}, expected a list of {len(names)}: {', '.join(names)}"
            raise Misfit(found, "distortion")
        if self.hfov_deg is not None and self.hfov_deg > (widest := self._widest_hfov_deg()):
            raise Misfit(f"found {self.hfov_deg:g}, expected a number from 1 to {widest:g}", "hfov_deg")

    def _widest_hfov_deg(self) -> float:
        """Return the largest field of view in whole degrees that the lens model can have, at most `MAX_HFOV_DEG`."""
        model = MODELS[self.distortion_model]
        if model.chart is IN_FRONT:
            return MAX_PINHOLE_HFOV_DEG
        lens = model(*(model.start if self.distortion is None else self.distortion))
        degrees = np.arange(1, MAX_HFOV_DEG + 1)
        return float(degrees[lens.sees(np.cos(np.radians(degrees) / 2))].max(initial=1))

    @property
    def camera(self) -> Camera:
        """Camera model."""
        model = MODELS[self.distortion_model]
        distortion = model(*(model.start if self.distortion is None else self.distortion))
        if self.K is not None:
            fx, _, cx, _, fy, cy, *_ = self.K
            return Camera(fx, fy, cx, cy, self.width, self.height, distortion)
        half = math.radians(self.hfov_deg or 0.0) / 2
        bent = distortion if model.is_wide else model()
        fx = self.width / 2 / float(bent.distort(np.array([model.chart.radius(half)]), np.zeros(1))[0][0])
        cx, cy = self.principal_point or (self.width / 2 + 0.5, self.height / 2 + 0.5)
        return Camera(fx, fx, cx, cy, self.width, self.height, distortion)


CAMERA_OF_LENS = Converted(Lens, lambda lens, _: lens.camera)
"""Camera model with the keys of `Lens`."""


CORNER_NOISE = 0.05
"""Standard deviation of a detected corner in a simulated image, each of x and y, px: 0.035 to 0.05 in
the example systems.
"""
JPEG_QUALITY = 88
COVERAGE_CELLS = (4, 3)
"""Columns and rows of an image's cells: a motion should have corners in each."""
LEAST_SQUARE = 14.0
"""Minimum width of a square in the image, px. At 12 our detector finds 98 % of the corners (markers of 7 bits
on 3/4 of a square, blur 0.65 px), at 10 it finds 60 %.
"""
LEAST_TAG = 18.0
"""Minimum width of an aprilgrid's tag in the image, px. At 17 our detector finds all corners, at 14 a quarter."""
_ROWS_PER_BATCH = 64
"""Number of rows of an image per batch, which fit into the cache."""
_FIELD_OF_OPTICS_KEY = {"exposure": "exposure", "noise_levels": "noise", "blur_px": "blur", "vignetting": "vignetting"}
"""Fields of a camera by a scenario's keys."""
_COEFFICIENT_KEYS = ("k1", "k2", "p1", "p2", "k3")
"""A scenario's keys of the distortion coefficients."""


@record(case="snake", nulls=True)
class SimulatedCamera(SimulatedSensor):
    """Camera with its lens and image sensor."""

    modality: ClassVar[Modality] = RGB
    label_name: ClassVar[str] = "corners"
    file_ending: ClassVar[str] = "jpg"
    scenario_group: ClassVar[str] = "cameras"

    camera: Annotated[Camera, CAMERA_OF_LENS] = field(flat=True)
    blur: Annotated[float, between(0, 20)] = field(
        "Standard deviation of the lens's Gaussian blur, px.", default=0.65, key="blur_px"
    )
    noise: Annotated[float, between(0, 255)] = field(
        "Standard deviation of a pixel's brightness, grey levels; the same on its three colours.",
        default=2.0,
        key="noise_levels",
    )
    vignetting: Annotated[float, between(0, 1)] = field(
        "Darkening of the image's corners relative to its centre, 0 to 1.", default=0.1
    )
    exposure: Annotated[float, between(0, 100)] = field("Factor on the light.", default=1.0)

    def with_values(self, name: str, values: Mapping[str, float]) -> Self:
        """Return the camera with other optics and distortion coefficients."""
        lens = self.camera.distortion
        coefficients = dict(zip(lens.names(), lens.coefficients.tolist(), strict=True))
        for key in _COEFFICIENT_KEYS:
            if key in values and key not in coefficients:
                raise InputError(f"scenario: '{key}' of '{name}': its distortion model {lens.ros_name} has none")
            coefficients.update({key: values[key]} if key in values else {})
        distortion = lens.with_coefficients(np.array(list(coefficients.values())))
        optics = {field: values[key] for key, field in _FIELD_OF_OPTICS_KEY.items() if key in values}
        return replace(self, camera=replace(self.camera, distortion=distortion), **optics)

    @property
    def intrinsics(self) -> Camera:
        """Intrinsics."""
        return self.camera

    def render(
        self, T_world_sensor: Array, scene: Scene, boards: Sequence[Board], random: np.random.Generator
    ) -> Image:
        """Render the image (height, width, 3) in blue, green, red.

        Raises:
            InputError: a pattern cannot be printed (see `calibration.robot.simulation.rendering.texture.texture`).
        """
        return self.expose(radiance(self.camera, T_world_sensor, scene, boards), random)

    def expose(self, light: NDArray[np.uint16], random: np.random.Generator) -> Image:
        """Convert light (height, width, 3), in `STEPS_PER_GREY_LEVEL`, to an 8-bit image (height, width, 3).

        Applies blur, vignetting, exposure, noise and quantisation. The noise is of brightness: one number per pixel,
        equal in its three colours, and drawn for every pixel whatever it sees. Overexposed pixels are white.
        """
        noise = random.standard_normal(light.shape[:2], dtype=np.float32)
        noise *= np.float32(self.noise)
        gain = _vignetting_gain(self.camera, self.vignetting) * np.float32(self.exposure / STEPS_PER_GREY_LEVEL)
        planes = [np.empty(noise.shape, np.uint8) for _ in range(3)]
        for blurred, levels in zip(cv2.split(_blur_radiance(light, self.blur)), planes, strict=True):
            for row in range(0, len(levels), _ROWS_PER_BATCH):
                part = slice(row, row + _ROWS_PER_BATCH)
                # the sum is rounded and kept within 8 bits
                exposed = cv2.multiply(blurred[part], gain[part], dtype=cv2.CV_32F)
                cv2.add(exposed, noise[part], levels[part], dtype=cv2.CV_8U)
        return np.asarray(cv2.merge(planes), np.uint8)

    def message(self, data: Data) -> dict[str, Any]:
        """Return the fields of an Image."""
        return image_message(self.camera, "bgr8", 3)

    def encode(self, data: Data) -> bytes:
        """Encode as JPEG."""
        return encode_image(data, ".jpg", [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])

    def label(self, data: Data, pattern: PatternConfiguration, T_sensor_pattern: Array) -> Found:
        """Detect the corners; the expected pose is not used."""
        return _cached_detector(pattern).detect(data)

    def label_document(self, found: Found) -> dict[str, Any]:
        """Return the corners by id."""
        if not isinstance(found, CornerLabels):
            return {"detected": False, "idxs": []}
        rows = zip(found.ids.tolist(), found.pixels.tolist(), strict=True)
        return {"detected": True, "idxs": [{"id": i, "x": x, "y": y} for i, (x, y) in rows]}

    def detects(self, views: Views) -> BoolArray:
        """Return a mask (N,) of the poses with enough visible corners, from the front."""
        return self.corner_views(views).detectable

    def expected_labels(self, views: Views) -> dict[int, Labels]:
        """Return the visible corners."""
        corners = self.corner_views(views)
        found: dict[int, Labels] = {}
        for pose in np.flatnonzero(corners.detectable).tolist():
            ids = np.flatnonzero(corners.seen[pose])
            found[pose] = CornerLabels(ids, corners.pixels[pose, ids])
        return found

    def noise_levels(self, distance: float) -> dict[NoiseKind, float]:
        """Return the noise of corners."""
        return {"pixel": CORNER_NOISE}

    def shows_centre(self, views: Views) -> BoolArray:
        """Return a mask (N,) of the poses with the pattern's centre in the image, facing the camera; fast."""
        centre = views.pattern.centre
        _, visible = corners_in_image(self.camera, apply(views.T_sensor_pattern, centre[None]))
        return visible[:, 0] & facing(views.T_sensor_pattern, centre)

    def corner_views(self, views: Views) -> "CornerViews":
        """Return the visibility of a pattern's corners."""
        if views.configuration.kind == "tags":
            return self._tag_views(views)
        squares, least = square_corners(views.configuration, views.pattern), least_widths(views.configuration)
        rows, columns = squares.shape[:2]
        places = squares.reshape(-1, 3)
        pixels, visible = corners_in_image(self.camera, apply(views.T_sensor_pattern, places))
        visible &= ~views.hidden(places)
        pixels, visible = pixels.reshape(-1, rows, columns, 2), visible.reshape(-1, rows, columns)
        with np.errstate(invalid="ignore"):
            clear = _all_four(visible) & (_square_widths(pixels) >= least)
        seen = _all_four(clear).reshape(len(clear), (rows - 2) * (columns - 2))
        share = 1.0 if views.pattern.kind in UNMARKED_KINDS else LEAST_SHARE  # all or none
        front = facing(views.T_sensor_pattern, views.pattern.centre)
        return CornerViews(
            pixels=pixels[:, 1:-1, 1:-1].reshape(*seen.shape, 2),
            seen=seen,
            partial=~np.all(visible[:, 1:-1, 1:-1], axis=(1, 2)),
            detectable=front & (seen.mean(-1) >= share),
        )

    def _tag_views(self, views: Views) -> "CornerViews":
        """`corner_views` of a list of tags: each is seen as a whole."""
        places = views.pattern.corners
        pixels, visible = corners_in_image(self.camera, apply(views.T_sensor_pattern, places))
        visible &= ~views.hidden(places)
        tags = pixels.reshape(len(pixels), -1, 4, 2)
        with np.errstate(invalid="ignore"):
            widths = _square_widths(tags[:, :, [0, 1, 3, 2]].reshape(-1, 2, 2, 2)).reshape(tags.shape[:2])
            seen = visible.reshape(tags.shape[:3]).all(-1) & (widths >= LEAST_TAG)
        front = facing(views.T_sensor_pattern, views.pattern.centre)
        partial: BoolArray = ~np.all(visible, axis=-1)
        return CornerViews(pixels, np.repeat(seen, 4, axis=1), partial, front & seen.any(-1))

    def draw(
        self, message: Mapping[str, Any], labels: Sequence[Mapping[str, Any]], patterns: Sequence[Pattern], files: Path
    ) -> Image:
        """Draw the image with the corners coloured by their order."""
        scale = PICTURE_HEIGHT_PX / self.camera.height
        size = (max(1, round(scale * self.camera.width)), PICTURE_HEIGHT_PX)
        file = files / message["data_file"]
        image = cv2.imread(str(file), cv2.IMREAD_COLOR) if file.is_file() else None  # or it warns
        picture = blank(size[0]) if image is None else cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        paler = cv2.convertScaleAbs(picture, alpha=0.8, beta=40)  # for the contrast of the marks
        drawn: Image = np.asarray(paler, np.uint8)
        for label, pattern in zip(labels, patterns, strict=True):
            for corner in label["idxs"]:
                at = scale * (np.array([corner["x"], corner["y"]]) + 0.5) - 0.5
                draw_corner(drawn, at, corner["id"] / len(pattern.corners))
        return drawn


@dataclass(frozen=True, eq=False)
class CornerViews:
    """Visibility of the K corners of a pattern in a camera's images at N poses."""

    pixels: Array
    """(N, K, 2); NaN behind the camera."""
    seen: BoolArray
    """(N, K): corners that are reliably detected."""
    partial: BoolArray
    """(N,): some corners are outside of the image or occluded."""
    detectable: BoolArray
    """(N,): enough corners, from the front."""

    def cells(self, camera: Camera) -> BoolArray:
        """Return a mask (N, columns * rows) of the cells of the image with a corner."""
        columns, rows = COVERAGE_CELLS
        with np.errstate(invalid="ignore"):
            place = (self.pixels + 0.5) / [camera.width, camera.height] * COVERAGE_CELLS
        column, row = np.moveaxis(np.where(self.seen[..., None], place, -1).astype(int), -1, 0)
        cell = np.where(self.seen, row.clip(max=rows - 1) * columns + column.clip(max=columns - 1), -1)
        return np.asarray((cell[..., None] == np.arange(columns * rows)).any(-2))


@lru_cache
def _cached_detector(pattern: PatternConfiguration) -> CornerDetector:
    return corner_detector(pattern)


def image_message(camera: Camera, encoding: str, bytes_per_pixel: int) -> dict[str, Any]:
    """Return the fields of a ROS Image."""
    image = {"height": camera.height, "width": camera.width, "is_bigendian": 0}
    return {**image, "encoding": encoding, "step": bytes_per_pixel * camera.width}


def encode_image(image: Data, ending: str, options: list[int]) -> bytes:
    """Encode an image file."""
    done, data = cv2.imencode(ending, image, options)
    if not done:
        raise AssertionError(f"OpenCV cannot write {ending}")
    return bytes(data)


def _blur_radiance(light: NDArray[np.uint16], sigma: float) -> NDArray[np.uint16]:
    """Blur with integer arithmetic, which is equal on all machines."""
    if sigma <= 0:
        return light
    size = 2 * math.ceil(3 * sigma) + 1
    return np.asarray(cv2.GaussianBlur(light, (size, size), sigma), np.uint16)


@lru_cache(maxsize=8)
def _vignetting_gain(camera: Camera, vignetting: float) -> NDArray[np.float32]:
    """Return the gain (height, width): 1 on the optical axis, falling like cos^4 of the angle to it."""
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height)[:, None] - camera.cy) / camera.fy
    loss = 1 - 1 / (1 + x * x + y * y) ** 2
    return (1 - vignetting * loss / max(float(loss.max()), 1e-12)).astype(np.float32)


def square_corners(configuration: PatternConfiguration, pattern: Pattern) -> Array:
    """Return the corners of all squares (rows + 2, columns + 2, 3), with the pattern's (rows, columns) inside.

    For an aprilgrid: of the tags, of the gaps between them and around them, and of the squares at their crossings.
    """
    (columns, rows), square = configuration.dimension, configuration.size
    if configuration.kind == "aprilgrid":
        x, y = (_tag_lines(configuration, n) for n in (columns, rows))
        lines = np.meshgrid(pattern.corners[0, 0] + x, pattern.corners[0, 1] - y)
        return np.stack([*lines, np.zeros(lines[0].shape)], -1)
    if configuration.kind == "asymmetric-circles":
        around = staggered_grid(columns + 2, rows + 2, square)
        around[:, 0] -= 2 * square  # its second row is the pattern's first, which is not shifted
        around[:, 0] += square * np.where(np.arange(len(around)) // (columns + 2) % 2 == 0, 1, -1)
        return (around - [0, square, 0]).reshape(rows + 2, columns + 2, 3)
    x, y = pattern.corners[0, :2] - square
    return grid(columns + 2, rows + 2, square, (float(x), float(y))).reshape(rows + 2, columns + 2, 3)


def least_widths(configuration: PatternConfiguration) -> Array:
    """Return the minimum widths (rows + 1, columns + 1) or (1, 1) of the squares of `square_corners`, px."""
    if configuration.kind != "aprilgrid":
        return np.full((1, 1), LEAST_SQUARE)
    x, y = (np.diff(_tag_lines(configuration, n)) / configuration.size for n in configuration.dimension)
    return LEAST_TAG * np.minimum(x, y[:, None])


def _tag_lines(configuration: PatternConfiguration, count: int) -> Array:
    """Return the begins and ends of tags, with the gaps before and after them, m."""
    lines, gap = tag_lines(count, configuration.size, configuration.spacing), configuration.spacing * configuration.size
    return np.concatenate([[-gap], lines, [lines[-1] + gap]])


def _all_four(of: BoolArray) -> BoolArray:
    """Return a mask (N, R - 1, C - 1) of the cells of a grid (N, R, C) with all four nodes set."""
    return of[:, :-1, :-1] & of[:, :-1, 1:] & of[:, 1:, :-1] & of[:, 1:, 1:]


def _square_widths(pixels: Array) -> Array:
    """Return the widths (N, R - 1, C - 1) of squares with corners (N, R, C, 2): area over longer side, px."""
    along = pixels[:, :-1, 1:] - pixels[:, :-1, :-1]
    down = pixels[:, 1:, :-1] - pixels[:, :-1, :-1]
    area = np.abs(along[..., 0] * down[..., 1] - along[..., 1] * down[..., 0])
    longer = np.maximum(np.hypot(*np.moveaxis(along, -1, 0)), np.hypot(*np.moveaxis(down, -1, 0)))
    return np.asarray(area / np.maximum(longer, 1e-300))
