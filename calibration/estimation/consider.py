"""What uncertain intrinsics that are not calibrated add to the covariance of the result.

Consider analysis (S. F. Schmidt, "Applications of state-space methods to navigation problems", 1966): the
intrinsics stay as they are, but their errors, of covariance Sigma, move the optimum by ``K = -H_xx^-1 H_xc``
times these errors, so the result's covariance grows by ``K Sigma K^T``. H is that of all shared parameters x
and of the considered ones c, the local ones eliminated.
"""

from dataclasses import replace

import numpy as np

from calibration.estimation.blocks import Block, Values
from calibration.estimation.intrinsics import FreeIntrinsics, Prior
from calibration.estimation.normal_equations import Weighting, assemble
from calibration.estimation.problem import Problem
from calibration.geometry.types import Array


def considered_covariance(problem: Problem, values: Values, weighting: Weighting) -> Array | None:
    """(S, S): what is to be added to the covariance of the shared parameters; None where nothing is considered.

    Args:
        problem: the problem; parameters of intrinsics that have a prior and are not free are considered.
        values: the optimum.
        weighting: its weights.
    """
    if not any(block.intrinsics and block.intrinsics.prior for block in problem.blocks):
        return None
    wider = replace(problem, blocks=tuple(_opened(block) for block in problem.blocks))
    H = assemble(wider, values, weighting).schur
    considered, sigma = np.zeros(len(H), bool), np.zeros_like(H)
    for i, at in wider.shared_parameters.items():
        before, now = problem.blocks[i], wider.blocks[i].intrinsics
        if now is not None and now.prior is not None:
            free = () if before.held or before.intrinsics is None else before.intrinsics.free
            considered[at] = [parameter not in free for parameter in now.free]
            sigma[at, at] = _among(now, now.prior)
    if not considered.any():
        return None
    K = -np.linalg.solve(H[np.ix_(~considered, ~considered)], H[np.ix_(~considered, considered)])
    more: Array = K @ sigma[np.ix_(considered, considered)] @ K.T
    return 0.5 * (more + more.T)


def _opened(block: Block) -> Block:
    """The block with all parameters free that have a prior."""
    intrinsics = block.intrinsics
    if intrinsics is None or intrinsics.prior is None:
        return block
    known = {intrinsics.camera.parameters[i] for i in intrinsics.prior.at}
    free = known if block.held else known | set(intrinsics.free)
    return replace(block, held=False, parameters=intrinsics.with_free(tuple(free)))


def _among(intrinsics: FreeIntrinsics, prior: Prior) -> Array:
    """The prior's covariance among the free parameters (k, k); zero for those that it says nothing of."""
    n = len(intrinsics.camera.parameters)
    everything = np.zeros((n, n))
    everything[np.ix_(prior.at, prior.at)] = prior.covariance
    return everything[np.ix_(intrinsics.at, intrinsics.at)]
