"""Lenses that may see more than a half of the world: fisheye lenses, and a sphere seen from a point beside its centre.

A ray at the angle t from the optical axis is projected to the radius ``r(t)``. With coordinates of the length t
(`model.AllAround`) a point (x, y) goes to ``(x, y) r(t) / t``, and of this factor ``s``
the derivatives are ``s I + (s'(t) / t) (x, y) (x, y)^T``.
"""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from calibration.base.arrays import Array, BoolArray
from calibration.engine.geometry.lenses.model import (
    ALL_AROUND,
    LAST_STEP,
    Chart,
    Distorted,
    Distortion,
    KalibrName,
    symmetric,
)
from calibration.engine.geometry.lenses.pinhole import PlumbBob

MAX_SERIES = 1e-2
"""Limit of t^2 below which a series replaces a difference that would lose digits to cancellation."""

MIN_BETA, MAX_BETA = 1e-3, 1e3
MAX_XI = 100.0
"""Limits of coefficients that a lens can have: no lens comes near them."""


class _Wide(Distortion):
    """A lens that is the same all around its axis."""

    chart: ClassVar[Chart] = ALL_AROUND

    @property
    def is_identity(self) -> bool:
        """Always False: the chart is none of a pinhole."""
        return False

    def distort(self, x: Array, y: Array) -> Distorted:
        """See `Distortion`."""
        scale, _ = self._scale_and_bend(x * x + y * y)
        return x * scale, y * scale

    def distort_with_jacobian(self, points: Array) -> tuple[Array, Array]:
        """See `Distortion`."""
        x, y = points
        scale, bend = self._scale_and_bend(x * x + y * y)
        return points * scale, symmetric(np.stack([scale + bend * x * x, bend * x * y, scale + bend * y * y]))

    @abstractmethod
    def _scale_and_bend(self, t2: Array) -> tuple[Array, Array]:
        """Return ``s = r(t) / t`` and ``s'(t) / t`` by the square of t."""


@dataclass(frozen=True)
class Equidistant(_Wide):
    """A fisheye lens with 4 coefficients (ROS's ``equidistant``, OpenCV's ``fisheye``).

    ``r(t) = t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8)`` (J. Kannala and S. Brandt, "A generic camera model and
    calibration method for conventional, wide-angle, and fish-eye lenses", 2006).
    """

    ros_name: ClassVar[str] = "equidistant"
    synonyms: ClassVar[tuple[str, ...]] = ("fisheye", "kannala_brandt", "kannala_brandt4")
    kalibr: ClassVar[KalibrName | None] = KalibrName("pinhole", "equidistant", coefficients=4)
    radial: ClassVar[tuple[str, ...]] = ("k1", "k2")
    higher: ClassVar[tuple[str, ...]] = ("k3", "k4")
    held_first: ClassVar[tuple[tuple[str, ...], ...]] = (("k4",), ("k3",), ("k2",), ("k1",))
    always: ClassVar[tuple[str, ...]] = ("k1", "k2", "k3", "k4")

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0

    def derivatives(self, x: Array, y: Array) -> list[Distorted]:
        """See `Distortion`."""
        t2 = x * x + y * y
        out, factor = [], np.ones_like(t2)
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
                scale, bend = self._scale_and_bend(t * t)
                slope = scale + bend * t * t
                left = radius - t * scale
                t = t + left / slope
                if not (np.abs(left) > step).any():
                    break
            found = (np.abs(left) < max(step, 1e-6)) & (slope > 0) & (t >= 0) & (t < np.pi)
            grow = np.where(found, np.where(radius > 0, t / radius, 1.0), np.nan)
        return x * grow, y * grow

    def _scale_and_bend(self, t2: Array) -> tuple[Array, Array]:
        scale = 1 + t2 * (self.k1 + t2 * (self.k2 + t2 * (self.k3 + t2 * self.k4)))
        return scale, 2 * self.k1 + t2 * (4 * self.k2 + t2 * (6 * self.k3 + t2 * (8 * self.k4)))


class _Sphere(_Wide):
    """A lens with ``r(t) = sin t / D(cos t)``: the direction is a point of a surface, seen from a point on its axis."""

    is_wide: ClassVar[bool] = True

    def sees(self, cosine: Array) -> BoolArray:
        """See `Distortion`: D is positive and r grows, ``dr/dt = (cos t D + sin^2 t D') / D^2``."""
        with np.errstate(invalid="ignore"):
            D, slope = self._depth_and_slope(cosine)
            return (D > 0) & (cosine * D + (1 - cosine * cosine) * slope > 0)

    def derivatives(self, x: Array, y: Array) -> list[Distorted]:
        """See `Distortion`."""
        t = np.hypot(x, y)
        cosine = np.cos(t)
        D, _ = self._depth_and_slope(cosine)
        factor = -np.sinc(t / np.pi) / (D * D)
        return [(x * factor * each, y * factor * each) for each in self._depth_by_coefficients(cosine)]

    def undistort(self, x: Array, y: Array, step: float = LAST_STEP) -> Distorted:
        """See `Distortion`; in closed form."""
        radius = np.hypot(x, y)
        with np.errstate(all="ignore"):  # no inverse exists beyond some radius
            t = self._angle(radius)
            found = self.sees(np.cos(t))
            on_axis, _ = self._depth_and_slope(np.ones(1))  # ratio of t to r(t), which is D there
            grow = np.where(found, np.where(radius > 0, t / np.where(radius > 0, radius, 1.0), on_axis), np.nan)
        return x * grow, y * grow

    def _scale_and_bend(self, t2: Array) -> tuple[Array, Array]:
        t = np.sqrt(t2)
        sinc, cosine = np.sinc(t / np.pi), np.cos(t)
        near = np.minimum(t2, MAX_SERIES)
        series = -1 / 3 + near * (1 / 30 + near * (-1 / 840 + near * (1 / 45360 - near / 3991680)))
        falling = np.where(t2 < MAX_SERIES, series, (cosine - sinc) / np.maximum(t2, MAX_SERIES))
        D, slope = self._depth_and_slope(cosine)
        scale = sinc / D
        return scale, falling / D + scale * scale * slope

    @abstractmethod
    def _depth_and_slope(self, cosine: Array) -> tuple[Array, Array]:
        """Return D and its derivative by the cosine."""

    @abstractmethod
    def _depth_by_coefficients(self, cosine: Array) -> list[Array]:
        """Return the derivatives of D by each coefficient of the sphere."""

    @abstractmethod
    def _angle(self, radius: Array) -> Array:
        """Return the angle t of a radius r; NaN if there is none."""


@dataclass(frozen=True)
class DoubleSphere(_Sphere):
    """Two spheres, one projected to the other: 2 coefficients (Kalibr's and Basalt's ``ds``).

    ``D = alpha d + (1 - alpha) (xi + cos t)`` with ``d^2 = sin^2 t + (xi + cos t)^2`` (V. Usenko, N. Demmel and
    D. Cremers, "The double sphere camera model", 2018).
    """

    ros_name: ClassVar[str] = "double_sphere"
    synonyms: ClassVar[tuple[str, ...]] = ("ds",)
    kalibr: ClassVar[KalibrName | None] = KalibrName("ds", "none", intrinsics=2)
    min_coefficients: ClassVar[int] = 2
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"alpha": (0.0, 1.0)}
    start: ClassVar[tuple[float, ...]] = (0.0, 0.5)
    radial: ClassVar[tuple[str, ...]] = ("xi", "alpha")
    held_first: ClassVar[tuple[tuple[str, ...], ...]] = (("xi",),)
    always: ClassVar[tuple[str, ...]] = ("xi", "alpha")

    xi: float = 0.0
    alpha: float = 0.0

    def _depth_and_slope(self, cosine: Array) -> tuple[Array, Array]:
        d, rest = np.sqrt(1 + self.xi * (2 * cosine + self.xi)), 1 - self.alpha
        return self.alpha * d + rest * (self.xi + cosine), self.alpha * self.xi / d + rest

    def _depth_by_coefficients(self, cosine: Array) -> list[Array]:
        d = np.sqrt(1 + self.xi * (2 * cosine + self.xi))
        return [self.alpha * (self.xi + cosine) / d + 1 - self.alpha, d - self.xi - cosine]

    def _angle(self, radius: Array) -> Array:
        r2, a = radius * radius, self.alpha
        m = (1 - a * a * r2) / (a * np.sqrt(1 - (2 * a - 1) * r2) + 1 - a)
        return _from_sphere(radius, m, self.xi)


@dataclass(frozen=True)
class Eucm(_Sphere):
    """The enhanced unified camera model: a surface of second order, 2 coefficients (Kalibr's ``eucm``).

    ``D = alpha d + (1 - alpha) cos t`` with ``d^2 = beta sin^2 t + cos^2 t`` (B. Khomutenko, G. Garcia and
    P. Martinet, "An enhanced unified camera model", 2016).
    """

    ros_name: ClassVar[str] = "eucm"
    synonyms: ClassVar[tuple[str, ...]] = ("extended_unified",)
    kalibr: ClassVar[KalibrName | None] = KalibrName("eucm", "none", intrinsics=2)
    min_coefficients: ClassVar[int] = 2
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"alpha": (0.0, 1.0), "beta": (MIN_BETA, MAX_BETA)}
    start: ClassVar[tuple[float, ...]] = (0.5, 1.0)
    radial: ClassVar[tuple[str, ...]] = ("alpha", "beta")
    held_first: ClassVar[tuple[tuple[str, ...], ...]] = (("beta",),)
    always: ClassVar[tuple[str, ...]] = ("alpha", "beta")

    alpha: float = 0.0
    beta: float = 1.0

    def _depth_and_slope(self, cosine: Array) -> tuple[Array, Array]:
        d, rest = self._d(cosine), 1 - self.alpha
        return self.alpha * d + rest * cosine, self.alpha * cosine * (1 - self.beta) / d + rest

    def _depth_by_coefficients(self, cosine: Array) -> list[Array]:
        d = self._d(cosine)
        return [d - cosine, self.alpha * (1 - cosine * cosine) / (2 * d)]

    def _d(self, cosine: Array) -> Array:
        squared: Array = cosine * cosine
        return np.sqrt(self.beta * (1 - squared) + squared)

    def _angle(self, radius: Array) -> Array:
        r2, a = self.beta * radius * radius, self.alpha
        m = (1 - a * a * r2) / (a * np.sqrt(1 - (2 * a - 1) * r2) + 1 - a)
        return np.arctan2(radius, m)


@dataclass(frozen=True)
class _Mirror(_Sphere):
    """The unified model: a sphere seen from a point at the distance xi from its centre, ``D = xi + cos t``."""

    radial: ClassVar[tuple[str, ...]] = ("xi",)
    held_first: ClassVar[tuple[tuple[str, ...], ...]] = ()
    always: ClassVar[tuple[str, ...]] = ("xi",)

    xi: float = 0.0

    def _depth_and_slope(self, cosine: Array) -> tuple[Array, Array]:
        return self.xi + cosine, np.ones_like(cosine)

    def _depth_by_coefficients(self, cosine: Array) -> list[Array]:
        return [np.ones_like(cosine)]

    def _angle(self, radius: Array) -> Array:
        return _from_sphere(radius, np.ones_like(radius), self.xi)


@dataclass(frozen=True)
class Omni(Distortion):
    """The unified model with radial and tangential distortion, 5 coefficients (Kalibr: ``omni``, OpenCV: ``omnidir``).

    ``r(t) = sin t / (xi + cos t)``, distorted by a `PlumbBob` without k3 (C. Mei and P. Rives, "Single view point
    omnidirectional camera calibration from planar grids", 2007).
    """

    ros_name: ClassVar[str] = "omni"
    synonyms: ClassVar[tuple[str, ...]] = ("mei", "omnidir", "omnidirectional")
    kalibr: ClassVar[KalibrName | None] = KalibrName("omni", "radtan", intrinsics=1, coefficients=4)
    is_wide: ClassVar[bool] = True
    chart: ClassVar[Chart] = ALL_AROUND
    min_coefficients: ClassVar[int] = 1
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"xi": (0.0, MAX_XI)}
    start: ClassVar[tuple[float, ...]] = (1.0, 0.0, 0.0, 0.0, 0.0)
    radial: ClassVar[tuple[str, ...]] = ("xi", "k1", "k2")
    tangential: ClassVar[tuple[str, ...]] = ("p1", "p2")
    held_first: ClassVar[tuple[tuple[str, ...], ...]] = (("k2",), ("k1",))
    always: ClassVar[tuple[str, ...]] = ("xi", "k1", "k2", "p1", "p2")

    xi: float = 0.0
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0

    @property
    def is_identity(self) -> bool:
        """Always False: the chart is none of a pinhole."""
        return False

    @cached_property
    def _mirror(self) -> _Mirror:
        return _Mirror(self.xi)

    @cached_property
    def _lens(self) -> PlumbBob:
        return PlumbBob(self.k1, self.k2, self.p1, self.p2)

    def sees(self, cosine: Array) -> BoolArray:
        """See `Distortion`."""
        return self._mirror.sees(cosine)

    def distort(self, x: Array, y: Array) -> Distorted:
        """See `Distortion`."""
        return self._lens.distort(*self._mirror.distort(x, y))

    def distort_with_jacobian(self, points: Array) -> tuple[Array, Array]:
        """See `Distortion`."""
        seen, by_points = self._mirror.distort_with_jacobian(points)
        distorted, by_seen = self._lens.distort_with_jacobian(np.asarray(seen))
        return distorted, np.einsum("ij...,jk...->ik...", by_seen, by_points)

    def derivatives(self, x: Array, y: Array) -> list[Distorted]:
        """See `Distortion`."""
        u, v = self._mirror.distort(x, y)
        ((du, dv),) = self._mirror.derivatives(x, y)
        _, ((a, b), (c, d)) = self._lens.distort_with_jacobian(np.stack([u, v]))
        return [(a * du + b * dv, c * du + d * dv), *self._lens.derivatives(u, v)[:4]]

    def undistort(self, x: Array, y: Array, step: float = LAST_STEP) -> Distorted:
        """See `Distortion`; by Newton's method for the distortion, in closed form for the sphere."""
        return self._mirror.undistort(*self._lens.undistort(x, y, step))


def _from_sphere(radius: Array, m: Array, xi: float) -> Array:
    """Return the angle of the point where the ray (r, m) from a point xi off a unit sphere's centre leaves it."""
    along = (m * xi + np.sqrt(m * m + (1 - xi * xi) * radius * radius)) / (m * m + radius * radius)
    return np.asarray(np.arctan2(along * radius, along * m - xi))
