"""How well a motion would determine a calibration, before anything is collected."""

from collections.abc import Mapping

import numpy as np

from calibration.errors import InputError
from calibration.estimation.observability import SINGULAR
from calibration.geometry.types import Array
from calibration.simulation.motion.information import Information, information
from calibration.simulation.motion.sequence import Motion
from calibration.simulation.placement import place
from calibration.simulation.system import System

_PART = 1e-6  # of a direction of length 1: below it rounding has made it


def predicted_sigmas(system: System, motion: Motion) -> Mapping[str, tuple[float, float]]:
    """The standard deviations that a calibration of this motion's dataset would state.

    With the labels that are expected of the sensors, with the noise that they are given there;
    outliers, errors of the model and poses that a detector loses are left out.

    Returns:
        By sensor, translation (m) and rotation (rad) of its calibrated transform, each the norm of
        three axes as in `calibration.estimation.result.Calibration.sigma_mm`. Zero for a sensor that
        is anchored or fixes a free gauge; infinite for what the motion does not determine.

    Raises:
        InputError: the motion does not fit the system (see `calibration.simulation.placement.place`).
    """
    sensors = list(system.configuration.sensors.values())
    placement = place(system, motion)
    try:
        found = information(system, placement)
    except InputError:  # poses that calibrate nothing
        return {sensor.name: (np.inf, np.inf) for sensor in sensors}
    sigmas = _sigmas(found, system)
    setup, held = found.setup, (0.0, 0.0)
    blocks = {sensor.name: setup.block((sensor.parent_link, sensor.child_link)) for sensor in sensors}
    return {name: sigmas.get(block, held) for name, block in blocks.items()}


def _sigmas(found: Information, system: System) -> dict[int, tuple[float, float]]:
    """Translation (m) and rotation (rad) of each shared block that is a pose."""
    problem = found.setup.problem
    unit = found.units(max(pattern.size for pattern in system.patterns.values()))
    variance = _variances(unit[:, None] * found.each.sum(0) * unit) * unit**2
    sigmas = {}
    for block, at in problem.shared_parameters.items():
        if problem.blocks[block].joint is None:
            translation, rotation = np.sqrt(variance[at].reshape(2, 3).sum(-1)).tolist()
            sigmas[block] = (translation, rotation)
    return sigmas


def _variances(information: Array) -> Array:
    """The variance (D,) of each parameter from the information (D, D) on all; infinite where it leaves it open."""
    values, directions = np.linalg.eigh(information)
    open_ = values <= SINGULAR * values[-1]
    variance: Array = (directions[:, ~open_] ** 2 / values[~open_]).sum(-1)
    return np.where((np.abs(directions[:, open_]) > _PART).any(-1), np.inf, variance)
