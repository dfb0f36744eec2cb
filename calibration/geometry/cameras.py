"""Camera models: from a point in the camera frame to a pixel, and back to a ray.

The camera frame is the optical one: x right, y down, z forward. Pixel (0, 0) is the centre of the
top-left pixel.
"""

from dataclasses import dataclass, field

import numpy as np

from calibration.geometry.types import Array, BoolArray

Distorted = tuple[Array, Array]
DistortionJacobian = tuple[Array, Array, Array]


@dataclass(frozen=True)
class PlumbBob:
    """Radial and tangential distortion with 5 coefficients (Brown-Conrady; ROS's ``plumb_bob``).

    On normalised image coordinates (x, y) = (X/Z, Y/Z), with r2 = x^2 + y^2:
    ``x' = x (1 + k1 r2 + k2 r2^2 + k3 r2^3) + 2 p1 x y + p2 (r2 + 2 x^2)``, and y' likewise with
    p1 and p2 exchanged. The Jacobian of every radial plus tangential model is symmetric, so three
    numbers describe it.
    """

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0

    @property
    def is_identity(self) -> bool:
        """Whether the model leaves every point where it is."""
        return not (self.k1 or self.k2 or self.p1 or self.p2 or self.k3)

    def distort(self, x: Array, y: Array) -> Distorted:
        """Normalised coordinates to distorted ones, any shape."""
        if self.is_identity:
            return x, y
        xx, yy, xy = x * x, y * y, x * y
        r2 = xx + yy
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        return (
            x * radial + 2 * self.p1 * xy + self.p2 * (r2 + 2 * xx),
            y * radial + 2 * self.p2 * xy + self.p1 * (r2 + 2 * yy),
        )

    def distort_with_jacobian(self, x: Array, y: Array) -> tuple[Distorted, DistortionJacobian]:
        """`distort`, and its derivatives (dx'/dx, dx'/dy = dy'/dx, dy'/dy)."""
        xx, yy, xy = x * x, y * y, x * y
        r2 = xx + yy
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        slope = 2 * self.k1 + r2 * (4 * self.k2 + 6 * self.k3 * r2)  # 2 d(radial)/d(r2)
        p1x, p1y, p2x, p2y = 2 * self.p1 * x, 2 * self.p1 * y, 2 * self.p2 * x, 2 * self.p2 * y
        distorted = (
            x * radial + self.p1 * 2 * xy + self.p2 * (r2 + 2 * xx),
            y * radial + self.p2 * 2 * xy + self.p1 * (r2 + 2 * yy),
        )
        jacobian = (
            radial + slope * xx + p1y + 3 * p2x,
            slope * xy + p1x + p2y,
            radial + slope * yy + p2x + 3 * p1y,
        )
        return distorted, jacobian

    def undistort(self, x: Array, y: Array) -> Distorted:
        """The inverse of `distort`, by Newton's method from the distorted point, to the last digits.

        NaN where that does not find one: far outside the image a strong distortion may have none.
        """
        if self.is_identity:
            return x, y
        u, v = x, y
        with np.errstate(all="ignore"):  # where there is no inverse, Newton's method may go anywhere
            for _ in range(20):
                (du, dv), (a, b, c) = self.distort_with_jacobian(u, v)
                ex, ey = x - du, y - dv
                det = a * c - b * b
                u, v = u + (c * ex - b * ey) / det, v + (a * ey - b * ex) / det
                left = np.maximum(np.abs(ex), np.abs(ey))
                if not (left > 1e-8).any():  # the step just made leaves about its square
                    break
            found = (left < 1e-6) & (a > 0) & (det > 0)  # beyond, the image is folded over
        return (u, v) if found.all() else (np.where(found, u, np.nan), np.where(found, v, np.nan))


@dataclass(frozen=True)
class Camera:
    """A pinhole camera with distortion. Focal lengths and principal point are in pixels."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    distortion: PlumbBob = field(default_factory=PlumbBob)

    @property
    def K(self) -> Array:
        """The 3x3 intrinsic matrix."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def project(self, points: Array) -> Array:
        """Points (..., 3) in the camera frame to pixels (..., 2); NaN for points not in front of it."""
        z = np.where(points[..., 2] > 0, points[..., 2], np.nan)
        return self.to_pixels(points[..., 0] / z, points[..., 1] / z)

    def project_visible(self, points: Array) -> tuple[Array, BoolArray]:
        """`project`, and which points (...) can be seen: in front, and not where distortion folds over.

        Far outside the image a strong distortion folds back into it. A pixel may lie beyond the image.
        """
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            pixels = self.project(points)
            back = self.normalise(pixels) - points[..., :2] / points[..., 2:]
            visible: BoolArray = np.abs(back).max(-1) < 1e-6
        return pixels, visible

    def to_pixels(self, x: Array, y: Array) -> Array:
        """Normalised coordinates (...) to pixels (..., 2)."""
        xd, yd = self.distortion.distort(x, y)
        return np.stack([self.fx * xd + self.cx, self.fy * yd + self.cy], -1)

    def normalise(self, pixels: Array) -> Array:
        """Pixels (..., 2) to undistorted normalised coordinates (..., 2): the ray is (x, y, 1)."""
        x = (pixels[..., 0] - self.cx) / self.fx
        y = (pixels[..., 1] - self.cy) / self.fy
        return np.stack(self.distortion.undistort(x, y), -1)

    def contains(self, pixels: Array) -> BoolArray:
        """Which pixels (..., 2) lie on the image."""
        u, v = pixels[..., 0], pixels[..., 1]
        inside: BoolArray = (u >= -0.5) & (u <= self.width - 0.5) & (v >= -0.5) & (v <= self.height - 0.5)
        return inside
