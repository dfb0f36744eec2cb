"""Result of a calibration: transforms, covariances, residuals, also of each label."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from calibration.base import records
from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.base.records import record
from calibration.engine.dataset.modalities import NoiseKind
from calibration.engine.dataset.model import Dataset, Edge
from calibration.engine.estimation.covariance.clusters import repeated_collections
from calibration.engine.estimation.covariance.error_bars import ErrorBars, nominal_covariances
from calibration.engine.estimation.covariance.linear_model import LinearModel, linear_model
from calibration.engine.estimation.covariance.suspects import Explanation, explain
from calibration.engine.estimation.covariance.varying_causes import VaryingCause, steadied, varying_cause
from calibration.engine.estimation.least_squares.noise_levels import NoiseLevels
from calibration.engine.estimation.least_squares.normal_equations import Weighting
from calibration.engine.estimation.options import Assumptions
from calibration.engine.estimation.problem.blocks import CalibratedIntrinsics, Values
from calibration.engine.estimation.residuals.views import chunks
from calibration.engine.estimation.start.build import Setup
from calibration.engine.geometry.frames import JointParameter


@dataclass(frozen=True, eq=False)
class ViewResiduals:
    """Residuals of one sensor and one pattern."""

    sensor: str
    pattern: str
    kind: NoiseKind
    collections: tuple[str, ...]
    """(V,): keys of the collections."""
    magnitudes: Array
    """(V, L): px, m or rad; NaN without a label. Corners are at the index of their id, border points at that of their
    limit point."""


@record(case="snake", unknown="ignore", slots=True)
class RejectedLabel:
    """Label that the robust loss gave less than half its weight."""

    collection: str = records.field("The key of its collection.")
    sensor: str = records.field("The sensor that saw it.")
    pattern: str = records.field("The pattern that it is on.")
    kind: NoiseKind = records.field("What kind of label it is.")
    label: int = records.field("The corner's id, or the position of the point among the labelled points.")
    residual: float = records.field("Size of its residual, px, m or rad.")


@record(case="snake", unknown="ignore")
class DroppedView:
    """View that contradicts the others and was rejected."""

    sensor: str = records.field("The sensor.")
    pattern: str = records.field("The pattern that it saw.")
    collection: str = records.field("The key of its collection.")
    mm: float = records.field(
        "How far the pattern lies from where the others have it; of a LiDAR, its plane.", unit="mm"
    )
    degrees: float = records.field("How far it is turned.", unit="degrees")


@dataclass(frozen=True, eq=False)
class CalibratedJoint:
    """Joint with calibrated parameters."""

    name: str
    parameters: tuple[JointParameter, ...]
    """Free parameters."""
    values: Array
    """(k,): in m or rad, see `units`."""
    units: tuple[Literal["m", "rad"], ...]
    covariance: Array
    """(k, k): total covariance; NaN if the calibration has not converged."""
    label_covariance: Array
    """(k, k): from the noise of the labels alone; NaN likewise."""

    @property
    def sigmas(self) -> Array:
        """(k,): total standard deviation of each parameter, m or rad."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance)))

    @property
    def label_sigmas(self) -> Array:
        """(k,): standard deviation by the noise of the labels alone."""
        return np.asarray(np.sqrt(np.diagonal(self.label_covariance)))


@dataclass(frozen=True)
class CalibratedLag:
    """Lag of a sensor: how much later it saw than its collections' transforms say."""

    seconds: float
    sigma: float
    """s: total standard deviation; NaN if the calibration has not converged."""


@dataclass(frozen=True, eq=False)
class Solution:
    """Solved problem and its optimum, for checks that linearise it again."""

    setup: Setup
    values: Values
    weighting: Weighting
    dataset: Dataset
    """The used collections, with the transforms of the optimum."""
    assume: Assumptions
    free_scale: bool = False
    """Whether the scale of measured poses is calibrated."""
    free_lags: tuple[str, ...] = ()
    """Sensors whose lag is calibrated."""

    @cached_property
    def model(self) -> LinearModel:
        """Linear model at the optimum, of calibrated and fixed parameters."""
        return linear_model(
            self.setup.problem,
            self.values,
            self.weighting,
            self.dataset,
            self.assume,
            self.clusters,
            self.free_scale,
            self.free_lags,
        )

    @cached_property
    def explanation(self) -> Explanation | None:
        """Suspects among the fixed parameters, and what they leave unexplained; None with too few collections."""
        return steadied(self.model, explain(self.model))

    @cached_property
    def varying(self) -> VaryingCause | None:
        """Cause that varies from collection to collection and explains how they disagree, beside the suspects."""
        return varying_cause(self.model, self.explanation.suspects) if self.explanation else None

    @cached_property
    def nominal(self) -> Mapping[int, Array]:
        """Covariance (k, k) of each shared block that a good robot would have with these views."""
        return nominal_covariances(self)

    @cached_property
    def clusters(self) -> IntArray:
        """(N,): index of the first collection that each one repeats, or its own."""
        return repeated_collections(self.dataset, self.weighting.scales.get("pixel"))


@dataclass(frozen=True, eq=False)
class Calibration:
    """Result of a calibration."""

    dataset: Dataset
    """Dataset with the calibrated transforms, including the patterns', and the calibrated intrinsics."""
    solution: Solution
    transforms: Mapping[Edge, Array]
    """Calibrated ``T_parent_child`` (4, 4) of sensors, additional transforms and fixed patterns."""
    covariances: Mapping[Edge, Array]
    """Total covariance (6, 6) of each free transform: of a twist (translation, rotation) in its child frame, m and rad.

    Its terms are described in `covariance.error_bars`, also for those of joints and intrinsics."""
    label_covariances: Mapping[Edge, Array]
    """The same from the noise of the labels alone."""
    error_bars: ErrorBars | None
    """None if it has not converged."""
    converged: bool
    """Whether this is the optimum: reached, finite, no pattern flipped."""
    reason: str
    """Reason why it has not converged; empty if it has."""
    cost: float
    """Sum of squared residuals in standard deviations, with Huber's loss if it is robust."""
    degrees_of_freedom: int
    iterations: int
    noise_levels: NoiseLevels
    """Standard deviations of the labels, given or estimated."""
    residuals: tuple[ViewResiduals, ...]
    rejected: tuple[RejectedLabel, ...]
    weak_directions: tuple[str, ...]
    """Directions that the data hardly determine, named by transform and axis."""
    warnings: tuple[str, ...]
    """Contradictions between the labels and the model."""
    notes: tuple[str, ...]
    """Rejected data, initial values taken from the guess, and transforms fixed because nothing determines them."""
    gauge: str | None
    """Sensor that was fixed because the data determine only relative poses; None if none was."""
    joints: Mapping[str, CalibratedJoint] = field(default_factory=dict)
    """Joints with free parameters, by name."""
    intrinsics: Mapping[str, CalibratedIntrinsics] = field(default_factory=dict)
    """Cameras with free intrinsics, by name."""
    lags: Mapping[str, CalibratedLag] = field(default_factory=dict)
    """Sensors with a calibrated lag, by name."""
    dropped_views: tuple[DroppedView, ...] = ()
    """Rejected views that contradict the majority of the others, which alone determine the result."""
    turned_views: tuple[tuple[str, str, str], ...] = ()
    """Views (pattern, sensor, collection) of a chessboard that were numbered from its other end; they are turned back
    in `dataset`."""
    not_determined: str = ""
    """Reason why only the relative poses of the sensors are calibrated, not their poses on the robot; empty
    otherwise."""

    @property
    def of_cameras_alone(self) -> bool:
        """Whether only intrinsics are calibrated: no sensor's pose, and no joint."""
        setup = self.solution.setup
        edges = {sensor.edge for sensor in setup.dataset.sensors.values()}
        held = all(setup.problem.blocks[setup.block(edge)].held for edge in edges)
        return bool(self.intrinsics) and held and not self.joints

    @cached_property
    def rms_px(self) -> float:
        """Root mean square of the corners' reprojection errors, px; NaN without a camera."""
        errors = [r.magnitudes[np.isfinite(r.magnitudes)] for r in self.residuals if r.kind == "pixel"]
        return float(np.sqrt(np.mean(np.concatenate(errors) ** 2))) if errors else float("nan")

    def sigma_mm(self, edge: Edge) -> float:
        """Total standard deviation of a transform's translation: the norm of the three axes, mm; 0 if it is fixed."""
        return 1e3 * self._norm_of_sigmas(self.covariances, edge, slice(0, 3))

    def sigma_mrad(self, edge: Edge) -> float:
        """Total standard deviation of a transform's rotation: the norm of the three axes, mrad; 0 if it is fixed."""
        return 1e3 * self._norm_of_sigmas(self.covariances, edge, slice(3, 6))

    def label_sigma_mm(self, edge: Edge) -> float:
        """Standard deviation as `sigma_mm`, from the noise of the labels alone."""
        return 1e3 * self._norm_of_sigmas(self.label_covariances, edge, slice(0, 3))

    def label_sigma_mrad(self, edge: Edge) -> float:
        """Standard deviation as `sigma_mrad`, from the noise of the labels alone."""
        return 1e3 * self._norm_of_sigmas(self.label_covariances, edge, slice(3, 6))

    def _norm_of_sigmas(self, covariances: Mapping[Edge, Array], edge: Edge, part: slice) -> float:
        if not self.converged:
            return float("nan")
        if edge not in covariances and edge in self.transforms:
            return 0.0
        return float(np.sqrt(np.trace(covariances[edge][part, part])))


@dataclass(frozen=True, eq=False)
class LabelErrors:
    """Residuals of one kind, of one sensor and one pattern."""

    sensor: str
    pattern: str
    kind: NoiseKind
    errors: Array
    """(V, d, L): px, m or rad, scaled down by the robust loss's weight; 0 without a label."""
    seen: BoolArray
    """(V, L)."""
    points: Array
    """(V, 3, L): expected positions of the labels, in the sensor's frame, m."""


def label_errors(solution: Solution) -> Iterator[LabelErrors]:
    """Yield the errors of all labels.

    Args:
        solution: at the optimum.
    """
    problem, weighting = solution.setup.problem, solution.weighting
    for group in problem.groups:
        T = problem.poses(group, solution.values)
        for term in problem.terms(group, solution.values):
            scale = weighting.scales[term.kind]
            errors, points = [], []
            for part in chunks(len(T), term.length):
                rows, places = term.rows(T[part], part, scale, weighting.huber)
                errors.append(scale * rows[-1])
                points.append(T[part, :3, :3] @ places + T[part, :3, 3:])
            yield LabelErrors(
                group.sensor,
                group.pattern,
                term.kind,
                np.concatenate(errors),
                np.isfinite(term.magnitudes(T)),
                np.concatenate(points),
            )
