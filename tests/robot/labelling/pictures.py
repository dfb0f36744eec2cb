"""Pictures of boards, drawn by their definition: a ray for each part of a pixel meets the board's plane."""

from dataclasses import dataclass, field
from functools import cache

import cv2
import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import PlumbBob
from calibration.engine.geometry.transforms import apply, transform
from calibration.robot.labelling.detection import Image

TEXELS = 64
STEP = 2
"""Pixels between two whose rays are computed."""
LENS = PlumbBob(-0.25, 0.08, 0.0008, -0.0005, 0.0)
VGA = Camera(554.25, 554.25, 319.5, 239.5, 640, 480)
HD = Camera(900.0, 900.0, 639.5, 359.5, 1280, 720)
HD_DISTORTED = Camera(900.0, 900.0, 639.5, 359.5, 1280, 720, LENS)


def charuco(columns: int = 11, rows: int = 8, size: float = 0.06, dictionary: str = "DICT_5X5_100"):
    return PatternConfiguration(
        "board", "charuco", "board", "world", False, (columns, rows), size, 0.75 * size, (0.04, 0.03), dictionary
    )


def chessboard(columns: int = 10, rows: int = 7, size: float = 0.06) -> PatternConfiguration:
    return PatternConfiguration(
        "board", "chessboard", "board", "world", False, (columns, rows), size, None, (0.06, 0.06)
    )


@cache
def printed(pattern: PatternConfiguration, legacy: bool = False) -> Image:
    """The print, `TEXELS` a square or a tag, with half of that of white around; black at the top left."""
    if pattern.kind == "aprilgrid":
        return cv2.copyMakeBorder(_tags(pattern), *[TEXELS // 2] * 4, cv2.BORDER_CONSTANT, value=255)
    columns, rows = (n + 1 for n in pattern.dimension)
    if pattern.kind == "charuco":
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, pattern.dictionary))
        board = cv2.aruco.CharucoBoard((columns, rows), 1.0, pattern.inner_size / pattern.size, dictionary)
        board.setLegacyPattern(legacy)
        squares = board.generateImage((columns * TEXELS, rows * TEXELS), marginSize=0, borderBits=1)
    else:
        squares = np.kron(np.indices((rows, columns)).sum(0) % 2 * 255, np.ones((TEXELS, TEXELS))).astype(np.uint8)
    half = TEXELS // 2
    return cv2.copyMakeBorder(squares, half, half, half, half, cv2.BORDER_CONSTANT, value=255)


def _tags(pattern: PatternConfiguration) -> Image:
    """Kalibr's print: tags upside down as OpenCV sees them, from the bottom left, and squares where gaps cross."""
    (columns, rows), gap, fine = pattern.dimension, pattern.spacing, 10
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    size = TEXELS * fine
    width, height = (round((n * (1 + gap) + gap) * size) for n in (columns, rows))
    image = np.full((height, width), 255, np.uint8)
    for row, column in np.ndindex(rows + 1, columns + 1):
        left, top = (round(n * (1 + gap) * size) for n in (column, row))
        image[top : top + round(gap * size), left : left + round(gap * size)] = 0
    for tag in range(columns * rows):
        left, bottom = (round((n * (1 + gap) + gap) * size) for n in (tag % columns, tag // columns))
        drawn = cv2.aruco.generateImageMarker(dictionary, tag, size, borderBits=2)
        image[height - bottom - size : height - bottom, left : left + size] = drawn[::-1, ::-1]
    return np.asarray(cv2.resize(image, None, fx=1 / fine, fy=1 / fine, interpolation=cv2.INTER_AREA), np.uint8)


def facing(
    pattern: PatternConfiguration,
    distance: float,
    tilt: float = 0.0,
    towards: float = 0.0,
    roll: float = 0.0,
    at=(0, 0),
) -> Array:
    """``T_camera_pattern``: the board's middle at (x, y, 1) * distance, tilted about an axis in the image."""
    R = rotations.exp(tilt * np.array([np.cos(towards), np.sin(towards), 0.0])) @ rotations.exp([0.0, 0.0, roll])
    middle = pattern.pattern().corners.mean(axis=0)
    return transform(R, distance * np.array([*at, 1.0]) - R @ middle)


@cache
def _rays(camera: Camera, supersampling: int) -> Array:
    """(3, rows, columns): normalised coordinates (x, y, 1) of the parts of all pixels.

    Linear between every second pixel, as it takes seconds to invert a distortion for millions of parts: 0.001 px off.
    """
    knots = np.stack(np.meshgrid(*(np.arange(-STEP, n + STEP, STEP) for n in (camera.width, camera.height))), -1)
    s, xy = supersampling, camera.normalise(knots.astype(float))
    for axis, n in enumerate((camera.height, camera.width)):
        at = ((np.arange(s * n) - (s - 1) / 2) / s + STEP) / STEP
        before = at.astype(int)
        share = (at - before).reshape((-1, 1, 1) if axis == 0 else (-1, 1))
        xy = (1 - share) * xy.take(before, axis) + share * xy.take(before + 1, axis)
    x, y = np.moveaxis(xy, -1, 0)
    return np.stack([x, y, np.ones_like(x)])


@dataclass(frozen=True)
class Photograph:
    camera: Camera = VGA
    blur: float = 0.6
    noise: float = 2.0
    white: float = 230.0
    black: float = 15.0
    background: float = 120.0
    supersampling: int = 3
    random: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))

    def of(self, pattern: PatternConfiguration, T_camera_pattern: Array, legacy: bool = False, hidden=None) -> Image:
        """The image; `hidden` is an occluding box (left, top, right, bottom) in pixels, and its grey."""
        width, height = self.camera.width, self.camera.height
        rays = _rays(self.camera, self.supersampling)
        border = np.array(pattern.border_size)
        origin = (pattern.pattern().outline[0] + border) / pattern.size  # where the print begins
        # Of `printed`'s pixels by metres on the board.
        T_texel_board = np.diag([TEXELS / pattern.size, TEXELS / pattern.size, 1.0])
        T_texel_board[:2, 2] = (0.5 - origin) * TEXELS - 0.5
        H = T_texel_board @ np.linalg.inv(T_camera_pattern[:3, [0, 1, 3]])
        x, y, z = (H @ rays.reshape(3, -1)).reshape(rays.shape)
        # Outside of what the lens sees there are no rays: OpenCV 4 draws the background there, OpenCV 5 nothing.
        texel = tuple(np.nan_to_num(each / z, nan=-1e6).astype(np.float32) for each in (x, y))
        paper = printed(pattern, legacy) / 255.0 * (self.white - self.black) + self.black
        seen = cv2.remap(paper.astype(np.float32), *texel, cv2.INTER_LINEAR, borderValue=self.background)
        image = cv2.resize(seen, (width, height), interpolation=cv2.INTER_AREA)
        if hidden is not None:
            (left, top, right, bottom), grey = hidden
            image[top:bottom, left:right] = grey
        image = cv2.GaussianBlur(image, (0, 0), self.blur) if self.blur else image
        image = image + self.noise * self.random.standard_normal(image.shape)
        return np.clip(np.round(image), 0, 255).astype(np.uint8)


def true_corners(camera: Camera, pattern: PatternConfiguration, T_camera_pattern: Array) -> Array:
    return camera.project(apply(T_camera_pattern, pattern.pattern().corners))


def in_view(camera: Camera, pixels: Array, margin: float = 8.0) -> Array:
    low, high = np.full(2, margin), np.array([camera.width, camera.height]) - 1 - margin
    return ((pixels > low) & (pixels < high)).all(-1)
