"""Residuals of measured poses of a pattern.

What a camera sees of a pattern tells its distance worse than where it is across the line of sight: the noise of a
position has one standard deviation along that line and another one across. The residuals are weighted so that it is the
same in all directions.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Literal, Self

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.engine.estimation.residuals.views import Linearised, robust, spread, squeezed
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera

AT_SENSOR = 1e-9
"""m: distance of a pattern without a line of sight."""


@dataclass(frozen=True, eq=False)
class PoseTerm:
    """Measured poses of a pattern: difference of position, or of orientation, along the sensor's axes.

    The two are separate terms, since they have different noise.
    """

    measured: Array
    """(V, 4, 4): ``T_sensor_pattern``, of the pattern's centre."""
    kind: Literal["pose_translation", "pose_rotation"]
    along: float = 1.0
    """Standard deviation of a position along the line of sight over that across."""
    dimension: ClassVar[int] = 3

    @cached_property
    def counts(self) -> IntArray:
        """(V,): one label in each view."""
        return np.ones(len(self.measured), int)

    @property
    def length(self) -> int:
        """One."""
        return 1

    def take(self, views: IntArray | slice) -> Self:
        """Return the term of only some of the views."""
        return replace(self, measured=self.measured[views])

    def seen_with(self, camera: Camera, free: Sequence[int]) -> Self:
        """See `calibration.engine.estimation.residuals.views.Term`; a pose has no intrinsics."""
        return self

    def linearise(self, T: Array, scale: float, huber: float | None, squares: Array | None = None) -> Linearised:
        """See `calibration.engine.estimation.residuals.views.Term`."""
        cost, rows = self._weighted_rows(T, scale, huber)
        if squares is not None:
            squares[:] = self.magnitudes(T) ** 2
        return cost, *squeezed(rows)

    def rows(self, T: Array, views: slice, scale: float, huber: float | None, spare: int = 0) -> tuple[Array, Array]:
        """See `calibration.engine.estimation.residuals.views.Term`; at the pattern's centre."""
        rows = self.take(views)._weighted_rows(T, scale, huber)[1]
        return spread(rows, np.empty((7 + spare, len(T), 3)))[..., None], np.zeros((1, 3, 1))

    def magnitudes(self, T: Array) -> Array:
        """(V, 1): distance in m, or angle in rad, weighted."""
        return np.asarray(np.linalg.norm(self._weight_rows(self._residuals_at(T)[:, None]), axis=-1))

    def along_and_across(self, T: Array) -> tuple[Array, Array]:
        """Return the squared residuals (V,) along the line of sight and across."""
        residuals = self._residuals_at(T)
        along = (residuals * self._lines_of_sight).sum(-1) ** 2
        return along, (residuals**2).sum(-1) - along

    @cached_property
    def _lines_of_sight(self) -> Array:
        """(V, 3): unit vectors along the line of sight; 0 of a pattern that is at the sensor itself."""
        t = self.measured[:, :3, 3]
        return np.asarray(t / np.maximum(np.linalg.norm(t, axis=-1, keepdims=True), AT_SENSOR))

    def _weight_rows(self, rows: Array) -> Array:
        """Weight rows (V, k, 3) so that noise is the same in all directions, of the same mean square."""
        if self.along == 1.0:
            return rows
        part = rows @ self._lines_of_sight[..., None] * self._lines_of_sight[:, None]
        return np.asarray(np.sqrt((2 + self.along**2) / 3) * (rows + (1 / self.along - 1) * part))

    def _residuals_at(self, T: Array) -> Array:
        """(V, 3): m, or a rotation vector, in the sensor's frame."""
        if self.kind == "pose_translation":
            return np.asarray(T[:, :3, 3] - self.measured[:, :3, 3])
        return rotations.log(T[:, :3, :3] @ np.swapaxes(self.measured[:, :3, :3], 1, 2))

    def _weighted_rows(self, T: Array, scale: float, huber: float | None) -> tuple[Array, Array]:
        """Cost (V,) and rows (V, 7, 3).

        A twist (dt, dw) moves the position by ``R dt``. It changes the rotation vector r by ``R dw`` to first order in
        r, and along r exactly: the gradient has no error.
        """
        residuals = self._residuals_at(T)
        rows = np.zeros((len(T), 7, 3))
        first = 0 if self.kind == "pose_translation" else 3
        rows[:, first : first + 3] = np.swapaxes(T[:, :3, :3], 1, 2)
        rows[:, 6] = residuals
        rows = self._weight_rows(rows) / scale
        cost, weight = robust((rows[:, 6] ** 2).sum(-1, keepdims=True), huber)
        return cost, rows if weight is None else rows * weight[:, None]
