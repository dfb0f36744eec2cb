"""Clips of a fixed camera in a textured room: walls, a floor and clutter at several distances, and what disturbs them.

The room is a set of textured rectangles, each warped by its homography; what stands still is drawn once a pose of the
camera. Over it people and robots move, the light drifts and throws shadows, and each image has its exposure, its noise
and its compression. It is not part of the simulation: that draws patterns and distances, no textures.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import cv2
import numpy as np

from benchmarks.guard.room import Rectangle, draw
from calibration.addons.guard.recording import CameraImages
from calibration.base.arrays import Array
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import Distortion, PlumbBob
from calibration.engine.geometry.transforms import transform
from calibration.robot.labelling.detection import Image

WIDTH, HEIGHT = 640, 480
FOCAL_PX = WIDTH / 2 / math.tan(math.radians(30))
"""Focal length of 60 degrees of view."""
SUPERSAMPLING = 2
"""Side of an image in which a room is drawn, in those of the camera's: it is sampled down as a sensor does."""
BORDER = 60
"""px: of the drawn image, around what the lens shows."""


def camera_of_room() -> Camera:
    """Return the camera, with a lens that is not rectilinear."""
    return Camera(
        FOCAL_PX,
        FOCAL_PX,
        WIDTH / 2 + 3.3,
        HEIGHT / 2 - 2.1,
        WIDTH,
        HEIGHT,
        PlumbBob(-0.12, 0.03, 0.0004, -0.0003, 0.0),
    )


@dataclass(frozen=True)
class Displacement:
    """Planted displacement of a camera: a turn, a shift, a change of its lens."""

    rotation_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Rotation vector in the camera's axes (x right, y down, z forward), degrees."""
    translation_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    zoom: float = 0.0
    """Relative change of the focal length."""
    blur_px: float = 0.0
    """Standard deviation by which it is out of focus."""


@dataclass(frozen=True)
class Disturbances:
    """Changes of a clip that are no displacement of its camera: people, light, noise, compression."""

    people: int = 2
    light: float = 0.3
    """Relative change over a clip, and between reference and clip."""
    noise: float = 3.0
    """Standard deviation of 255."""
    quality: int = 75
    """Quality of the JPEG compression, 0 to 100."""
    shadows: int = 2
    moved_objects: int = 1
    """Things of the room that stand elsewhere than in the reference."""


@dataclass(frozen=True)
class Room:
    """Room, as its seed draws it."""

    rectangles: Sequence[Rectangle] = field(default_factory=tuple)
    camera: Camera = field(default_factory=camera_of_room)

    @classmethod
    def drawn(cls, random: np.random.Generator, camera: Camera | None = None) -> "Room":
        """Draw a room: a back wall, two side walls, floor and ceiling, and 6 to 12 things in front of them."""
        depth, half, high = random.uniform(3.0, 6.0), random.uniform(1.6, 2.6), random.uniform(1.0, 1.4)
        low = random.uniform(1.0, 1.4)
        up = -high - low
        walls = [
            ((-half, low, depth), ((2 * half, 0, 0), (0, up, 0))),
            ((-half, low, 0.3), ((0, 0, depth - 0.3), (0, up, 0))),
            ((half, low, depth), ((0, 0, 0.3 - depth), (0, up, 0))),
            ((-half, low, 0.3), ((2 * half, 0, 0), (0, 0, depth - 0.3))),
            ((-half, -high, depth), ((2 * half, 0, 0), (0, 0, 0.3 - depth))),
        ]
        found = [Rectangle(np.array(c), np.array(s, float), drawn_texture(random, 900)) for c, s in walls]
        for _ in range(random.integers(6, 13)):
            z = random.uniform(1.2, depth - 0.2)
            size = random.uniform(0.15, 0.5, 2)
            turned = rotations.exp(random.uniform(-0.6, 0.6, 3))
            sides = (turned @ np.array([[size[0], 0, 0], [0, -size[1], 0]]).T).T
            x, y = random.uniform(-0.5, 0.5) * z, random.uniform(-0.35, 0.4) * z
            found.append(Rectangle(np.array([x, y, z]), sides, drawn_texture(random, 300)))
        return cls(sorted(found, key=lambda each: -each.distance), camera or camera_of_room())

    def with_moved_objects(self, number: int, random: np.random.Generator) -> "Room":
        """Return the room with some of its things displaced by centimetres."""
        things = list(self.rectangles)
        near = [i for i, each in enumerate(things) if np.abs(each.sides).max() < 1]
        for i in random.permutation(near)[:number].tolist():
            things[i] = replace(things[i], corner=things[i].corner + random.normal(0, 0.03, 3))
        return replace(self, rectangles=things)

    def seen(self, moved: Displacement) -> Array:
        """Return what a camera sees (H, W), grey, float32."""
        T = transform(rotations.exp(np.radians(moved.rotation_deg)), np.array(moved.translation_m))
        K = np.array(
            [
                [SUPERSAMPLING * FOCAL_PX, 0, SUPERSAMPLING * (WIDTH / 2 + BORDER)],
                [0, SUPERSAMPLING * FOCAL_PX, SUPERSAMPLING * (HEIGHT / 2 + BORDER)],
                [0, 0, 1],
            ]
        )
        canvas = np.full((SUPERSAMPLING * (HEIGHT + 2 * BORDER), SUPERSAMPLING * (WIDTH + 2 * BORDER)), 90, np.uint8)
        draw(canvas, self.rectangles, T, K)
        at = _lens_map(type(self.camera.distortion), tuple(self.camera.intrinsics.tolist()), moved.zoom)
        image = cv2.remap(canvas, at[..., 0], at[..., 1], cv2.INTER_LINEAR)
        image = cv2.GaussianBlur(image, (0, 0), SUPERSAMPLING * math.hypot(0.6, moved.blur_px))
        return np.asarray(cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA), np.float32)


@cache
def _lens_map(lens: type[Distortion], intrinsics: tuple[float, ...], zoom: float) -> Array:
    """Return where each pixel of a raw image is in what is drawn without the lens (H, W, 2), float32."""
    camera = Camera(1.0, 1.0, 0.0, 0.0, WIDTH, HEIGHT, lens()).with_intrinsics(np.array(intrinsics))
    scaled = replace(camera, fx=camera.fx * (1 + zoom), fy=camera.fy * (1 + zoom))
    u, v = np.meshgrid(
        *((np.arange(SUPERSAMPLING * side) - 0.5 * (SUPERSAMPLING - 1)) / SUPERSAMPLING for side in (WIDTH, HEIGHT))
    )
    drawn = scaled.normalise(np.stack([u, v], -1)) * (SUPERSAMPLING * FOCAL_PX) + SUPERSAMPLING * (
        np.array([WIDTH, HEIGHT]) / 2 + BORDER
    )
    return np.asarray(drawn, np.float32)


def drawn_texture(random: np.random.Generator, side: int) -> Image:
    """Draw a texture (side, side): noise of several sizes, and shapes as posters, doors and shelves have."""
    texture = np.full((side, side), random.uniform(60, 190), np.float32)
    for scale in (4, 12, 40):
        grains = random.normal(0, random.uniform(2, 12), (side // scale + 2, side // scale + 2)).astype(np.float32)
        texture += cv2.resize(grains, (side, side), interpolation=cv2.INTER_CUBIC)
    image = np.clip(texture, 0, 255).astype(np.uint8)
    for _ in range(int(random.integers(10, 40))):
        centre = tuple(random.integers(0, side, 2).tolist())
        level = int(random.integers(20, 235))
        if random.random() < 0.5:
            axes = tuple(random.integers(4, side // 10, 2).tolist())
            cv2.ellipse(image, centre, axes, float(random.uniform(0, 180)), 0, 360, level, -1, cv2.LINE_AA)
        else:
            corner = (centre[0] + int(random.integers(6, side // 5)), centre[1] + int(random.integers(6, side // 5)))
            cv2.rectangle(image, centre, corner, level, int(random.choice([-1, 2, 4])), cv2.LINE_AA)
    return image


@dataclass(frozen=True)
class Clip:
    """Clip of a room: its images come when they are asked for."""

    room: Room
    moved: Displacement
    since: float | None
    """s: from when on it is displaced; None for never."""
    seconds: float
    disturbances: Disturbances
    seed: int
    rate: float = 2.0

    @property
    def times(self) -> Array:
        """Times of the images, s."""
        return np.arange(round(self.seconds * self.rate)) / self.rate

    def images(self) -> Iterator[Image]:
        """Yield the images (H, W), grey."""
        random = np.random.default_rng(self.seed)
        room = self.room.with_moved_objects(self.disturbances.moved_objects, random)
        before, after = room.seen(Displacement()), None
        people = [_Walker.drawn(random) for _ in range(self.disturbances.people)]
        light = _Light.drawn(random, self.disturbances)
        for time in self.times.tolist():
            image = before
            if self.since is not None and time >= self.since:
                after = room.seen(self.moved) if after is None else after
                image = after
            image = light.on(image, time / self.seconds)
            for each in people:
                each.draw(image, time)
            yield _image_with_disturbances(image, self.disturbances, random)


def _image_with_disturbances(image: Array, disturbances: Disturbances, random: np.random.Generator) -> Image:
    """Return an image as a camera takes, compresses and sends it."""
    noise = random.standard_normal(image.shape, np.float32) * disturbances.noise
    taken = np.clip(image + noise, 0, 255).astype(np.uint8)
    _, data = cv2.imencode(".jpg", taken, [cv2.IMWRITE_JPEG_QUALITY, disturbances.quality])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE))


@dataclass(frozen=True)
class _Walker:
    """Person or robot: a textured shape that comes, stands and goes."""

    texture: Image
    x: float
    speed: float
    foot: float
    phase: float

    @classmethod
    def drawn(cls, random: np.random.Generator) -> "_Walker":
        height = int(random.integers(140, 330))
        texture = cv2.resize(drawn_texture(random, 200), (int(height * random.uniform(0.25, 0.5)), height))
        return cls(
            np.asarray(texture, np.uint8),
            random.uniform(0, WIDTH),
            random.uniform(-60, 60),
            random.uniform(330, 520),
            random.uniform(0, 6),
        )

    def draw(self, image: Array, time: float) -> None:
        height, width = self.texture.shape
        span = WIDTH + 2 * width
        x = (self.x + self.speed * time + 20 * math.sin(time + self.phase)) % span - width
        top = self.foot - height + 4 * math.sin(3 * time)
        at = np.array([[1, 0, x], [0, 1, top]])
        shape = np.zeros_like(self.texture)
        cv2.ellipse(shape, (width // 2, height // 2), (width // 2, height // 2), 0, 0, 360, 255, -1)
        size = (WIDTH, HEIGHT)
        mask = cv2.warpAffine(shape, at, size, flags=cv2.INTER_NEAREST) > 0
        np.copyto(image, cv2.warpAffine(self.texture, at, size, flags=cv2.INTER_LINEAR).astype(np.float32), where=mask)


@dataclass(frozen=True)
class _Light:
    """Light that drifts over a clip: its level, its slope over the image, and shadows that wander."""

    levels: tuple[float, float]
    slopes: Array
    shadows: Sequence[Any]
    gamma: float

    @classmethod
    def drawn(cls, random: np.random.Generator, disturbances: Disturbances) -> "_Light":
        size = disturbances.light
        levels = tuple((1 + random.uniform(-size, size, 2)).tolist())
        shadows = [
            (
                random.uniform(0, WIDTH, 2),
                random.uniform(0, HEIGHT, 2),
                random.uniform(40, 200),
                random.uniform(0.4, 0.85),
            )
            for _ in range(disturbances.shadows)
        ]
        return cls(levels, random.uniform(-size, size, (2, 2)) / 2, shadows, float(np.exp(random.uniform(-size, size))))

    def on(self, image: Array, share: float) -> Array:
        y, x = np.mgrid[-1 : 1 : HEIGHT * 1j, -1 : 1 : WIDTH * 1j].astype(np.float32)
        level = self.levels[0] + (self.levels[1] - self.levels[0]) * share
        factor = level * (1 + self.slopes[0] @ [share, 1 - share] * x + self.slopes[1] @ [share, 1 - share] * y)
        for across, down, radius, dark in self.shadows:
            centre = (int(across[0] + (across[1] - across[0]) * share), int(down[0] + (down[1] - down[0]) * share))
            mask = np.zeros((HEIGHT, WIDTH), np.float32)
            cv2.circle(mask, centre, int(radius), 1.0, -1)
            factor = factor * (
                1 - (1 - dark) * cv2.GaussianBlur(cv2.resize(mask, (160, 120)), (0, 0), 2).repeat(4, 0).repeat(4, 1)
            )
        return np.asarray(255 * np.clip(image * factor / 255, 0, 1) ** self.gamma, np.float32)


def as_recorded(images: Sequence[Image], rate: float = 2.0) -> CameraImages:
    """Return images as those of a camera in a recording."""
    times = np.arange(len(images)) / rate

    def read(first: float, last: float, most: int) -> Iterator[tuple[float, Image]]:
        inside = np.flatnonzero((times >= first) & (times <= last))
        chosen = inside[np.unique(np.linspace(0, len(inside) - 1, min(most, len(inside))).round().astype(int))]
        for i in chosen.tolist():
            yield float(times[i]), images[i]

    return CameraImages("camera", float(times[-1]), read)
