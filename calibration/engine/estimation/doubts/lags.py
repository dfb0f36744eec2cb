"""Lags of sensors: the time from a collection's transforms to what a sensor saw, where velocities are known.

At the optimum for given lags, one Newton step in all free ones beside all that is calibrated leads to the next. The
transforms that a sensor saw are those of the dataset, moved by their velocities for its lag
(`Dataset.moved_by_lag`), so that a step is nearly exact. Their own uncertainty is in the
error bars (`calibration.engine.estimation.covariance.error_bars`).
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from calibration.base.errors import InputError, UndeterminedError
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.sensors import MAX_LAG
from calibration.engine.estimation.covariance.fixed_inputs import LAG_KIND
from calibration.engine.estimation.covariance.linear_model import LinearModel
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.doubts.suspects import MIN_INFORMATION_LEFT

MAX_STEP_IF_FOUND = 1e-7
"""s: step after which the lags are found."""
MAX_STEPS = 15
MAX_STEP = 0.1
"""s: limit of one step."""
MAX_SIGMA = 0.05
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
    for _ in range(MAX_STEPS):
        steps = _newton_steps(calibrated(dataset).solution.model, free, dataset)
        lags = {name: dataset.sensors[name].lag + step for name, step in steps.items()}
        if far := next((name for name, lag in lags.items() if abs(lag) > MAX_LAG), None):
            raise UndeterminedError(
                f"{dataset.path}: the lag of '{far}' comes out beyond {MAX_LAG:g} s (lag): are the velocities, and the "
                f"order of the images, those of this recording?"
            )
        dataset = dataset.with_lags(lags)
        if max(map(abs, steps.values())) < MAX_STEP_IF_FOUND:
            return dataset
    raise UndeterminedError(f"{dataset.path}: the lags were not found in {MAX_STEPS} steps (lag): leave it out")


def _newton_steps(model: LinearModel, free: Sequence[str], dataset: Dataset) -> Mapping[str, float]:
    """Return the Newton step of each free lag, s."""
    places = {
        cause.subject: at.start for cause, at in zip(model.causes, model.places, strict=True) if cause.kind == LAG_KIND
    }
    if standing := next((name for name in free if name not in places), None):
        raise _undetermined_lag(dataset, standing)
    own, S, total, g = [places[name] for name in free], model.shared, model.total, model.g.sum(0)
    moves = np.linalg.solve(total[:S, :S], np.concatenate([total[:S, own], g[:S, None]], -1))
    left = total[np.ix_(own, own)] - total[own, :S] @ moves[:, :-1]
    scale = 1 / np.sqrt(model.alone[own])
    values, vectors = np.linalg.eigh(scale[:, None] * left * scale)
    if values[0] <= MIN_INFORMATION_LEFT:
        raise _undetermined_lag(dataset, free[int(np.abs(vectors[:, 0]).argmax())])
    covariance = np.linalg.inv(left)
    sigmas = np.sqrt(np.diagonal(covariance))
    if sigmas.max() > MAX_SIGMA:
        raise _undetermined_lag(dataset, free[int(sigmas.argmax())])
    steps = -covariance @ (g[own] - total[own, :S] @ moves[:, -1])
    return dict(zip(free, np.clip(steps, -MAX_STEP, MAX_STEP).tolist(), strict=True))


def _undetermined_lag(dataset: Dataset, sensor: str) -> UndeterminedError:
    others = [name for name in dataset.sensors if name != sensor]
    one = f", or leave '{others[0]}' the clock: lag: [{sensor}]" if others else ""
    return UndeterminedError(
        f"{dataset.path}: the labels do not determine the lag of '{sensor}' (lag): collect while the robot or the "
        f"pattern moves, in several directions{one}; or leave it out"
    )
