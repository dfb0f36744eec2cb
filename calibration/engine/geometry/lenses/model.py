"""What a lens model is: its chart, its names and parameters, what of them can be wrong, its projection and the inverse.

A chart gives two coordinates to a direction: those that a lens model maps to the image. A pinhole has the coordinates
(X/Z, Y/Z), which only points in front of the camera have. A lens that sees more than a half of the world has the
coordinates ``t (X, Y) / hypot(X, Y)`` with the angle t from the optical axis, which all directions have but the one
straight back.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import ClassVar, Self

import numpy as np
from numpy.lib.stride_tricks import as_strided

from calibration.base.arrays import Array, BoolArray

MIN_DEPTH = 1e-6
"""Of points in front of the camera, m."""
MIN_COSINE = -0.9999
"""Of the angle from the optical axis: the direction straight back has no coordinates."""
MIN_SINE = 1e-15
"""Nearer to the axis, the ratio of an angle to its sine is 1."""
MAX_SERIES = 1e-3
"""Limit of the squared sine below which a series replaces a difference that would lose digits to cancellation."""
_SERIES = (7 / 256 + 945 / 42240, 5 / 128 + 105 / 3456, 1 / 16 + 15 / 336, 1 / 8 + 3 / 40, 2 / 3)
"""Of ``(t / sin t - cos t) / sin^2 t`` in powers of sin^2 t, the highest first."""

Domain = Callable[[Array], BoolArray]
"""Mask of the directions that a lens sees, by the cosine of their angle from the optical axis."""


@dataclass(frozen=True, eq=False)
class Placed(ABC):
    """Points in a chart, with what their derivatives need; points of v views, K each."""

    at: Array
    """(2, v, K): coordinates; those of points outside of the domain are finite, and mean nothing."""
    nearness: Array
    """(v, K): inverse of the depth or of the distance, 1/m, by which all derivatives are to be multiplied."""
    outside: BoolArray | None
    """(v, K): points that the lens does not see; None if there are none."""

    @abstractmethod
    def by_translation(self, slopes: Array) -> Array:
        """Return derivatives (v, 3, 2 K) by a translation of the points along each axis of the camera.

        Args:
            slopes: (2, 2, v, K), of both image coordinates the derivatives by both of the chart, times `nearness`.
        """

    @abstractmethod
    def products(self, slopes: Array, residuals: Array) -> Array:
        """Return products (9, v, K) of ``a = (x, y, -z)``, the derivatives by a translation, and of the residuals r.

        They are xx, xy, yy, xz, yz, x r, y r, zz and z r, each the sum over both image coordinates.

        Args:
            slopes: as of `by_translation`.
            residuals: (2, v, K).
        """


class PlacedInFront(Placed):
    """Points in the chart `InFront`: the derivative by the depth is ``-(x, y)`` times the slopes."""

    def by_translation(self, slopes: Array) -> Array:
        """See `Placed`."""
        right, down, (x, y) = slopes[:, 0], slopes[:, 1], self.at
        a = np.empty((right.shape[1], 3, 2, right.shape[2]))
        a[:, 0], a[:, 1] = right.transpose(1, 0, 2), down.transpose(1, 0, 2)
        along = x * right
        along += y * down
        np.negative(along.transpose(1, 0, 2), out=a[:, 2])
        return a.reshape(len(a), 3, -1)

    def products(self, slopes: Array, residuals: Array) -> Array:
        """See `Placed`; with the slopes s of a residual, ``a = (s_x, s_y, -(x s_x + y s_y))``."""
        _, v, K = self.at.shape
        products = np.empty((9, v, K))
        squares = slopes * slopes
        np.add(squares[0], squares[1], out=products[:3:2])
        np.multiply(slopes[:, 0], slopes[:, 1], out=squares[0])
        np.add(squares[0, 0], squares[0, 1], out=products[1])
        np.multiply(products[:2], self.at[0], out=products[3:5])
        products[3:5] += products[1:3] * self.at[1]
        np.multiply(slopes, residuals[:, None], out=squares)
        np.add(squares[0], squares[1], out=products[5:7])
        by_depth = products[3:7].reshape(2, 2, v, K) * self.at
        np.add(by_depth[:, 0], by_depth[:, 1], out=products[7:])
        return products


@dataclass(frozen=True, eq=False)
class PlacedAround(Placed):
    """Points in the chart `AllAround`.

    With the direction (u, v, w) of a point, the derivatives of its coordinates by a motion of the point are
    ``A I + B (u, v) (u, v)^T`` and ``-(u, v)``, over its distance; ``A = t / sin t``, ``B = (cos t - A) / sin^2 t``.
    """

    directions: Array
    """(3, v, K)."""

    ratios: tuple[Array, Array]
    """A and B (v, K)."""

    def by_translation(self, slopes: Array) -> Array:
        """See `Placed`."""
        x, y, z = self._along_axes(slopes)
        return np.stack([x, y, -z]).transpose(2, 0, 1, 3).reshape(x.shape[1], 3, -1)

    def products(self, slopes: Array, residuals: Array) -> Array:
        """See `Placed`."""
        x, y, z = self._along_axes(slopes)
        r = residuals
        pairs = ((x, x), (x, y), (y, y), (x, z), (y, z), (x, r), (y, r), (z, z), (z, r))
        return np.stack([a[0] * b[0] + a[1] * b[1] for a, b in pairs])

    def _along_axes(self, slopes: Array) -> tuple[Array, Array, Array]:
        """Return derivatives (2, v, K) by a translation along x, along y, and against z."""
        (u, v, _), (A, B) = self.directions, self.ratios
        right, down = slopes[:, 0], slopes[:, 1]
        along = u * right + v * down
        return A * right + B * along * u, A * down + B * along * v, along


class Chart(ABC):
    """Two coordinates for directions."""

    @abstractmethod
    def coordinates(self, points: Array, domain: Domain) -> Array:
        """Return the coordinates (2, ...) of points (3, ...); NaN outside of the domain."""

    @abstractmethod
    def rays(self, x: Array, y: Array) -> Array:
        """Return a point (3, ...) in the direction of each pair of coordinates."""

    @abstractmethod
    def radius(self, angle: float) -> float:
        """Return the length of the coordinates of a direction at an angle from the axis, rad."""

    @abstractmethod
    def angle(self, radius: Array) -> Array:
        """Return the angle from the axis, rad, of coordinates of a length."""

    @abstractmethod
    def placed(self, points: Array, domain: Domain) -> Placed:
        """Return the coordinates of points (3, v, K), which are overwritten."""

    @abstractmethod
    def slopes(self, points: Array) -> Array:
        """Return the derivatives (2, 3, ...) of the coordinates of points (3, ...) in the domain by the points."""


class InFront(Chart):
    """Coordinates (X/Z, Y/Z), of points in front of the camera."""

    def coordinates(self, points: Array, domain: Domain) -> Array:
        """See `Chart`; the domain is what is in front."""
        z = np.where(points[2] > 0, points[2], np.nan)
        return np.stack([points[0] / z, points[1] / z])

    def rays(self, x: Array, y: Array) -> Array:
        """See `Chart`: (x, y, 1)."""
        return np.stack([x, y, np.where(np.isnan(x), np.nan, 1.0)])

    def radius(self, angle: float) -> float:
        """See `Chart`."""
        return float(np.tan(angle))

    def angle(self, radius: Array) -> Array:
        """See `Chart`."""
        return np.asarray(np.arctan(radius))

    def placed(self, points: Array, domain: Domain) -> Placed:
        """See `Chart`."""
        behind = None if points[2].min() > MIN_DEPTH else ~(points[2] > MIN_DEPTH)
        if behind is not None:
            points[2][behind] = 1.0
        inverse_depth = np.divide(1.0, points[2], out=points[2])
        points[:2] *= inverse_depth
        return PlacedInFront(points[:2], inverse_depth, behind)

    def slopes(self, points: Array) -> Array:
        """See `Chart`."""
        x, y, z = points
        near, none = 1 / z, np.zeros_like(z)
        return np.array([(near, none, -x * near * near), (none, near, -y * near * near)])


class AllAround(Chart):
    """The angle from the optical axis, along the direction in the image: of all directions but straight back."""

    def coordinates(self, points: Array, domain: Domain) -> Array:
        """See `Chart`."""
        directions = points / np.linalg.norm(points, axis=0)
        with np.errstate(invalid="ignore"):
            seen = (directions[2] > MIN_COSINE) & domain(directions[2])
        ratio, _ = _angle_over_sine(directions)
        return np.where(seen, directions[:2] * ratio, np.nan)

    def rays(self, x: Array, y: Array) -> Array:
        """See `Chart`: of length 1."""
        t = np.hypot(x, y)
        sinc = np.sinc(t / np.pi)
        return np.stack([x * sinc, y * sinc, np.cos(t)])

    def radius(self, angle: float) -> float:
        """See `Chart`."""
        return angle

    def angle(self, radius: Array) -> Array:
        """See `Chart`."""
        return radius

    def placed(self, points: Array, domain: Domain) -> Placed:
        """See `Chart`."""
        nearness = 1 / np.maximum(np.sqrt((points * points).sum(0)), MIN_DEPTH)
        points *= nearness
        seen = (points[2] > MIN_COSINE) & domain(points[2])
        outside = None if seen.all() else ~seen
        if outside is not None:
            points[:, outside] = np.array([[0.0], [0.0], [1.0]])
        ratios = _angle_over_sine(points)
        return PlacedAround(points[:2] * ratios[0], nearness, outside, points, ratios)

    def slopes(self, points: Array) -> Array:
        """See `Chart`."""
        distance = np.linalg.norm(points, axis=0)
        directions = points / distance
        u, v, _ = directions
        A, B = _angle_over_sine(directions)
        return np.asarray(np.array([(A + B * u * u, B * u * v, -u), (B * u * v, A + B * v * v, -v)]) / distance)


def _angle_over_sine(directions: Array) -> tuple[Array, Array]:
    """Return A and B of `PlacedAround` for directions (3, ...)."""
    u, v, w = directions
    s2 = u * u + v * v
    s = np.maximum(np.sqrt(s2), MIN_SINE)
    A: Array = np.arctan2(s, w) / s
    series = np.zeros_like(s2)
    near = np.minimum(s2, MAX_SERIES)
    for factor in _SERIES:
        series = factor + near * series
    B: Array = np.where((s2 < MAX_SERIES) & (w > 0), -series, (w - A) / np.maximum(s2, MAX_SERIES))
    return A, B


IN_FRONT, ALL_AROUND = InFront(), AllAround()


LAST_STEP = 1e-8
"""Of `Distortion.undistort`, in coordinates of the chart: what remains is below rounding."""
Distorted = tuple[Array, Array]


@dataclass(frozen=True)
class KalibrName:
    """How Kalibr's camchain names a lens model."""

    camera_model: str
    distortion_model: str
    intrinsics: int = 0
    """Number of coefficients that stand before the focal lengths in ``intrinsics``; they are the first ones here."""
    coefficients: int = 0
    """Number of ``distortion_coeffs``: the next ones. Of others that a model has here, Kalibr knows nothing."""


class Distortion(ABC):
    """A lens model with its coefficients, which are the fields of a dataclass in ROS's order.

    It maps the coordinates of a direction in its `chart` to the image of a camera of focal length 1; these are the
    normalised coordinates (X/Z, Y/Z) for a pinhole. A coefficient may also be an array that broadcasts with the
    coordinates, as (V, 1) for those of V views (V, K). Without arguments it is the lens of coefficients that bend
    nothing.
    """

    ros_name: ClassVar[str]
    """``distortion_model`` of a sensor_msgs/CameraInfo."""
    synonyms: ClassVar[tuple[str, ...]] = ()
    """What drivers and tools call it too."""
    kalibr: ClassVar[KalibrName | None] = None
    """None if Kalibr has no such model."""
    is_wide: ClassVar[bool] = False
    """Whether it is compared only for lenses that see far to the side: others do not determine its coefficients."""
    chart: ClassVar[Chart]
    min_coefficients: ClassVar[int] = 0
    """Number of coefficients that ``D`` must have; others are 0 where they are left out."""
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {}
    """Smallest and largest values of coefficients that have any."""
    start: ClassVar[tuple[float, ...]] = ()
    """Coefficients from which a fit begins; by default those that bend nothing."""

    radial: ClassVar[tuple[str, ...]]
    """Coefficients that are the radial curve: what is wrong with a lens of another focus or copy."""
    tangential: ClassVar[tuple[str, ...]] = ()
    """Coefficients of a lens that is not centred."""
    higher: ClassVar[tuple[str, ...]] = ()
    """Coefficients that many calibrations leave out: the model is then too simple for the lens."""
    held_first: ClassVar[tuple[tuple[str, ...], ...]]
    """Coefficients to be fixed where the labels do not determine all of them, group by group, for a simpler model."""
    always: ClassVar[tuple[str, ...]]
    """Coefficients that every calibration determines; others only where they are not 0."""

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

    def sees(self, cosine: Array) -> BoolArray:
        """Return a mask of the directions in the chart that have an image, by the cosine of their angle to the axis."""
        return np.ones(cosine.shape, bool)

    @abstractmethod
    def distort(self, x: Array, y: Array) -> Distorted:
        """Distort coordinates of any shape."""

    @abstractmethod
    def distort_with_jacobian(self, points: Array) -> tuple[Array, Array]:
        """Distort coordinates (2, ...), and return the derivatives (2, 2, ...) of both by both."""

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
            step: an iteration ends with a step that is shorter than this; it converges quadratically, so the error
                that remains is about the square of it.
        """


def symmetric(numbers: Array) -> Array:
    """View the three numbers (3, ...) of symmetric matrices as these (2, 2, ...)."""
    return as_strided(numbers, (2, 2, *numbers.shape[1:]), (numbers.strides[0], *numbers.strides), writeable=False)
