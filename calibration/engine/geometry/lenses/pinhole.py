"""Pinhole cameras with distortion: radial and tangential, with a polynomial or a rational function of the radius.

Normalised coordinates are (x, y) = (X/Z, Y/Z) of a point in front of the camera; r2 is x^2 + y^2.
"""

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.geometry.lenses.model import (
    IN_FRONT,
    LAST_STEP,
    Chart,
    Distorted,
    Distortion,
    KalibrName,
    symmetric,
)


@dataclass(frozen=True)
class _RadialTangential(Distortion):
    """Radial-tangential model: ``x' = x radial(r2) + 2 p1 x y + p2 (r2 + 2 x^2)``; y' with p1 and p2 exchanged."""

    chart: ClassVar[Chart] = IN_FRONT
    kalibr: ClassVar[KalibrName | None] = KalibrName("pinhole", "radtan", coefficients=4)
    radial: ClassVar[tuple[str, ...]] = ("k1", "k2")
    tangential: ClassVar[tuple[str, ...]] = ("p1", "p2")
    higher: ClassVar[tuple[str, ...]] = ("k3", "k4")
    held_first: ClassVar[tuple[tuple[str, ...], ...]] = (("k3",), ("k2",), ("k1",))
    always: ClassVar[tuple[str, ...]] = ("k1", "k2", "p1", "p2")

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
            return points, symmetric(jacobian)
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
        return distorted, symmetric(jacobian)

    def undistort(self, x: Array, y: Array, step: float = LAST_STEP) -> Distorted:
        """See `Distortion`; by Newton's method, started at the distorted point."""
        if self.is_identity:
            return x, y
        u, v = self._inverse_start(x, y)
        with np.errstate(all="ignore"):  # Newton's method may diverge where no inverse exists
            for _ in range(20):
                (du, dv), ((a, b), (_, c)) = self.distort_with_jacobian(np.stack([u, v]))
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


@dataclass(frozen=True)
class PlumbBob(_RadialTangential):
    """Radial and tangential distortion with 5 coefficients (Brown-Conrady; ROS's ``plumb_bob``).

    The radial factor is ``1 + k1 r2 + k2 r2^2 + k3 r2^3``.
    """

    ros_name: ClassVar[str] = "plumb_bob"
    synonyms: ClassVar[tuple[str, ...]] = ("radtan",)

    def derivatives(self, x: Array, y: Array) -> list[Distorted]:
        """See `Distortion`."""
        xx, yy = x * x, y * y
        r2, xy = xx + yy, 2 * (x * y)
        x1, y1 = x * r2, y * r2
        x2, y2 = x1 * r2, y1 * r2
        return [(x1, y1), (x2, y2), (xy, r2 + 2 * yy), (r2 + 2 * xx, xy), (x2 * r2, y2 * r2)]

    def _radial(self, r2: Array) -> Array:
        return 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))

    def _radial_and_slope(self, r2: Array) -> tuple[Array, Array]:
        return self._radial(r2), 2 * self.k1 + r2 * (4 * self.k2 + 6 * self.k3 * r2)


@dataclass(frozen=True)
class Rational(_RadialTangential):
    """Rational radial and tangential distortion with 8 coefficients (ROS's ``rational_polynomial``).

    The radial factor is ``(1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3)`` (D. Claus
    and A. Fitzgibbon, "A rational function lens distortion model for general cameras", 2005, in OpenCV's form).
    """

    ros_name: ClassVar[str] = "rational_polynomial"
    # a fraction whose denominator is fixed is a polynomial
    held_first: ClassVar[tuple[tuple[str, ...], ...]] = (("k4", "k5", "k6"), ("k3",), ("k2",), ("k1",))

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
        return 1 + r2 * (self.k4 + r2 * (self.k5 + r2 * self.k6))

    def _radial(self, r2: Array) -> Array:
        return (1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))) / self._denominator(r2)

    def _radial_and_slope(self, r2: Array) -> tuple[Array, Array]:
        radial = self._radial(r2)
        above = 2 * self.k1 + r2 * (4 * self.k2 + 6 * self.k3 * r2)
        below = 2 * self.k4 + r2 * (4 * self.k5 + 6 * self.k6 * r2)
        return radial, (above - radial * below) / self._denominator(r2)
