"""Hypotheses of conventions, and how badly a dataset fits its best calibration by them, found fast."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from calibration.base import CalibrationError, rounded
from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.least_squares.minimisation import HUBER_THRESHOLD, Termination, minimise
from calibration.engine.estimation.least_squares.normal_equations import Weighting
from calibration.engine.estimation.options import Options
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.start.build import Setup
from calibration.engine.estimation.start.guesses import problem_and_start
from calibration.engine.estimation.start.wrong_views import (
    MIN_NOTICEABLE_RESIDUAL,
    median_residuals,
    noise_in_own_fits,
)

SHARE_OF_VIEWS = 0.8
"""Share of a sensor's views that a misfit is of: of the others each may be wrong."""
A_FEW_STEPS = Termination(decrease=0.1, iterations=15)


@dataclass(frozen=True, eq=False)
class Misfit:
    """Residuals that most views of the worst sensor do not exceed."""

    noticed: float
    """In multiples of what is noticeable (1 px, 1 cm); infinite if there is no start."""
    text: str
    """With its unit."""
    above_noise: float = np.inf
    """Largest one of a sensor, in multiples of the residuals from each view's own fit; infinite without such."""
    setup: Setup | None = None
    values: Values = ()

    @property
    def exists(self) -> bool:
        """Whether there is a start at all."""
        return bool(np.isfinite(self.noticed))


NO_RESULT = Misfit(np.inf, "no result")


def misfit(dataset: Dataset, options: Options, steps: bool = True) -> Misfit:
    """Return the misfit of a dataset, after a few steps or at the linear start."""
    with np.errstate(all="ignore"):
        try:
            setup, start = problem_and_start(dataset, options)
            values = start.values
            at_start = misfit_at(setup, values)
            return misfit_at(setup, _values_nearer_to_optimum(setup, values)) if steps else at_start
        except (CalibrationError, np.linalg.LinAlgError):
            return NO_RESULT


def improved(found: Misfit) -> Misfit:
    """Return the misfit after a few steps from that of a linear start."""
    if found.setup is None:
        return found
    with np.errstate(all="ignore"):
        try:
            return misfit_at(found.setup, _values_nearer_to_optimum(found.setup, found.values))
        except (CalibrationError, np.linalg.LinAlgError):
            return found


def _values_nearer_to_optimum(setup: Setup, values: Values) -> Values:
    """Return values nearer to the optimum, by the corners, the points on the plane, and where patterns are."""
    groups = tuple(replace(group, terms=group.terms[:1]) for group in setup.problem.groups)
    nearby = replace(setup.problem, groups=groups)
    scales = {group.terms[0].kind: MIN_NOTICEABLE_RESIDUAL[group.terms[0].kind] / 2 for group in groups}
    return minimise(nearby, values, Weighting(scales, HUBER_THRESHOLD), A_FEW_STEPS).values


def misfit_at(setup: Setup, values: Values) -> Misfit:
    """Return the misfit at some values of a problem's blocks."""
    noticed, above_noise, text = 0.0, 0.0, "0 px"
    for group in setup.problem.groups:
        kind = group.terms[0].kind
        miss = np.sort(median_residuals(setup.problem, group, values))
        size = float(miss[int(np.ceil(SHARE_OF_VIEWS * len(miss))) - 1])
        noise = noise_in_own_fits(group)
        above_noise = max(above_noise, size / noise if noise > 0 else np.inf)
        if not size / MIN_NOTICEABLE_RESIDUAL[kind] <= noticed:
            noticed = size / MIN_NOTICEABLE_RESIDUAL[kind]
            text = f"{rounded(size, 2)} px" if kind == "pixel" else f"{rounded(1e3 * size, 2)} mm"
    return Misfit(noticed, text if np.isfinite(noticed) else "no result", above_noise, setup, values)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Other convention, with the dataset as it would be, and what to change in the recording."""

    name: str
    """After "with": "the robot's poses inverted"."""
    remedy: str
    """What to change, in the user's files."""
    dataset: Callable[[], Dataset]
    sensors: tuple[str, ...] = ()
    """Those concerned."""
    told_apart: Callable[[Misfit], tuple[str, str]] | None = None
    """Name and remedy by the result, where conventions have the same equations and only its size tells them apart."""
