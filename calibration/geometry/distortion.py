"""Lens distortion models on normalised image coordinates, their derivatives and inverses.

Normalised coordinates are (x, y) = (X/Z, Y/Z) of a point in front of the camera; r2 is x^2 + y^2.
The Jacobian of each model here is symmetric, so three numbers suffice.
"""

from abc import ABC, abstractmethod
from dataclasses import fields
from functools import cached_property
from typing import ClassVar, Self

import numpy as np

from calibration.frozen import frozen
from calibration.geometry.types import Array

LAST_STEP = 1e-8
"""Of `Distortion.undistort`, in normalised coordinates: what remains is below rounding."""
Distorted = tuple[Array, Array]


class Distortion(ABC):
    """A distortion model with its coefficients, which are the fields of a dataclass in ROS's order.

    A coefficient may also be an array that broadcasts with the coordinates, as (V, 1) for those of V views (V, K).
    """

    ros_name: ClassVar[str]
    """``distortion_model`` of a sensor_msgs/CameraInfo."""

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Names of the coefficients, in the order of ``D``."""
        return tuple(field.name for field in fields(cls))  # type: ignore[arg-type]  # every model is a dataclass

    @property
    def coefficients(self) -> Array:
        """Coefficients (n,), in the order of `names`."""
        return np.array([getattr(self, name) for name in self.names()], float)

    def with_coefficients(self, coefficients: Array) -> Self:
        """Return the same model with other coefficients (n,)."""
        return type(self)(*coefficients.tolist())

    @property
    @abstractmethod
    def is_identity(self) -> bool:
        """Whether the distortion is the identity."""

    @abstractmethod
    def distort(self, x: Array, y: Array) -> Distorted:
        """Distort normalised coordinates of any shape."""

    @abstractmethod
    def distort_with_jacobian(self, points: Array) -> tuple[Array, Array]:
        """Distort coordinates (2, ...), and return the derivatives (3, ...): dx'/dx, dx'/dy = dy'/dx, dy'/dy."""

    @abstractmethod
    def derivatives(self, x: Array, y: Array) -> list[Distorted]:
        """Derivatives of the distorted coordinates with respect to each coefficient: (dx'/dc, dy'/dc)."""

    @abstractmethod
    def undistort(self, x: Array, y: Array, step: float = LAST_STEP) -> Distorted:
        """Invert `distort`, to machine precision.

        NaN where no inverse exists: far from the image centre a strong distortion folds the image over.

        Args:
            x: of any shape.
            y: the same.
            step: the iteration ends with a step that is shorter than this; it converges quadratically, so the error
                that remains is about the square of it.
        """


@frozen
class _RadialTangential(Distortion):
    """Radial-tangential model: ``x' = x radial(r2) + 2 p1 x y + p2 (r2 + 2 x^2)``; y' with p1 and p2 exchanged."""

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0

    @cached_property
    def is_identity(self) -> bool:
        """Whether the distortion is the identity."""
        return not any(np.any(getattr(self, name)) for name in self.names())

    def distort(self, x: Array, y: Array) -> Distorted:
        """See `Distortion`."""
        if self.is_identity:
            return x, y
        xx, yy, xy = x * x, y * y, x * y
        r2 = xx + yy
        radial = self._radial(r2)
        return (
            x * radial + 2 * self.p1 * xy + self.p2 * (r2 + 2 * xx),
            y * radial + 2 * self.p2 * xy + self.p1 * (r2 + 2 * yy),
        )

    def distort_with_jacobian(self, points: Array) -> tuple[Array, Array]:
        """See `Distortion`."""
        x, y = points
        jacobian = np.empty((3, *x.shape))
        if self.is_identity:
            jacobian[::2], jacobian[1] = 1.0, 0.0
            return points, jacobian
        squares = points * points
        r2 = squares[0] + squares[1]
        scale, slope = self._radial_and_slope(r2)
        tilt, distorted = np.empty_like(points), np.empty_like(points)
        np.multiply(x, 2 * self.p2, out=tilt[0])
        np.multiply(y, 2 * self.p1, out=tilt[1])
        scale += tilt[0]
        scale += tilt[1]
        # x' = x scale + p2 r2, and likewise y': few operations, as all corners pass here in each iteration
        np.multiply(r2, self.p2, out=distorted[0])
        np.multiply(r2, self.p1, out=distorted[1])
        distorted += points * scale
        np.multiply(squares, slope, out=jacobian[::2])
        jacobian[::2] += scale
        jacobian[::2] += tilt
        jacobian[::2] += tilt
        np.multiply(x, y, out=jacobian[1])
        jacobian[1] *= slope
        jacobian[1] += 2 * self.p1 * x
        jacobian[1] += 2 * self.p2 * y
        return distorted, jacobian

    def undistort(self, x: Array, y: Array, step: float = LAST_STEP) -> Distorted:
        """See `Distortion`; by Newton's method, started at the distorted point."""
        if self.is_identity:
            return x, y
        u, v = self._inverse_start(x, y)
        with np.errstate(all="ignore"):  # Newton's method may diverge where no inverse exists
            for _ in range(20):
                (du, dv), (a, b, c) = self.distort_with_jacobian(np.stack([u, v]))
                ex, ey = x - du, y - dv
                det = a * c - b * b
                u, v = u + (c * ex - b * ey) / det, v + (a * ey - b * ex) / det
                left = np.maximum(np.abs(ex), np.abs(ey))
                if not (left > step).any():
                    break
            found = (left < max(step, 1e-6)) & (a > 0) & (det > 0)  # negative determinant: the image is folded over
        return (u, v) if found.all() else (np.where(found, u, np.nan), np.where(found, v, np.nan))

    def _inverse_start(self, x: Array, y: Array) -> Distorted:
        """Starting point of Newton's method for the inverse."""
        return x, y

    @abstractmethod
    def _radial(self, r2: Array) -> Array:
        """Radial factor."""

    @abstractmethod
    def _radial_and_slope(self, r2: Array) -> tuple[Array, Array]:
        """Radial factor, and twice its derivative with respect to r2."""


@frozen
class PlumbBob(_RadialTangential):
    """Radial and tangential distortion with 5 coefficients (Brown-Conrady; ROS's ``plumb_bob``).

    The radial factor is ``1 + k1 r2 + k2 r2^2 + k3 r2^3``.
    """

    ros_name: ClassVar[str] = "plumb_bob"

    def derivatives(self, x: Array, y: Array) -> list[Distorted]:
        """See `Distortion`."""
        xx, yy = x * x, y * y
        r2, xy = xx + yy, 2 * (x * y)
        x1, y1 = x * r2, y * r2
        x2, y2 = x1 * r2, y1 * r2
        return [(x1, y1), (x2, y2), (xy, r2 + 2 * yy), (r2 + 2 * xx, xy), (x2 * r2, y2 * r2)]

    def _radial(self, r2: Array) -> Array:
        radial: Array = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        return radial

    def _radial_and_slope(self, r2: Array) -> tuple[Array, Array]:
        return self._radial(r2), 2 * self.k1 + r2 * (4 * self.k2 + 6 * self.k3 * r2)


@frozen
class Rational(_RadialTangential):
    """Rational radial and tangential distortion with 8 coefficients (ROS's ``rational_polynomial``).

    The radial factor is ``(1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3)`` (D. Claus
    and A. Fitzgibbon, "A rational function lens distortion model for general cameras", 2005, in OpenCV's form).
    """

    ros_name: ClassVar[str] = "rational_polynomial"

    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0

    def derivatives(self, x: Array, y: Array) -> list[Distorted]:
        """See `Distortion`."""
        xx, yy = x * x, y * y
        r2, xy = xx + yy, 2 * (x * y)
        below = self._denominator(r2)
        x1, y1 = x * r2 / below, y * r2 / below
        x2, y2 = x1 * r2, y1 * r2
        x3, y3 = x2 * r2, y2 * r2
        fall = -self._radial(r2)
        return [
            *((x1, y1), (x2, y2), (xy, r2 + 2 * yy), (r2 + 2 * xx, xy), (x3, y3)),
            *((x1 * fall, y1 * fall), (x2 * fall, y2 * fall), (x3 * fall, y3 * fall)),
        ]

    def _inverse_start(self, x: Array, y: Array) -> Distorted:
        """Distorted coordinates, limited to radii below the pole of the denominator."""
        roots = np.roots([self.k6, self.k5, self.k4, 1.0])
        poles = roots.real[(roots.real > 0) & (np.abs(roots.imag) < 1e-9 * np.abs(roots.real))]
        if not len(poles):
            return x, y
        shrink = np.minimum(1.0, 0.9 * np.sqrt(poles.min()) / np.maximum(np.hypot(x, y), 1e-30))
        return x * shrink, y * shrink

    def _denominator(self, r2: Array) -> Array:
        below: Array = 1 + r2 * (self.k4 + r2 * (self.k5 + r2 * self.k6))
        return below

    def _radial(self, r2: Array) -> Array:
        radial: Array = (1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))) / self._denominator(r2)
        return radial

    def _radial_and_slope(self, r2: Array) -> tuple[Array, Array]:
        radial = self._radial(r2)
        above = 2 * self.k1 + r2 * (4 * self.k2 + 6 * self.k3 * r2)
        below = 2 * self.k4 + r2 * (4 * self.k5 + 6 * self.k6 * r2)
        return radial, (above - radial * below) / self._denominator(r2)


NEAR_AXIS = 1e-2
"""Limit of r2 below which a series replaces a difference that would lose digits to cancellation."""


@frozen
class Equidistant(Distortion):
    """A fisheye lens with 4 coefficients (ROS's ``equidistant``, OpenCV's ``fisheye``).

    A ray at the angle t from the axis, ``r = tan t``, is projected to the radius
    ``t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8)`` (J. Kannala and S. Brandt, "A generic camera model and
    calibration method for conventional, wide-angle, and fish-eye lenses", 2006). Only rays in front of the
    camera, t < pi/2, have normalised coordinates.
    """

    ros_name: ClassVar[str] = "equidistant"

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0

    @property
    def is_identity(self) -> bool:
        """Always False: with zero coefficients the model is the equidistant projection, not a pinhole."""
        return False

    def distort(self, x: Array, y: Array) -> Distorted:
        """See `Distortion`."""
        shrink, t2 = _angle_over_radius(x * x + y * y)
        scale = shrink * self._polynomial(t2)
        return x * scale, y * scale

    def distort_with_jacobian(self, points: Array) -> tuple[Array, Array]:
        """See `Distortion`."""
        x, y = points
        r2 = x * x + y * y
        shrink, t2 = _angle_over_radius(r2)
        polynomial = self._polynomial(t2)
        scale = shrink * polynomial
        # twice the derivative of the scale with respect to r2; that of t2 is shrink / (1 + r2)
        bend = self.k1 + t2 * (2 * self.k2 + t2 * (3 * self.k3 + t2 * (4 * self.k4)))
        slope = 2 * (_shrinking(r2, shrink) * polynomial + shrink * shrink / (1 + r2) * bend)
        return points * scale, np.stack([scale + slope * x * x, slope * x * y, scale + slope * y * y])

    def derivatives(self, x: Array, y: Array) -> list[Distorted]:
        """See `Distortion`."""
        shrink, t2 = _angle_over_radius(x * x + y * y)
        out, factor = [], shrink
        for _ in self.names():
            factor = factor * t2
            out.append((x * factor, y * factor))
        return out

    def undistort(self, x: Array, y: Array, step: float = LAST_STEP) -> Distorted:
        """See `Distortion`; by Newton's method on the angle."""
        radius = np.hypot(x, y)
        t = np.minimum(radius, 1.5)
        with np.errstate(all="ignore"):  # Newton's method may diverge where no inverse exists
            for _ in range(20):
                t2 = t * t
                slope = 1 + t2 * (3 * self.k1 + t2 * (5 * self.k2 + t2 * (7 * self.k3 + t2 * (9 * self.k4))))
                left = radius - t * self._polynomial(t2)
                t = t + left / slope
                if not (np.abs(left) > step).any():
                    break
            found = (np.abs(left) < max(step, 1e-6)) & (slope > 0) & (t >= 0) & (t < np.pi / 2)
            grow = np.where(found, np.where(radius > 0, np.tan(t) / radius, 1.0), np.nan)
        return x * grow, y * grow

    def _polynomial(self, t2: Array) -> Array:
        polynomial: Array = 1 + t2 * (self.k1 + t2 * (self.k2 + t2 * (self.k3 + t2 * self.k4)))
        return polynomial


MODELS: dict[str, type[Distortion]] = {model.ros_name: model for model in (PlumbBob, Rational, Equidistant)}
"""Models by the name in ROS."""


def _angle_over_radius(r2: Array) -> tuple[Array, Array]:
    """``t / r`` of the angle ``t = atan(r)``, 1 on the axis; and t^2."""
    r = np.sqrt(np.maximum(r2, 1e-30))
    shrink: Array = np.arctan(r) / r
    return shrink, shrink * shrink * r2


def _shrinking(r2: Array, shrink: Array) -> Array:
    """Derivative of ``t / r`` with respect to r2: ``(1 / (1 + r2) - t / r) / (2 r2)``, as a series near the axis."""
    far = np.maximum(r2, NEAR_AXIS)
    near = np.minimum(r2, NEAR_AXIS)
    series = np.zeros_like(near)
    for n in range(8, 0, -1):  # t / r = sum (-r2)^n / (2 n + 1)
        series = (-1) ** n * n / (2 * n + 1) + near * series
    slope: Array = np.where(r2 < NEAR_AXIS, series, (1 / (1 + far) - shrink) / (2 * far))
    return slope
