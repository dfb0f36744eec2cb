"""What each pose of a motion tells about the calibrated transforms, as the engine would find it.

The engine's own terms are linearised at the truth on the labels that are expected there
(`calibration.simulation.motion.expected`): so what is predicted here is what
`calibration.estimation.observability` reports once the dataset is collected.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calibration.dataset.modalities import NoiseKind
from calibration.errors import InputError
from calibration.estimation.blocks import Values
from calibration.estimation.build import Setup, build
from calibration.estimation.design import informations
from calibration.estimation.normal_equations import Weighting
from calibration.estimation.observability import SINGULAR
from calibration.geometry.transforms import inverse, translation
from calibration.geometry.types import Array, IntArray
from calibration.simulation.motion.expected import expected_dataset
from calibration.simulation.motion.sequence import Motion
from calibration.simulation.placement import Placement, place
from calibration.simulation.robot import compose
from calibration.simulation.system import System

_USUAL_DISTANCE = 2.0  # m, to the pattern: the noise of a depth grows with it


@dataclass(frozen=True, eq=False)
class Information:
    """What each of N poses tells about S parameters that all poses share."""

    setup: Setup
    """What is calibrated."""
    poses: IntArray
    """(N,): the poses of the motion that tell anything."""
    each: Array
    """(N, S, S): the information matrices on the parameters of `Problem.shared` (twists, translation in m and
    rotation in rad, each in its child frame; or what is free of a joint), what each pose has its own of eliminated.
    They add up."""

    @property
    def calibrated(self) -> int:
        """How many of the S parameters belong to what is calibrated; a fixed pattern's own come after them."""
        problem, patterns = self.setup.problem, self.setup.dataset.patterns
        return sum(problem.blocks[i].dimension for i in problem.shared if problem.blocks[i].name not in patterns)

    def units(self, length: float) -> Array:
        """(S,): what each parameter is measured in so that all compare: lengths in ``length`` (m), angles in rad."""
        return self.setup.problem.units(length)


def information(system: System, placement: Placement) -> Information:
    """What the poses of a placement tell.

    Raises:
        UndeterminedError: no poses can calibrate the system, or these show too little (see
            `calibration.estimation.build.build`).
        InputError: a sensor detects no pattern at any of the poses.
    """
    setup = build(expected_dataset(system, placement))
    poses = np.array([int(key) for key in setup.dataset.keys])
    each = informations(setup.problem, _truth(system, setup, placement, poses), expected_noise(system))
    return Information(setup, poses, each)


def expected_noise(system: System) -> Weighting:
    """The standard deviations that the labels of a system's sensors will have."""
    distance = float(np.mean(system.motion.distance or _USUAL_DISTANCE))
    scales: dict[NoiseKind, float] = {}
    for sensor in system.sensors.values():
        for kind, level in sensor.noise_levels(distance).items():
            scales[kind] = max(level, scales.get(kind, 0.0))
    return Weighting(scales, None)


def _truth(system: System, setup: Setup, placement: Placement, poses: IntArray) -> Values:
    """The true value of every block; patterns at the centre of their corners, as the engine has them."""
    joints = {joint.edge: joint.values for joint in setup.dataset.joints.values()}
    patterns = {setup.pattern_edge(name): pattern for name, pattern in setup.dataset.patterns.items()}
    world, tree = system.configuration.world_link, system.robot.tree
    values = []
    for block in setup.problem.blocks:
        if (edge := block.edge) is None:  # a camera's intrinsics
            raise ValueError("the intrinsics are no unknowns of a motion")
        if edge in patterns:
            pattern = patterns[edge]
            T_world_parent = compose(tree, placement.transforms, world, pattern.parent_link)
            T = inverse(T_world_parent) @ placement.patterns[pattern.name] @ translation(pattern.centre)
            values.append(T[poses] if block.per_collection else T[0])
        elif edge in joints:
            values.append(joints[edge])
        else:
            T = placement.transforms[edge]
            values.append(T[poses] if block.per_collection else T[0])
    return tuple(values)


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
