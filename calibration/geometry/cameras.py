"""Camera models: projection of points in the camera frame to pixels, and back-projection to rays.

The camera frame is the optical one: x right, y down, z forward. Pixel (0, 0) is the centre of the
top-left pixel.
"""

from dataclasses import field, replace

import numpy as np

from calibration.frozen import frozen
from calibration.geometry.distortion import Distortion, PlumbBob
from calibration.geometry.types import Array, BoolArray


@frozen
class Camera:
    """A pinhole camera with distortion. Focal lengths and principal point are in pixels."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    distortion: Distortion = field(default_factory=PlumbBob)

    @property
    def parameters(self) -> tuple[str, ...]:
        """The names of `intrinsics`."""
        return ("fx", "fy", "cx", "cy", *self.distortion.names())

    @property
    def intrinsics(self) -> Array:
        """Intrinsic parameters (4 + n,): fx, fy, cx, cy in pixels, and the distortion coefficients."""
        return np.array([self.fx, self.fy, self.cx, self.cy, *self.distortion.coefficients])

    def with_intrinsics(self, values: Array) -> "Camera":
        """Return the same camera with other `intrinsics`."""
        fx, fy, cx, cy = values[:4].tolist()
        return replace(self, fx=fx, fy=fy, cx=cx, cy=cy, distortion=self.distortion.with_coefficients(values[4:]))

    @property
    def K(self) -> Array:
        """The 3x3 intrinsic matrix."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def project(self, points: Array) -> Array:
        """Project points (..., 3) in the camera frame to pixels (..., 2); NaN for points not in front of the camera."""
        z = np.where(points[..., 2] > 0, points[..., 2], np.nan)
        return self.to_pixels(points[..., 0] / z, points[..., 1] / z)

    def project_visible(self, points: Array) -> tuple[Array, BoolArray]:
        """Project points, and return a mask (...) of the visible ones: in front, where the distortion is invertible.

        Far from the image centre a strong distortion folds points back into the image. Pixels may be outside the image.
        """
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            pixels = self.project(points)
            back = self.normalise(pixels) - points[..., :2] / points[..., 2:]
            visible: BoolArray = np.abs(back).max(-1) < 1e-6
        return pixels, visible

    def to_pixels(self, x: Array, y: Array) -> Array:
        """Convert normalised coordinates (...) to pixels (..., 2)."""
        xd, yd = self.distortion.distort(x, y)
        return np.stack([self.fx * xd + self.cx, self.fy * yd + self.cy], -1)

    def derivatives(self, x: Array, y: Array) -> Array:
        """Derivatives (4 + n, 2, ...) of the pixels of normalised coordinates (...) by each of the `intrinsics`."""
        xd, yd = self.distortion.distort(x, y)
        none, one = np.zeros_like(x), np.ones_like(x)
        coefficients = [(self.fx * dx, self.fy * dy) for dx, dy in self.distortion.derivatives(x, y)]
        return np.array([(xd, none), (none, yd), (one, none), (none, one), *coefficients])

    def slopes(self, x: Array, y: Array) -> Array:
        """Derivatives (2, 2, ...) of the pixels by normalised coordinates (...)."""
        _, (a, b, c) = self.distortion.distort_with_jacobian(np.stack([x, y]))
        return np.array([(self.fx * a, self.fx * b), (self.fy * b, self.fy * c)])

    def normalise(self, pixels: Array) -> Array:
        """Convert pixels (..., 2) to undistorted normalised coordinates (..., 2): the ray is (x, y, 1)."""
        return np.stack(self.from_pixels(pixels[..., 0], pixels[..., 1]), -1)

    def from_pixels(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Convert pixels (...) to undistorted normalised coordinates x and y (...)."""
        return self.distortion.undistort((u - self.cx) / self.fx, (v - self.cy) / self.fy)

    def contains(self, pixels: Array) -> BoolArray:
        """Return a mask of the pixels (..., 2) inside the image."""
        u, v = pixels[..., 0], pixels[..., 1]
        inside: BoolArray = (u >= -0.5) & (u <= self.width - 0.5) & (v >= -0.5) & (v <= self.height - 0.5)
        return inside
