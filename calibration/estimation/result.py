"""What a calibration says: transforms, how sure they are, what is left of the residuals."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from calibration import records
from calibration.dataset.modalities import NoiseKind
from calibration.dataset.model import Dataset, Edge
from calibration.estimation.assumptions import Assumptions
from calibration.estimation.blocks import Values
from calibration.estimation.build import Setup
from calibration.estimation.error_bars import ErrorBars
from calibration.estimation.intrinsics import CalibratedIntrinsics
from calibration.estimation.linear_model import LinearModel, linear_model
from calibration.estimation.noise_levels import NoiseLevels
from calibration.estimation.normal_equations import Weighting
from calibration.estimation.repeated import repeated_collections
from calibration.geometry.joints import JointParameter
from calibration.geometry.types import Array, IntArray
from calibration.records import record


@dataclass(frozen=True, eq=False)
class ViewResiduals:
    """What is left between labels and model, for one sensor and one pattern."""

    sensor: str
    pattern: str
    kind: NoiseKind
    collections: tuple[str, ...]
    """(V,): the keys of the collections."""
    magnitudes: Array
    """(V, L): px, m or rad; NaN where there is no label. Corners stand at their ids, borders at their limit
    point's place among the limits."""


@record(case="snake", unknown="ignore", slots=True)
class RejectedLabel:
    """A label that the robust loss gave less than half its weight."""

    collection: str = records.field("The key of its collection.")
    sensor: str = records.field("The sensor that saw it.")
    pattern: str = records.field("The pattern that it is on.")
    kind: NoiseKind = records.field("What kind of label it is.")
    label: int = records.field("The corner's id, or the position of the point among the labelled points.")
    residual: float = records.field("Size of its residual, px, m or rad.")


@record(case="snake", unknown="ignore")
class DroppedView:
    """A view that contradicts the others and was left out."""

    sensor: str = records.field("The sensor.")
    pattern: str = records.field("The pattern that it saw.")
    collection: str = records.field("The key of its collection.")
    mm: float = records.field(
        "How far the pattern lies from where the others have it; of a LiDAR, its plane.", unit="mm"
    )
    degrees: float = records.field("How far it is turned.", unit="degrees")


@dataclass(frozen=True, eq=False)
class CalibratedJoint:
    """A joint of which parameters were calibrated."""

    name: str
    parameters: tuple[JointParameter, ...]
    """Those that were free."""
    values: Array
    """(k,): m or rad, as `units` says."""
    units: tuple[Literal["m", "rad"], ...]
    covariance: Array
    """(k, k), in all; NaN where the calibration has not converged."""
    label_covariance: Array
    """(k, k): of the noise of the labels alone; NaN likewise."""

    @property
    def sigmas(self) -> Array:
        """(k,): the standard deviation of each parameter in all, m or rad."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance)))

    @property
    def label_sigmas(self) -> Array:
        """(k,): that by the noise of the labels alone."""
        return np.asarray(np.sqrt(np.diagonal(self.label_covariance)))


@dataclass(frozen=True, eq=False)
class Solution:
    """The problem that was solved, and where its optimum lies: for checks that linearise it again."""

    setup: Setup
    values: Values
    weighting: Weighting
    dataset: Dataset
    """The collections that count, with the transforms of the optimum."""
    assume: Assumptions

    @cached_property
    def model(self) -> LinearModel:
        """What near the optimum depends on what, calibrated or held."""
        return linear_model(self.setup.problem, self.values, self.weighting, self.dataset, self.assume, self.clusters)

    @cached_property
    def clusters(self) -> IntArray:
        """(N,): of each collection the first one that it repeats, or itself."""
        return repeated_collections(self.dataset, self.weighting.scales.get("pixel"))


@dataclass(frozen=True, eq=False)
class Calibration:
    """The result."""

    dataset: Dataset
    """The dataset with the calibrated transforms, the patterns' among them, and the calibrated intrinsics."""
    solution: Solution
    transforms: Mapping[Edge, Array]
    """The calibrated ``T_parent_child`` (4, 4) of sensors, additional transforms and fixed patterns."""
    covariances: Mapping[Edge, Array]
    """(6, 6) of each transform that was free, in all: of a twist (translation, rotation) in its child frame, m and rad.

    What it contains, `calibration.estimation.error_bars` says; those of joints and intrinsics are of the same kind."""
    label_covariances: Mapping[Edge, Array]
    """The same of the noise of the labels alone."""
    error_bars: ErrorBars | None
    """None where it has not converged."""
    converged: bool
    """Whether this is the optimum: reached, finite, no pattern left flipped."""
    reason: str
    """Why it has not converged; empty when it has."""
    cost: float
    """The sum of squared residuals in standard deviations, with Huber's loss where it is robust."""
    degrees_of_freedom: int
    iterations: int
    noise_levels: NoiseLevels
    """The standard deviations of the labels, given or estimated."""
    residuals: tuple[ViewResiduals, ...]
    rejected: tuple[RejectedLabel, ...]
    weak_directions: tuple[str, ...]
    """What the data hardly determine, named by transform and axis."""
    warnings: tuple[str, ...]
    """What the labels contradict."""
    notes: tuple[str, ...]
    """What was left out, where it started from a guess, and what was held because nothing determines it."""
    gauge: str | None
    """The sensor that was held because the data determine only relative poses; None where nothing had to be."""
    joints: Mapping[str, CalibratedJoint] = field(default_factory=dict)
    """The joints of which parameters were free, by name."""
    intrinsics: Mapping[str, CalibratedIntrinsics] = field(default_factory=dict)
    """Of the cameras of which intrinsics were free, by name."""
    dropped_views: tuple[DroppedView, ...] = ()
    """Views that contradicted the majority of the others; the result is that of the others."""
    not_determined: str = ""
    """Why only the poses of the sensors relative to each other are calibrated, not where they are on the robot; empty
    where all is."""

    @cached_property
    def rms_px(self) -> float:
        """The root mean square of the corners' reprojection errors, px; NaN without a camera."""
        errors = [r.magnitudes[np.isfinite(r.magnitudes)] for r in self.residuals if r.kind == "pixel"]
        return float(np.sqrt(np.mean(np.concatenate(errors) ** 2))) if errors else float("nan")

    def sigma_mm(self, edge: Edge) -> float:
        """The standard deviation of a transform's translation, in all: the norm of the three axes, mm; 0 when held."""
        return 1e3 * self._sigma(self.covariances, edge, slice(0, 3))

    def sigma_mrad(self, edge: Edge) -> float:
        """The standard deviation of a transform's rotation, in all: the norm of the three axes, mrad; 0 when held."""
        return 1e3 * self._sigma(self.covariances, edge, slice(3, 6))

    def label_sigma_mm(self, edge: Edge) -> float:
        """`sigma_mm` of the noise of the labels alone."""
        return 1e3 * self._sigma(self.label_covariances, edge, slice(0, 3))

    def label_sigma_mrad(self, edge: Edge) -> float:
        """`sigma_mrad` of the noise of the labels alone."""
        return 1e3 * self._sigma(self.label_covariances, edge, slice(3, 6))

    def _sigma(self, covariances: Mapping[Edge, Array], edge: Edge, part: slice) -> float:
        if not self.converged:
            return float("nan")
        if edge not in covariances and edge in self.transforms:
            return 0.0
        return float(np.sqrt(np.trace(covariances[edge][part, part])))
