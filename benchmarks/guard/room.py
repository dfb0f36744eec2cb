"""Textured rectangles, of which all scenes of the guard are made: drawn for a camera, and hit by a LiDAR's rays."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from calibration.base.arrays import Array
from calibration.engine.geometry.transforms import inverse
from calibration.robot.labelling.detection import Image

NEAREST_M = 0.03
"""m: what reaches nearer to a camera's plane is not drawn."""
NO_TEXTURE = np.full((2, 2), 128, np.uint8)


@dataclass(frozen=True)
class Rectangle:
    """Textured rectangle: a corner and its two sides, m, in the frame of the scene."""

    corner: Array
    sides: Array
    """(2, 3)."""
    texture: Image = field(default_factory=lambda: NO_TEXTURE)
    moves: tuple[float, float] = (0.0, 0.0)
    """m/s along x and y: of what moves to and fro."""
    carried: bool = False
    """Whether it is in the frame of the camera."""

    def corner_at(self, time: float) -> Array:
        """Return its corner (3,) at a time, s."""
        return self.corner + 1.2 * np.sin(0.9 * time) * np.array([*self.moves, 0.0])

    @property
    def distance(self) -> float:
        """Distance of its centre from the origin."""
        return float(np.linalg.norm(self.corner + self.sides.sum(0) / 2))


def box(pose: Array, size: Array, textures: Sequence[Image] = (NO_TEXTURE,) * 5) -> list[Rectangle]:
    """Return four sides and the top of a box.

    Args:
        pose: (4, 4) of the corner from which its sides go.
        size: (3,) m.
        textures: of each, the top's last.
    """
    x, y, z = np.diag(size)
    places = ((0 * x, x, z), (y, x, z), (0 * x, y, z), (x, y, z), (z, x, y))
    R, t = pose[:3, :3], pose[:3, 3]
    return [
        Rectangle(t + R @ corner, np.stack([one, other]) @ R.T, texture)
        for (corner, one, other), texture in zip(places, textures, strict=True)
    ]


def draw(canvas: Image, rectangles: Sequence[Rectangle], T_root_camera: Array, K: Array, time: float = 0.0) -> None:
    """Draw rectangles, the farthest first, by homographies.

    Args:
        canvas: (H, W) grey; changed.
        rectangles: in the order in which they are drawn.
        T_root_camera: (4, 4).
        K: (3, 3) of the camera, which has no distortion.
        time: s.
    """
    size = (canvas.shape[1], canvas.shape[0])
    for thing in rectangles:
        height, width = thing.texture.shape
        plane = np.stack([thing.sides[0] / width, thing.sides[1] / height, thing.corner_at(time)], 1)
        T = np.eye(4) if thing.carried else inverse(T_root_camera)
        seen = T[:3, :3] @ plane + np.stack([np.zeros(3), np.zeros(3), T[:3, 3]], 1)
        ends = np.array([[0, 0, 1], [width, 0, 1], [0, height, 1], [width, height, 1]]) @ seen[2]
        if (ends < NEAREST_M).any():
            continue
        H = K @ seen
        mask = cv2.warpPerspective(np.full_like(thing.texture, 255), H, size, flags=cv2.INTER_NEAREST) > 0
        np.copyto(canvas, cv2.warpPerspective(thing.texture, H, size, flags=cv2.INTER_LINEAR), where=mask)


def ranges_to(rectangles: Sequence[Rectangle], T_root_lidar: Array, rays: Array, time: float = 0.0) -> Array:
    """Return how far rays (N, 3) of a LiDAR go, m; infinite where they hit nothing."""
    along, origin = rays @ T_root_lidar[:3, :3].T, T_root_lidar[:3, 3]
    sides, offsets = (
        np.stack([each.sides for each in rectangles]),
        np.stack([each.corner_at(time) for each in rectangles]) - origin,
    )
    normals, slopes = np.cross(sides[:, 0], sides[:, 1]), np.linalg.pinv(sides)
    with np.errstate(divide="ignore", invalid="ignore"):
        far = (offsets * normals).sum(1) / (along @ normals.T)
        u, v = (far * (along @ slopes[..., i].T) - (offsets * slopes[..., i]).sum(1) for i in (0, 1))
        hit = (far > 0) & (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1)
    return np.where(hit, far, np.inf).min(1)


def fan_of_rays(rings: int, azimuths: int, up: tuple[float, float], around: tuple[float, float]) -> Array:
    """Return the rays (N, 3) of a LiDAR with rings, z upwards, between angles, rad."""
    elevation, azimuth = np.linspace(*up, rings), np.linspace(*around, azimuths, endpoint=False)
    elevation, azimuth = (each.ravel() for each in np.meshgrid(elevation, azimuth))
    across = np.cos(elevation)
    return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)], -1)
