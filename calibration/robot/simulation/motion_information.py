"""Fisher information of each pose of a motion on the calibrated transforms, as in the engine.

The engine's own terms are linearised at the truth, for the expected labels: every sensor's exact labels at every pose,
without noise. So the prediction here equals the report of
`calibration.engine.estimation.least_squares.observability` on the collected dataset.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.configuration import SensorConfiguration
from calibration.engine.dataset.modalities import NoiseKind
from calibration.engine.dataset.model import Collection, Dataset, Joint, Labels, Sensor
from calibration.engine.estimation.least_squares.normal_equations import Weighting
from calibration.engine.estimation.least_squares.observability import MIN_RELATIVE_INFORMATION, informations
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.start.build import Setup, build
from calibration.engine.geometry.frames import JOINT_PARAMETERS
from calibration.engine.geometry.transforms import inverse, translation
from calibration.robot.simulation.kinematics import Placement, place, views
from calibration.robot.simulation.motion import Motion
from calibration.robot.simulation.system import System
from calibration.robot.urdf import compose


def expected_dataset(system: System, placement: Placement) -> Dataset:
    """Return the exact labels of all views that a detector would find, one collection for each of N poses.

    The transforms and joints are the true ones. The collections' keys are the indices of the poses, from "0".
    """
    config = system.configuration
    poses = next(iter(placement.transforms.values()))
    labels: list[dict[tuple[str, str], Labels]] = [{} for _ in poses]
    for pattern in system.patterns:
        for sensor, simulated in system.sensors.items():
            for number, label in simulated.expected_labels(views(system, placement, sensor, pattern)).items():
                labels[number][pattern, sensor] = label
    return Dataset(
        path=Path(system.name),
        version="3.0",
        world=config.world_link,
        sensors={name: _expected_sensor(system, sensor) for name, sensor in config.sensors.items()},
        patterns=system.patterns,
        anchored=config.anchored_sensor,
        additional_transforms=tuple(config.additional_tfs.values()),
        collections=tuple(Collection(str(number), found) for number, found in enumerate(labels)),
        transforms=placement.transforms,
        document={},
        moving_transforms=system.unknown_motions,
        joints={name: _expected_joint(system, name, placement) for name in config.joints},
    )


def _expected_joint(system: System, name: str, placement: Placement) -> Joint:
    nominal, asked = system.nominal.movable[name], system.configuration.joints[name]
    return Joint(
        name=name,
        edge=nominal.edge,
        model=nominal.model,
        parameters=tuple(parameter for parameter in JOINT_PARAMETERS if parameter in asked),
        values=nominal.values(system.joint_errors.get(name)),
        positions=placement.joints[name],
    )


def _expected_sensor(system: System, sensor: SensorConfiguration) -> Sensor:
    simulated = system.sensors[sensor.name]
    return Sensor(
        name=sensor.name,
        modality=simulated.modality,
        frame=sensor.link,
        calibration_parent=sensor.parent_link,
        calibration_child=sensor.child_link,
        camera=simulated.intrinsics,
    )


_USUAL_DISTANCE = 2.0  # m, to the pattern: the noise of a depth grows with it


@dataclass(frozen=True, eq=False)
class Information:
    """Information of each of N poses on S parameters that all poses share."""

    setup: Setup
    """Problem of the calibration."""
    poses: IntArray
    """(N,): the poses of the motion with any information."""
    each: Array
    """(N, S, S): the information matrices on the parameters of `Problem.shared` (twists, translation in m and
    rotation in rad, each in its child frame; or what is free of a joint), what each pose has its own of eliminated.
    They add up."""

    @property
    def calibrated(self) -> int:
        """Number of the S parameters that are calibrated; those of a fixed pattern come after them."""
        problem, patterns = self.setup.problem, self.setup.dataset.patterns
        return sum(problem.blocks[i].dimension for i in problem.shared if problem.blocks[i].name not in patterns)

    def units(self, length: float) -> Array:
        """Units (S,) that make the parameters comparable: lengths in ``length`` (m), angles in rad."""
        return self.setup.problem.units(length)


def information(system: System, placement: Placement) -> Information:
    """Compute the information of the poses of a placement.

    Raises:
        UndeterminedError: no poses can calibrate the system, or they have too few views (see
            `calibration.engine.estimation.start.build.build`).
        InputError: a sensor detects no pattern at any of the poses.
    """
    setup = build(expected_dataset(system, placement))
    poses = np.array([int(key) for key in setup.dataset.keys])
    each = informations(setup.problem, true_values(system, setup, placement, poses), expected_noise(system))
    return Information(setup, poses, each)


def expected_noise(system: System) -> Weighting:
    """Return the expected standard deviations of the labels of a system's sensors."""
    distance = float(np.mean(system.motion.distance or _USUAL_DISTANCE))
    scales: dict[NoiseKind, float] = {}
    for sensor in system.sensors.values():
        for kind, level in sensor.noise_levels(distance).items():
            scales[kind] = max(level, scales.get(kind, 0.0))
    return Weighting(scales, None)


def true_values(system: System, setup: Setup, placement: Placement, poses: IntArray) -> Values:
    """Return the true value of every block; patterns at the centre of their corners, as in the engine."""
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


_PART = 1e-6  # component of a direction of length 1: smaller ones are rounding errors


def predicted_sigmas(system: System, motion: Motion) -> Mapping[str, tuple[float, float]]:
    """Predict the standard deviations of a calibration of this motion's dataset.

    With the labels that are expected of the sensors, with the noise that they are given there;
    outliers, errors of the model and poses that a detector loses are left out.

    Returns:
        By sensor, translation (m) and rotation (rad) of its calibrated transform, each the norm of
        three axes as in `calibration.engine.estimation.covariance.result.Calibration.sigma_mm`. Zero for a sensor that
        is anchored or fixes a free gauge; infinite for what the motion does not determine.

    Raises:
        InputError: the motion does not fit the system (see `calibration.robot.simulation.kinematics.place`).
    """
    sensors = list(system.configuration.sensors.values())
    placement = place(system, motion)
    try:
        found = information(system, placement)
    except InputError:  # poses that determine nothing
        return {sensor.name: (np.inf, np.inf) for sensor in sensors}
    sigmas = _pose_standard_deviations(found, system)
    setup, held = found.setup, (0.0, 0.0)
    blocks = {sensor.name: setup.block((sensor.parent_link, sensor.child_link)) for sensor in sensors}
    return {name: sigmas.get(block, held) for name, block in blocks.items()}


def _pose_standard_deviations(found: Information, system: System) -> dict[int, tuple[float, float]]:
    """Return the translation (m) and rotation (rad) standard deviations of each shared block that is a pose."""
    problem = found.setup.problem
    unit = found.units(max(pattern.size for pattern in system.patterns.values()))
    variance = _parameter_variances(unit[:, None] * found.each.sum(0) * unit) * unit**2
    sigmas = {}
    for block, at in problem.shared_parameters.items():
        if problem.blocks[block].joint is None:
            translation, rotation = np.sqrt(variance[at].reshape(2, 3).sum(-1)).tolist()
            sigmas[block] = (translation, rotation)
    return sigmas


def _parameter_variances(information: Array) -> Array:
    """Return the variance (D,) of each parameter from the information (D, D); infinite if it is not determined."""
    values, directions = np.linalg.eigh(information)
    open_ = values <= MIN_RELATIVE_INFORMATION * values[-1]
    variance: Array = (directions[:, ~open_] ** 2 / values[~open_]).sum(-1)
    return np.where((np.abs(directions[:, open_]) > _PART).any(-1), np.inf, variance)
