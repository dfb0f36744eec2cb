"""Free scale of measured poses and free lags of sensors, each found by Newton steps beside all that is calibrated.

A camera alone gives poses up to scale: their translations are too long by a common factor. At the optimum for one
factor, one Newton step in it beside all that is calibrated leads to the next::

    step = -(B^T r) / (B^T B - B^T A (A^T A)^-1 A^T B)

With the rotations, which no factor changes, the rest is linear in the factor and the translations; a wrong factor makes
residuals of translations large, so that their estimated noise leaves the rotations to the rotations.

The lag of a sensor is the time from a collection's transforms to what it saw. At the optimum for given lags, one Newton
step in all free ones beside all that is calibrated leads to the next. The transforms that a sensor saw are those of the
dataset, moved by their velocities for its lag (`Dataset.moved_by_lag`), so that a step is nearly exact.

The own uncertainty of both is in the error bars (`calibration.engine.estimation.covariance.error_bars`).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from calibration.base import InputError, UndeterminedError
from calibration.engine.dataset.model import Dataset, Labels, PoseLabels
from calibration.engine.dataset.sensors import MAX_LAG
from calibration.engine.estimation.at_optimum import from_linear_start
from calibration.engine.estimation.covariance.calibrated import calibrated_dataset
from calibration.engine.estimation.covariance.cluster_state import MIN_INFORMATION_LEFT
from calibration.engine.estimation.covariance.fixed_inputs import LAG_KIND, SCALE_KIND
from calibration.engine.estimation.covariance.linear_model import LinearModel, linear_model
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.least_squares.normal_equations import Weighting
from calibration.engine.estimation.options import ALL_EXACT, Options
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.start.build import Setup
from calibration.engine.estimation.start.guesses import problem_and_start

MIN_BAD_FIT_M = 0.02
"""Noise of measured poses from which another scale is tried."""
MIN_NOISE_RATIO = 3.0
"""Ratio of the noise to that with another scale, from which the scale is unknown."""
MAX_SCALE_STEP_IF_FOUND = 1e-7
"""Step, relative, after which the factor is found."""
MIN_LOGARITHM_OF_OTHER_SCALE = 0.05
"""Logarithm of a factor from which poses have another scale than metres."""
MAX_STEPS = 30
MAX_STEP_RATIO = 100.0
"""Largest ratio of a factor to the one before."""
ROUGH_WEIGHTING = Weighting({"pose_translation": 1.0, "pose_rotation": 1e-3}, None)
"""Weights (m, rad) before anything is known of the noise: the rotations stay nearly as they start."""


def with_free_scale(dataset: Dataset, options: Options) -> tuple[Dataset, float]:
    """Return the dataset with the translations of its measured poses divided by their scale, and that factor.

    Raises:
        UndeterminedError: the poses do not determine their scale.
    """
    factor = 1.0
    for step in range(MAX_STEPS):
        setup, start = problem_and_start(dataset, options)
        if step == 0:
            model = _rough_model(setup, start.values)
        else:
            model = from_linear_start(dataset, setup, start, options).solution.model
        if (ratio := _ratio_by_newton_step(model)) is None:
            break
        dataset, factor = divided(dataset, ratio), factor * ratio
        if step and abs(ratio - 1) < MAX_SCALE_STEP_IF_FOUND:
            return dataset, factor
    raise _undetermined_scale(dataset)


def wrong_scale(dataset: Dataset, options: Options) -> float | None:
    """Return the factor by which the translations of measured poses must be divided to fit; None if there is none.

    What is near 1, or does not fit either, is not the reason why nothing is determined.
    """
    if options.scale == "free" or not any(
        isinstance(label, PoseLabels) for c in dataset.collections for label in c.labels.values()
    ):
        return None
    try:
        _, factor = with_free_scale(dataset, options)
    except UndeterminedError:
        return None
    return factor if abs(np.log(factor)) > MIN_LOGARITHM_OF_OTHER_SCALE else None


def better_scale(dataset: Dataset, options: Options, optimum: Calibration) -> float | None:
    """Return the factor with which measured poses that fit badly fit much better; None if there is none."""
    level = optimum.noise_levels.pose_translation
    if level is None or level < MIN_BAD_FIT_M or (factor := wrong_scale(dataset, options)) is None:
        return None
    scaled = divided(dataset, factor)
    other = from_linear_start(scaled, *problem_and_start(scaled, options), options).noise_levels.pose_translation
    return factor if other is not None and other * factor * MIN_NOISE_RATIO < level else None


def _rough_model(setup: Setup, values: Values) -> LinearModel:
    """Return the model by plain least squares at an initial guess."""
    dataset = calibrated_dataset(setup, values, setup.dataset)
    return linear_model(setup.problem, values, ROUGH_WEIGHTING, dataset, ALL_EXACT, free_scale=True)


def _ratio_by_newton_step(model: LinearModel) -> float | None:
    """Return 1 and the Newton step of the scale, beside that of all shared parameters; None if it is not determined."""
    own = [at.start for _, at in model.placed(SCALE_KIND)][:1]
    if not own:
        return None
    left, gradient = model.beside_shared(own)
    if not left[0, 0] > MIN_INFORMATION_LEFT * model.alone[own[0]]:
        return None
    return float(np.clip(1 - gradient[0] / left[0, 0], 1 / MAX_STEP_RATIO, MAX_STEP_RATIO))


def divided(dataset: Dataset, factor: float) -> Dataset:
    """Return the dataset with the translations of all measured poses divided by a factor."""

    def scaled(label: Labels) -> Labels:
        if not isinstance(label, PoseLabels):
            return label
        T = label.T.copy()
        T[:3, 3] /= factor
        return PoseLabels(T)

    collections = tuple(
        replace(c, labels={key: scaled(label) for key, label in c.labels.items()}) for c in dataset.collections
    )
    return replace(dataset, collections=collections)


def unknown_scale(dataset: Dataset, factor: float) -> UndeterminedError:
    """Return the error of poses that fit with another scale."""
    return UndeterminedError(
        f"{dataset.path}: the scale of the measured poses is unknown: they fit the arm with translations {factor:.4g} "
        f"times too long; give them in metres, or set 'scale: free' in calibration.yml"
    )


def _undetermined_scale(dataset: Dataset) -> UndeterminedError:
    """Return the error of poses that do not determine their scale."""
    return UndeterminedError(
        f"{dataset.path}: the poses do not determine their scale (scale: free); the arm must carry the sensor or the "
        f"pattern along, not turn it alone"
    )


MAX_LAG_STEP_IF_FOUND = 1e-7
"""s: step after which the lags are found."""
MAX_LAG_STEPS = 15
MAX_LAG_STEP = 0.1
"""s: limit of one step."""
MAX_LAG_SIGMA = 0.05
"""s: limit of the standard deviation of a lag that is determined; frames that stand still leave a larger one."""


def with_lags(dataset: Dataset, free: Sequence[str], calibrated: Callable[[Dataset], Calibration]) -> Dataset:
    """Return the dataset with the lags of some sensors as its labels tell.

    Args:
        dataset: the dataset.
        free: the sensors.
        calibrated: calibrates a dataset with the lags that it has.

    Raises:
        InputError: a sensor is unknown.
        UndeterminedError: the labels do not determine a lag.
    """
    for name in free:
        if name not in dataset.sensors:
            raise InputError(f"{dataset.path}: lag: found sensor '{name}', expected of {', '.join(dataset.sensors)}")
    if not dataset.velocities:
        raise UndeterminedError(
            f"{dataset.path}: the dataset has no velocities, which a lag is told by (lag): import it from a bag of "
            f"a robot that moves while its sensors look (import.yml: bags: every), or leave 'lag' out"
        )
    for _ in range(MAX_LAG_STEPS):
        steps = _newton_steps(calibrated(dataset).solution.model, free, dataset)
        lags = {name: dataset.sensors[name].lag + step for name, step in steps.items()}
        if far := next((name for name, lag in lags.items() if abs(lag) > MAX_LAG), None):
            raise UndeterminedError(
                f"{dataset.path}: the lag of '{far}' comes out beyond {MAX_LAG:g} s (lag): are the velocities, and the "
                f"order of the images, those of this recording?"
            )
        dataset = dataset.with_lags(lags)
        if max(map(abs, steps.values())) < MAX_LAG_STEP_IF_FOUND:
            return dataset
    raise UndeterminedError(f"{dataset.path}: the lags were not found in {MAX_LAG_STEPS} steps (lag): leave it out")


def _newton_steps(model: LinearModel, free: Sequence[str], dataset: Dataset) -> Mapping[str, float]:
    """Return the Newton step of each free lag, s."""
    places = {cause.subject: at.start for cause, at in model.placed(LAG_KIND)}
    if standing := next((name for name in free if name not in places), None):
        raise _undetermined_lag(dataset, standing)
    own = [places[name] for name in free]
    left, gradient = model.beside_shared(own)
    scale = 1 / np.sqrt(model.alone[own])
    values, vectors = np.linalg.eigh(scale[:, None] * left * scale)
    if values[0] <= MIN_INFORMATION_LEFT:
        raise _undetermined_lag(dataset, free[int(np.abs(vectors[:, 0]).argmax())])
    covariance = np.linalg.inv(left)
    sigmas = np.sqrt(np.diagonal(covariance))
    if sigmas.max() > MAX_LAG_SIGMA:
        raise _undetermined_lag(dataset, free[int(sigmas.argmax())])
    return dict(zip(free, np.clip(-covariance @ gradient, -MAX_LAG_STEP, MAX_LAG_STEP).tolist(), strict=True))


def _undetermined_lag(dataset: Dataset, sensor: str) -> UndeterminedError:
    others = [name for name in dataset.sensors if name != sensor]
    one = f", or leave '{others[0]}' the clock: lag: [{sensor}]" if others else ""
    return UndeterminedError(
        f"{dataset.path}: the labels do not determine the lag of '{sensor}' (lag): collect while the robot or the "
        f"pattern moves, in several directions{one}; or leave it out"
    )


def with_scale_and_lags(dataset: Dataset, options: Options) -> Dataset:
    """Return the dataset with the scale of its measured poses and the lags of its sensors, where they are free."""
    if options.scale == "free":
        dataset, _ = with_free_scale(dataset, options)
    if not (free := options.free_lags_of(dataset)):
        return dataset
    known = replace(options, lag=())  # lags that cannot be told beside each other would have no error bars
    return with_lags(dataset, free, lambda each: from_linear_start(each, *problem_and_start(each, known), known))
