"""What a lens model is: its names, its parameters, what of them can be wrong, its projection and the inverse."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import ClassVar, Self

import numpy as np
from numpy.lib.stride_tricks import as_strided

from calibration.base.arrays import Array, BoolArray
from calibration.engine.geometry.lenses.charts import Chart

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
