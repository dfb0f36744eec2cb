"""Clips of a camera in a hand over a table: textured things with parallax, what moves, light, noise and compression.

Of two cameras both look at the same. Over the table things move, and fingers of the hand are in the image.
"""

from dataclasses import dataclass, field

import cv2
import numpy as np

from benchmarks.guard.room import Rectangle, box, draw
from calibration.base.arrays import Array
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import from_xyz_rpy, local, retract, transform
from calibration.robot.labelling.detection import Image

CAMERA = Camera(554.0, 554.0, 321.0, 238.0, 640, 480)
T_LINK_CAMERA = from_xyz_rpy(np.array([0.03, -0.05, 0.06]), np.array([0.1, 0.05, 1.5]))
ABOVE_TABLE = from_xyz_rpy(np.array([0.0, 0.0, 0.62]), np.array([np.pi, 0.0, 0.0]))
"""The middle pose of the camera."""


@dataclass(frozen=True)
class HandMotion:
    """Smooth motion of a camera about a middle pose: a sum of two waves on each axis."""

    amplitudes: Array
    frequencies: Array
    phases: Array

    @classmethod
    def drawn(cls, random: np.random.Generator, metres: float = 0.15, radians: float = 0.35) -> "HandMotion":
        """Draw a motion with amplitudes about these."""
        size = np.repeat([metres, radians], 3)[:, None] * random.uniform(0.4, 0.7, (6, 2))
        return cls(size, random.uniform(0.3, 1.2, (6, 2)), random.uniform(0, 6.3, (6, 2)))

    def camera(self, time: float) -> Array:
        """Return ``T_root_camera`` (4, 4)."""
        twist = (self.amplitudes * np.sin(self.frequencies * time + self.phases)).sum(1)
        return retract(ABOVE_TABLE, twist)

    def velocity(self, time: float) -> Array:
        """Return the twist (6,) of the camera a second."""
        return local(self.camera(time - 1e-3), self.camera(time + 1e-3)) / 2e-3


@dataclass(frozen=True)
class Table:
    """What a camera over a table sees."""

    things: list[Rectangle] = field(default_factory=list)
    textured: float = 1.0

    @classmethod
    def drawn(
        cls, random: np.random.Generator, boxes: int = 9, moving: int = 2, fingers: int = 2, textured: float = 1.0
    ) -> "Table":
        """Draw a table with boxes, things that move over it, and fingers of the hand."""
        things = [
            Rectangle(np.array([-1.3, -1.3, 0]), np.array([[2.6, 0, 0], [0, 2.6, 0]]), picture(random, 1500, textured))
        ]
        for _ in range(boxes):
            x, y = random.uniform(-0.45, 0.45, 2)
            w, d, h = random.uniform([0.06, 0.06, 0.03], [0.2, 0.2, 0.18])
            turned = rotations.exp(np.array([0, 0, random.uniform(0, 3)]))
            place = transform(turned, np.array([x, y, 0.0]))
            things += box(place, np.array([w, d, h]), [picture(random, 220, textured) for _ in range(5)])
        for _ in range(moving):
            place = np.array([*random.uniform(-0.4, 0.3, 2), 0.2])
            size = np.array([[random.uniform(0.1, 0.25), 0, 0], [0, random.uniform(0.1, 0.25), 0]])
            things.append(Rectangle(place, size, picture(random, 250, textured), tuple(random.uniform(-0.12, 0.12, 2))))
        for i in range(fingers):
            place = np.array([-0.06 + 0.09 * i, 0.075, 0.2])
            finger = np.array([[0.025, 0, 0], [0, 0.06, 0]])
            things.append(Rectangle(place, finger, picture(random, 120, textured), carried=True))
        return cls(things, textured)

    def seen(self, T_root_camera: Array, time: float, camera: Camera = CAMERA) -> Image:
        """Return what a camera sees (H, W), grey."""
        image = np.full((camera.height, camera.width), 100, np.uint8)
        draw(image, sorted(self.things, key=_height), T_root_camera, camera.K, time)
        return image


def picture(random: np.random.Generator, side: int, textured: float) -> Image:
    """Draw a texture (side, side); without texture it is one grey."""
    grey = np.full((side, side), random.uniform(70, 180), np.float32)
    for scale in (3, 9, 30):
        small = random.normal(0, 9 * textured, (side // scale + 2, side // scale + 2)).astype(np.float32)
        grey += cv2.resize(small, (side, side), interpolation=cv2.INTER_CUBIC)
    image = np.clip(grey, 0, 255).astype(np.uint8)
    for _ in range(int(textured * side / 12)):
        centre = tuple(random.integers(0, side, 2).tolist())
        axes = tuple(random.integers(3, max(side // 20, 8), 2).tolist())
        level = int(random.integers(10, 245))
        if random.random() < 0.5:
            cv2.ellipse(image, centre, axes, float(random.uniform(0, 180)), 0, 360, level, -1, cv2.LINE_AA)
        else:
            cv2.rectangle(image, centre, (centre[0] + axes[0], centre[1] + axes[1]), level, -1)
    return image


def taken(
    image: Image, random: np.random.Generator, noise: float = 3.0, quality: int = 80, light: float = 0.2
) -> Image:
    """Return an image as a camera takes and sends it: light, blur, noise, compression."""
    lit = cv2.GaussianBlur(image, (0, 0), 0.7).astype(np.float32) * random.uniform(1 - light, 1 + light)
    noisy = np.clip(lit + random.normal(0, noise, image.shape), 0, 255).astype(np.uint8)
    _, data = cv2.imencode(".jpg", noisy, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE))


def _height(thing: Rectangle) -> float:
    return 9.0 if thing.carried else float(thing.corner[2] + 0.5 * thing.sides[:, 2].sum())
