"""Covariance that a good robot of this kind would have with this recording's views: the source of default limits.

Labels with at most the noise that a detector keeps, collections that agree as those of a good arm do, fixed parameters
known as assumed. The recording gives the views alone: whatever is wrong with it does not widen this covariance.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.modalities import NoiseKind
from calibration.engine.estimation.covariance.error_bars import error_bars
from calibration.engine.estimation.covariance.fixed_inputs import ARM_ACCURACY, LINK_KIND
from calibration.engine.estimation.covariance.linear_model import LinearModel, linear_model
from calibration.engine.estimation.problem.blocks import Pose
from calibration.engine.estimation.solve.normal_equations import Weighting

if TYPE_CHECKING:
    from calibration.engine.estimation.covariance.result import Solution

MAX_NOISE: Mapping[NoiseKind, float] = {
    "pixel": 0.35,
    "range": 0.03,
    "border": 0.02,
    "depth_border": 0.02,
    "lidar2d_range": 0.03,
    "lidar2d_border": 0.02,
    "pose_translation": 0.005,
    "pose_rotation": 0.01,
}
"""Largest noise of good labels (px, m or rad): what a detector in sharp images, a LiDAR, a tracker keeps."""


def nominal_covariances(solution: "Solution") -> Mapping[int, Array]:
    """Return the covariance (k, k) of each shared block of a good robot with these views.

    Args:
        solution: the optimum.
    """
    model = _nominal_model(solution)
    problem, S = solution.setup.problem, model.shared
    at = problem.shared_parameters
    poses = [block for block in at if isinstance(problem.blocks[block].parameters, Pose)]
    expected = error_bars(model, at, poses).expected
    scatter = -np.linalg.inv(model.total[:S, :S]) @ arm_scatter(model)[:, :S]  # (K, S, H)
    return {
        block: C + np.einsum("kih,kjh->ij", scatter[:, at[block]], scatter[:, at[block]])
        for block, C in expected.items()
    }


def arm_scatter(model: LinearModel) -> Array:
    """Return the gradients (K, C, H) of each cluster by one standard deviation of the arm's H errors in it alone."""
    links = [(cause, at) for cause, at in zip(model.causes, model.places, strict=True) if cause.kind == LINK_KIND]
    columns = [model.G[:, :, at] * cause.assumed for cause, at in links]
    if not columns:
        return np.zeros((*model.g.shape, 0))
    scatter: Array = np.concatenate(columns, -1) * (ARM_ACCURACY / np.sqrt(len(links)))
    return scatter


def _nominal_weighting(weighting: Weighting) -> Weighting:
    """Return the weighting with the noise of good labels; itself where that is what they have."""
    scales = {kind: min(scale, MAX_NOISE[kind]) for kind, scale in weighting.scales.items()}
    return weighting if scales == weighting.scales else Weighting(scales, None)


def _nominal_model(solution: "Solution") -> LinearModel:
    weighting = _nominal_weighting(solution.weighting)
    if weighting is solution.weighting:
        return solution.model
    return linear_model(
        solution.setup.problem, solution.values, weighting, solution.dataset, solution.assume, solution.clusters
    )
