"""Calibrate a dataset: from its labels to transforms, their covariances, and warnings."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import is_

import numpy as np

from calibration.base.errors import InputError, UndeterminedError, solvable
from calibration.base.latest import Latest
from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.covariance.result import Calibration, DroppedView
from calibration.engine.estimation.doubts.lags import with_lags
from calibration.engine.estimation.doubts.pose_scale import (
    MOST_STEPS,
    OTHER_SCALE,
    SAME,
    divided,
    has_poses,
    next_ratio,
    rough_ratio,
    undetermined_scale,
    unknown_scale,
)
from calibration.engine.estimation.doubts.suspects import explains_all
from calibration.engine.estimation.doubts.wrong_views import without, wrong_views
from calibration.engine.estimation.from_given_guess import from_given_guess
from calibration.engine.estimation.from_linear_start import from_linear_start
from calibration.engine.estimation.solve.least_squares import Termination, minimise
from calibration.engine.estimation.solve.noise_levels import estimate_scales
from calibration.engine.estimation.solve.normal_equations import Weighting
from calibration.engine.estimation.solve.optimisation import HUBER
from calibration.engine.estimation.solve.options import Options as Options
from calibration.engine.estimation.start.build import Setup, build
from calibration.engine.estimation.start.guesses import Guesses
from calibration.engine.estimation.start.linear_start import LinearStart
from calibration.engine.estimation.start.starting_noise import StartingNoise
from calibration.engine.estimation.start.turned_boards import with_boards_turned_back

TRIAL = Termination(decrease=1e-3, iterations=300)
"""Enough if the optimum explains all views; wrong views make the convergence slow."""
MIN_BAD_FIT = 0.02
"""m: noise of measured poses from which another scale is tried."""
BETTER = 3.0
"""Ratio of the noise to that with another scale, from which the scale is unknown."""


def calibrate(dataset: Dataset, options: Options | None = None, noise: StartingNoise | None = None) -> Calibration:
    """Calibrate the sensors of a dataset.

    Args:
        dataset: the labels, and transforms that serve as the initial guess. It is not changed.
        options: options of the calibration.
        noise: noise that is added to the initial guess.

    Raises:
        UndeterminedError: the data do not determine the parameters; the message names what is missing.
        InputError: the labels cannot be used.
    """
    return Calibrator(dataset, options or Options()).calibrate(noise or StartingNoise())


class Calibrator:
    """Calibrations of a dataset from many initial guesses; what does not depend on the guess is computed once.

    The results are those of `calibrate`, to the last bit. Where the linear start does not depend on the guess, as the
    labels determine all of it, all calibrations from it are one object.
    """

    def __init__(self, dataset: Dataset, options: Options) -> None:
        """Create a calibrator.

        Args:
            dataset: the labels, and transforms that serve as the initial guess. It is not changed.
            options: options of all its calibrations.
        """
        self._given, self._turned = with_boards_turned_back(dataset)
        self._options = options
        self._of_all_views: Latest[LinearStart, Calibration | _Rest] = Latest(LinearStart.equals)
        self._of_the_rest: Latest[LinearStart, Calibration] = Latest(LinearStart.equals)
        self._of_solved_setup: Latest[Setup, Guesses] = Latest(is_)

    @cached_property
    def _dataset(self) -> Dataset:
        """The dataset that is calibrated: with the scale of measured poses and the lags that were found."""
        options = self._options
        dataset = self._given if options.scale == "known" else _with_scale(self._given, options)[0]
        if not (free := options.free_lags_of(dataset)):
            return dataset
        known = replace(options, lag=())  # lags that cannot be told beside each other would have no error bars
        return with_lags(dataset, free, lambda each: _from_all_labels(each, known))

    def calibrate(self, noise: StartingNoise) -> Calibration:
        """Calibrate from the initial guess with noise.

        Raises:
            UndeterminedError: as `calibrate`.
            InputError: likewise.
        """
        with solvable(self._given.path):
            dataset = self._dataset
            try:
                found = self._what_is_determined(noise)
            except UndeterminedError as error:
                if (factor := self._unknown_scale()) is not None:
                    raise unknown_scale(dataset, factor) from error
                if not dataset.missing_files:
                    raise
                missing = "; ".join(map(dataset.missing_files_of, dataset.missing_files))
                raise UndeterminedError(f"{error}; {missing}") from error
            if (factor := self._better_scale(found)) is not None:
                raise unknown_scale(dataset, factor)
            return replace(found, turned_views=self._turned) if self._turned else found

    def without(self, dropped: tuple[DroppedView, ...], noise: StartingNoise) -> Calibration:
        """Calibrate from the initial guess with noise, without the labels of some views.

        Raises:
            UndeterminedError: the other views do not determine the parameters.
        """
        with solvable(self._given.path):
            rest = _Rest(Guesses(_setup_of(without(self._dataset, dropped), self._options)), dropped)
            return replace(self._from_rest(rest, rest.guesses.linear(noise)), turned_views=self._turned)

    def _unknown_scale(self) -> float | None:
        """Return the factor by which the translations of measured poses must be divided to fit; None if there is none.

        What is near 1, or does not fit either, is not the reason why nothing is determined.
        """
        if self._options.scale == "free" or not has_poses(self._dataset):
            return None
        try:
            _, factor = _with_scale(self._dataset, self._options)
        except UndeterminedError:
            return None
        return factor if abs(np.log(factor)) > OTHER_SCALE else None

    def _better_scale(self, found: Calibration) -> float | None:
        """Return the factor with which poses that fit badly fit much better; None if there is none."""
        level = found.noise_levels.pose_translation
        if level is None or level < MIN_BAD_FIT or (factor := self._unknown_scale()) is None:
            return None
        other = _from_all_labels(divided(self._dataset, factor), self._options).noise_levels.pose_translation
        return factor if other is not None and other * factor * BETTER < level else None

    def _what_is_determined(self, noise: StartingNoise) -> Calibration:
        """Calibrate; if the robot's motion is insufficient for that, calibrate the sensors relative to each other."""
        try:
            return self._calibrated(noise)
        except UndeterminedError as error:
            if (relative := self._relative(noise)) is None:
                raise
            why = str(error).removeprefix(f"{self._dataset.path}: ")
            return replace(relative, not_determined=why)

    def _relative(self, noise: StartingNoise) -> Calibration | None:
        """Return the calibration of the sensors relative to each other; None if it is not determined either."""
        try:
            found = self._with_free_patterns._calibrated(noise) if self._with_free_patterns else None
        except InputError:
            return None
        return found if found and found.converged and found.gauge else None

    @cached_property
    def _with_free_patterns(self) -> "Calibrator | None":
        """Calibrator with the pose of each fixed pattern free in each collection; None if there is no use for one.

        Then nothing depends on the motion of the robot between collections, and the poses of the sensors on the robot
        are not determined. Only sensors that see a pattern together have a relative pose.
        """
        dataset = self._dataset
        fixed = [name for name, pattern in dataset.patterns.items() if pattern.fixed]
        if len(dataset.sensors) < 2 or not fixed or set(fixed) & set(self._options.hold):
            return None
        patterns = {name: replace(pattern, fixed=False) for name, pattern in dataset.patterns.items()}
        return Calibrator(replace(dataset, patterns=patterns), self._options)

    def _calibrated(self, noise: StartingNoise) -> Calibration:
        linear = self._from_linear_start(noise)
        if self._options.start == "linear":
            return linear
        guesses = self._guesses_of(linear.solution.setup)
        return from_given_guess(self._dataset, linear, guesses.given(noise), self._options)

    def _guesses_of(self, setup: Setup) -> Guesses:
        """Return the guesses for the problem that was solved: with all views and coefficients, or without some."""
        if setup is self._guesses.setup:
            return self._guesses
        return self._of_solved_setup.of(setup, lambda: Guesses(setup))

    @cached_property
    def _guesses(self) -> Guesses:
        return Guesses(_setup_of(self._dataset, self._options))

    def _from_linear_start(self, noise: StartingNoise) -> Calibration:
        start = self._guesses.linear(noise)
        found = self._of_all_views.of(start, lambda: self._from_all_views(start))
        if isinstance(found, Calibration):
            return found
        try:
            rest = found.guesses.linear(noise)
            return self._of_the_rest.of(rest, lambda: self._from_rest(found, rest))
        except UndeterminedError as error:
            raise _without_views(error, found.dropped) from error

    def _from_all_views(self, start: LinearStart) -> "Calibration | _Rest":
        """Calibrate with all views; if some contradict the others, return what remains without them."""
        dataset, setup, options = self._dataset, self._guesses.setup, self._options
        dropped = wrong_views(setup, start.values, options.assume)
        if not dropped:
            return from_linear_start(dataset, setup, start, options)
        if (whole := _explained(dataset, setup, start, options)) is not None:
            return whole
        try:
            return _Rest(Guesses(_setup_of(without(dataset, dropped), options)), dropped)
        except UndeterminedError as error:
            raise _without_views(error, dropped) from error

    def _from_rest(self, rest: "_Rest", start: LinearStart) -> Calibration:
        found = from_linear_start(self._dataset, rest.guesses.setup, start, self._options)
        return replace(found, dropped_views=rest.dropped)


@dataclass(frozen=True, eq=False)
class _Rest:
    """Problem without the views that contradict the others, and these views."""

    guesses: Guesses
    dropped: tuple[DroppedView, ...]


def _with_scale(dataset: Dataset, options: Options) -> tuple[Dataset, float]:
    """Return the dataset with the translations of its measured poses divided by their scale, and that factor."""
    factor = 1.0
    for step in range(MOST_STEPS):
        setup = _setup_of(dataset, options)
        start = Guesses(setup).linear(StartingNoise())
        if step == 0:
            ratio = rough_ratio(setup, start.values)
        else:
            ratio = next_ratio(from_linear_start(dataset, setup, start, options))
        if ratio is None:
            break
        dataset, factor = divided(dataset, ratio), factor * ratio
        if step and abs(ratio - 1) < SAME:
            return dataset, factor
    raise undetermined_scale(dataset)


def _from_all_labels(dataset: Dataset, options: Options) -> Calibration:
    setup = _setup_of(dataset, options)
    return from_linear_start(dataset, setup, Guesses(setup).linear(StartingNoise()), options)


def _setup_of(dataset: Dataset, options: Options) -> Setup:
    return build(dataset, options.hold, options.intrinsics, options.known_intrinsics())


def _without_views(error: UndeterminedError, dropped: Sequence[DroppedView]) -> UndeterminedError:
    """Return an error that names the collections with rejected views."""
    views = ", ".join(dict.fromkeys(view.collection for view in dropped))
    return UndeterminedError(f"{error} (left out, as their views contradict the others: {views})")


def _explained(dataset: Dataset, setup: Setup, start: LinearStart, options: Options) -> Calibration | None:
    """Calibrate with all views, if an error of a fixed parameter explains their contradictions; else None."""
    problem = setup.problem
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        scales = estimate_scales(problem, start.values, {}, robust=True)
        trial = minimise(problem, start.values, Weighting(scales, HUBER), TRIAL)
    if not trial.reached:  # other weights would not help, after many iterations
        return None
    try:
        whole = from_linear_start(dataset, setup, replace(start, values=trial.values), options)
    except UndeterminedError:
        return None
    return whole if whole.converged and explains_all(whole.solution.model) else None
