"""Camera models: projection of points in the camera frame to pixels, and back-projection to rays.

Which points a camera sees is its lens's to say: those of more than 180 degrees see points with z below 0.

The camera frame is the optical one: x right, y down, z forward. Pixel (0, 0) is the centre of the
top-left pixel.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from calibration.base.arrays import Array, BoolArray
from calibration.engine.geometry.lenses import Distortion, PlumbBob


@dataclass(frozen=True)
class Camera:
    """A camera with its lens. Focal lengths and principal point are in pixels."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    distortion: Distortion = field(default_factory=PlumbBob)
    skew: float = 0.0
    """px: by which a pixel column leans over ``fy`` rows; it is given, never calibrated."""

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
        return np.array([[self.fx, self.skew, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def project(self, points: Array) -> Array:
        """Project points (..., 3) in the camera frame to pixels (..., 2); NaN for points that the lens does not see."""
        return self.to_pixels(*self._coordinates(points))

    def _coordinates(self, points: Array) -> Array:
        """Return the coordinates (2, ...) of points (..., 3) in the lens's chart; NaN if the lens does not see them."""
        return self.distortion.chart.coordinates(np.moveaxis(points, -1, 0), self.distortion.sees)

    def project_visible(self, points: Array) -> tuple[Array, BoolArray]:
        """Project points, and return a mask (...) of the visible ones: in front of the lens, where it is invertible.

        Far from the image centre a strong distortion folds points back into the image. Pixels may be outside the image.
        """
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            at = self._coordinates(points)
            pixels = self.to_pixels(*at)
            back = np.abs(self.from_pixels(pixels[..., 0], pixels[..., 1]) - at)
            visible: BoolArray = back.max(0) < 1e-6
        return pixels, visible

    def to_pixels(self, x: Array, y: Array) -> Array:
        """Convert coordinates (...) in the lens's chart to pixels (..., 2)."""
        xd, yd = self.distortion.distort(x, y)
        return np.stack([self.fx * xd + self.skew * yd + self.cx, self.fy * yd + self.cy], -1)

    def derivatives(self, x: Array, y: Array) -> Array:
        """Derivatives (4 + n, 2, ...) of the pixels of coordinates (...) in the chart by each of the `intrinsics`."""
        xd, yd = self.distortion.distort(x, y)
        none, one = np.zeros_like(x), np.ones_like(x)
        coefficients = [(self.fx * dx + self.skew * dy, self.fy * dy) for dx, dy in self.distortion.derivatives(x, y)]
        return np.array([(xd, none), (none, yd), (one, none), (none, one), *coefficients])

    def slopes(self, points: Array) -> Array:
        """Derivatives (2, 3, ...) of the pixels of points (3, ...) by the points."""
        chart = self.distortion.chart
        _, J = self.distortion.distort_with_jacobian(chart.coordinates(points, self.distortion.sees))
        by_points: Array = np.einsum("ij...,jk...->ik...", J, chart.slopes(points))
        return np.asarray(np.einsum("ij,j...->i...", self.K[:2, :2], by_points))

    def normalise(self, pixels: Array) -> Array:
        """Convert pixels (..., 2) to normalised coordinates (..., 2): the ray is (x, y, 1).

        NaN where the lens has no ray, and of rays that do not point to the front.
        """
        x, y, z = np.moveaxis(self.rays(pixels), -1, 0)
        return np.stack([x, y], -1) / np.where(z > 0, z, np.nan)[..., None]

    def rays(self, pixels: Array) -> Array:
        """Convert pixels (..., 2) to rays (..., 3) of any length; NaN where the lens has none."""
        return np.moveaxis(self.distortion.chart.rays(*self.from_pixels(pixels[..., 0], pixels[..., 1])), 0, -1)

    def from_pixels(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Convert pixels (...) to coordinates x and y (...) in the lens's chart, undistorted."""
        y = (v - self.cy) / self.fy
        return self.distortion.undistort((u - self.cx - self.skew * y) / self.fx, y)

    def contains(self, pixels: Array) -> BoolArray:
        """Return a mask of the pixels (..., 2) inside the image."""
        u, v = pixels[..., 0], pixels[..., 1]
        return (u >= -0.5) & (u <= self.width - 0.5) & (v >= -0.5) & (v <= self.height - 0.5)
