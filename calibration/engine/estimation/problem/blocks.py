"""Blocks of unknowns: a pose, a joint or a camera's intrinsics, each with its parametrisation."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Literal

import numpy as np

from calibration.base.arrays import Array, BoolArray
from calibration.engine.dataset.model import Edge
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.frames import JOINT_PARAMETERS, JointModel, JointParameter
from calibration.engine.geometry.transforms import inverse_adjoint, retract, twists_in_child


@dataclass(frozen=True)
class Motion:
    """Translation or rotation of a pose, or the effect of one parameter of a joint or a camera."""

    kind: Literal["translation", "rotation", "ray"]
    """"ray": of a camera's intrinsics."""
    length: int = 1
    """Number of its parameters: the three axes of a pose, or one."""
    parameter: str = ""
    """Name of the parameter; empty for a pose."""
    unit: float = 1.0
    """Unit of the parameters: the size of the pattern (m), 1 rad, or a camera's own."""
    extent: float = 1.0
    """Displacement of the block by one unit, m or rad."""


ALL_CAMERAS = "all"
"""Name for all cameras."""
PARAMETERS_IN_PIXELS = ("fx", "fy", "cx", "cy")
"""Parameters in pixels."""


@dataclass(frozen=True, eq=False)
class CalibratedIntrinsics:
    """Estimates of intrinsics with their covariance: calibrated, or given."""

    model: str
    """ROS's name of the distortion model."""
    parameters: tuple[str, ...]
    """Some of fx, fy, cx, cy and the distortion coefficients, in this order."""
    values: Array
    """(k,): px, and 1."""
    covariance: Array
    """(k, k); NaN if the calibration has not converged."""

    @property
    def units(self) -> tuple[Literal["px", "1"], ...]:
        """Unit of each parameter."""
        return tuple("px" if parameter in PARAMETERS_IN_PIXELS else "1" for parameter in self.parameters)

    @property
    def sigmas(self) -> Array:
        """(k,): standard deviation of each parameter."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance)))


@dataclass(frozen=True, eq=False)
class Prior:
    """Gaussian prior of some parameters."""

    at: tuple[int, ...]
    """(u,): indices of these parameters among all of the camera, ascending."""
    mean: Array
    """(u,)."""
    covariance: Array
    """(u, u)."""

    @cached_property
    def information(self) -> Array:
        """(u, u): inverse of the covariance, scaled first, as pixels and coefficients differ in magnitude."""
        s = np.sqrt(np.diagonal(self.covariance))
        inverse: Array = np.linalg.inv(self.covariance / s[:, None] / s) / s[:, None] / s
        return 0.5 * (inverse + inverse.T)


@dataclass(frozen=True, eq=False)
class FreeIntrinsics:
    """Camera with some free intrinsics."""

    sensor: str
    """Name of the camera."""
    camera: Camera
    """With its nominal intrinsics."""
    free: tuple[str, ...]
    """Free parameters, in the order of `Camera.parameters`."""
    rays: Array
    """(2, n): its labels as coordinates in the lens's chart."""
    prior: Prior | None = None

    @property
    def dimension(self) -> int:
        """Number of free parameters."""
        return len(self.free)

    @cached_property
    def at(self) -> list[int]:
        """Indices of the free parameters among all."""
        return [self.camera.parameters.index(parameter) for parameter in self.free]

    def motions(self, size: float) -> list[Motion]:
        """Return the effect of each free parameter on the labels' rays; ``size`` of the pattern is not used."""
        units, extents = self.unit, self.unit * self.reach
        parts = zip(self.free, units.tolist(), extents.tolist(), strict=True)
        return [Motion("ray", 1, *part) for part in parts]

    def with_free(self, parameters: Sequence[str]) -> "FreeIntrinsics":
        """Return the camera with these parameters free, in any order."""
        return replace(self, free=tuple(each for each in self.camera.parameters if each in parameters))

    def without(self, parameter: str) -> "FreeIntrinsics":
        """Return the camera with one parameter fewer free."""
        return self.with_free([each for each in self.free if each != parameter])

    def moved(self, value: Array, step: Array) -> Array:
        """Return all parameters (4 + n,) after a step (k,) of the free ones."""
        out = value.copy()
        out[self.at] += step
        return out

    def possible(self, value: Array) -> bool:
        """Whether the values are valid: positive focal lengths, no folding of the image at the labels."""
        if not (np.isfinite(value).all() and value[0] > 0 and value[1] > 0):
            return False
        return bool(self._does_not_fold(self.camera.with_intrinsics(value))[self._sound_probes].all())

    @cached_property
    def _probe_points(self) -> Array:
        """Points (2, p) all over the circle that contains the labels, in the lens's chart."""
        around = np.linspace(0, 2 * np.pi, 12, endpoint=False)
        r = np.hypot(*self.rays).max(initial=0.0) * np.linspace(0, 1, 9)[1:, None]
        return np.stack([(r * np.cos(around)).ravel(), (r * np.sin(around)).ravel()])

    @cached_property
    def _sound_probes(self) -> BoolArray:
        """Mask (p,) of the probes at which the nominal camera does not fold."""
        return self._does_not_fold(self.camera)

    def _does_not_fold(self, camera: Camera) -> BoolArray:
        with np.errstate(all="ignore"):
            _, ((a, b), (c, d)) = camera.distortion.distort_with_jacobian(self._probe_points)
            return np.asarray((a > 0) & (a * d - b * c > 0))

    def pull(self, value: Array) -> tuple[float, Array, Array]:
        """Return the prior's cost at all parameters (4 + n,), its gradient (k,) and Hessian (k, k) by the free ones."""
        off = np.zeros(len(value))
        if self.prior is not None:
            off[list(self.prior.at)] = value[list(self.prior.at)] - self.prior.mean
        gradient = self.information @ off
        return float(off @ gradient), gradient[self.at], self.information[np.ix_(self.at, self.at)]

    @cached_property
    def information(self) -> Array:
        """(4 + n, 4 + n): the prior's, of all parameters."""
        n = len(self.camera.parameters)
        information = np.zeros((n, n))
        if self.prior is not None:
            information[np.ix_(self.prior.at, self.prior.at)] = self.prior.information
        return information

    @cached_property
    def reach(self) -> Array:
        """Rotation (k,) of a ray per unit of each free parameter, rad; root mean square over the labels."""
        return root_mean_square(self._ray_rotations(*self.rays))

    @cached_property
    def unit(self) -> Array:
        """Unit (k,) of each free parameter, to compare directions.

        The change that rotates the labels' rays by 1 rad; or ten standard deviations of the prior if that is less, so
        that parameters with a prior neither count as undetermined nor dominate all others.
        """
        everything = np.full(len(self.camera.parameters), np.inf)
        if self.prior is not None:
            everything[list(self.prior.at)] = 10 * np.sqrt(np.diagonal(self.prior.covariance))
        return np.asarray(np.minimum(everything[self.at], 1 / np.maximum(self.reach, 1e-30)))

    @cached_property
    def bends(self) -> Array:
        """Rotation (k, 2, n) of the rays all over the image per unit of each free parameter, rad."""
        camera = self.camera
        u, v = np.meshgrid(np.linspace(0, camera.width - 1, 16), np.linspace(0, camera.height - 1, 12))
        x, y = camera.from_pixels(u.ravel(), v.ravel())
        return self._ray_rotations(x[np.isfinite(x)], y[np.isfinite(x)])

    def _ray_rotations(self, x: Array, y: Array) -> Array:
        """Rotation (k, 2, n) of rays, as coordinates (n,) in the chart, per unit of each free parameter.

        In pixels over the focal length, which is close to the angle, and for a fisheye lens equal to it.
        """
        focal = np.array([[self.camera.fx], [self.camera.fy]])
        return np.asarray(self.camera.derivatives(x, y)[self.at] / focal)


def root_mean_square(turns: Array) -> Array:
    """Root mean square (...) of vectors (..., 2, n)."""
    return np.asarray(np.sqrt((turns * turns).sum(-2).mean(-1)))


@dataclass(frozen=True)
class Pose:
    """Transform ``T_parent_child`` (4, 4), moved by a twist in its child frame: translation, rotation (m, rad)."""

    free: ClassVar[tuple[str, ...]] = ()
    """Parameters that can be fixed by name: none."""
    dimension: ClassVar[int] = 6

    def moved(self, value: Array, step: Array) -> Array:
        """Return the transform (..., 4, 4) after a twist (..., 6)."""
        return retract(value, step)

    def jacobian(self, T_child_pattern: Array, value: Array) -> Array:
        """Jacobian (v, 6, 6) of the twist in the pattern's frame by the parameters, with the pattern at (v, 4, 4)."""
        return inverse_adjoint(T_child_pattern)

    def motions(self, size: float) -> list[Motion]:
        """Return the motions of the parameters, in order; ``size`` is the pattern's, m."""
        return [Motion("translation", 3, unit=size, extent=size), Motion("rotation", 3)]


@dataclass(frozen=True)
class FreeJoint:
    """Joint with some unknown parameters; its value is the array of all parameters, (7,)."""

    model: JointModel
    free: tuple[JointParameter, ...]
    """Free parameters, in the order of `JOINT_PARAMETERS`."""

    @property
    def dimension(self) -> int:
        """Number of free parameters."""
        return len(self.free)

    @cached_property
    def at(self) -> list[int]:
        """Indices of the free parameters among all."""
        return [JOINT_PARAMETERS.index(parameter) for parameter in self.free]

    def without(self, parameter: str) -> "FreeJoint":
        """Return the joint with one parameter fewer free."""
        return FreeJoint(self.model, tuple(each for each in self.free if each != parameter))

    def moved(self, value: Array, step: Array) -> Array:
        """Return all parameters (7,) after a step (k,) of the free ones."""
        out = value.copy()
        out[self.at] += step
        return out

    def jacobian(self, T_child_pattern: Array, value: Array) -> Array:
        """Jacobian (v, 6, k), like that of a pose."""
        return twists_in_child(T_child_pattern, self.model.columns(value)[:, self.at])

    def motions(self, size: float) -> list[Motion]:
        """Return the motions of the parameters, like those of a pose."""
        lengths = [self.model.unit(parameter) == "m" for parameter in self.free]
        return [
            Motion("translation", 1, name, size, size) if is_length else Motion("rotation", 1, name)
            for name, is_length in zip(self.free, lengths, strict=True)
        ]


@dataclass(frozen=True)
class Block:
    """Unknown, with its parametrisation."""

    name: str
    per_collection: bool = False
    """Whether each collection has a value of its own; only for poses."""
    held: bool = False
    """Fixed at the initial guess: an anchored sensor, one that fixes a free gauge, or one fixed by the user."""
    parameters: Pose | FreeJoint | FreeIntrinsics = Pose()
    edge: Edge | None = None
    """Parent and child of the transform; None for intrinsics."""

    @property
    def dimension(self) -> int:
        """Number of free parameters, per collection if it is per collection."""
        return self.parameters.dimension

    @property
    def joint(self) -> FreeJoint | None:
        """Parametrisation of a joint; None for others."""
        return self.parameters if isinstance(self.parameters, FreeJoint) else None

    @property
    def intrinsics(self) -> FreeIntrinsics | None:
        """Parametrisation of intrinsics; None for others."""
        return self.parameters if isinstance(self.parameters, FreeIntrinsics) else None

    def pose(self, value: Array) -> Array:
        """Return the transform at a value: (4, 4), or (N, 4, 4) if it is per collection."""
        return value if self.joint is None else self.joint.model.pose(value)


Values = tuple[Array, ...]
"""One array for each block: (4, 4), or (N, 4, 4) if it is per collection; all parameters of a joint (7,) or of a
camera (4 + n,).
"""
