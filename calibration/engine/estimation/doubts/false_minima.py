"""Reasons why an optimum is not the calibration: not reached, or patterns are mirrored."""

import numpy as np

from calibration.base.arrays import BoolArray, IntArray
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.solve.optimisation import WeightedOptimum
from calibration.engine.estimation.start.build import Setup
from calibration.engine.estimation.start.flipped_patterns import unflipped


def why_not_reached(setup: Setup, result: WeightedOptimum) -> str:
    """Return the reason why no minimum was reached; empty if one was."""
    impossible = np.flatnonzero(~np.isfinite(result.optimum.equations.cost))
    if len(impossible):
        behind = _collections_behind_camera(setup, result.optimum.values)[impossible].any()
        why = "the pattern lies behind a camera" if behind else "labels lie too far off to be compared with the pattern"
        return f"the start is not possible: {why} {_in_collections(setup, impossible)}"
    if not result.optimum.reached:
        return f"no minimum was reached in {result.optimum.iterations} iterations"
    return ""


def _in_collections(setup: Setup, which: IntArray) -> str:
    """Return the collections in words: of more than five their number and the first ones."""
    keys = [setup.dataset.keys[i] for i in which]
    if len(keys) == 1:
        return f"in collection {keys[0]}"
    return f"in {len(keys)} collections ({', '.join(keys[:5])}{', ...' if len(keys) > 5 else ''})"


def _collections_behind_camera(setup: Setup, values: Values) -> BoolArray:
    """Return a mask (N,) of the collections with a corner behind its camera."""
    behind = np.zeros(setup.problem.collections, bool)
    for group in setup.problem.groups:
        for term in setup.problem.terms(group, values):
            magnitudes = term.magnitudes(setup.problem.poses(group, values))
            behind[group.collections] |= np.count_nonzero(~np.isnan(magnitudes), axis=-1) < term.counts
    return behind


def why_invalid(setup: Setup, result: WeightedOptimum) -> str:
    """Return the reason why an optimum is none or has mirrored patterns; empty if it is valid."""
    if reason := why_not_reached(setup, result):
        return reason
    optimum = result.optimum
    _, flipped = unflipped(setup.problem, optimum.values, result.weighting, optimum.equations.cost)
    if flipped.any():
        return f"the pattern is left in its mirrored pose {_in_collections(setup, np.flatnonzero(flipped))}"
    return ""
