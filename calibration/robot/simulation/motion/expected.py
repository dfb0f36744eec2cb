"""Expected dataset of a motion without noise: every sensor's exact labels at every pose."""

from pathlib import Path

from calibration.engine.dataset.configuration import SensorConfiguration
from calibration.engine.dataset.model import Collection, Dataset, Joint, Labels, Sensor
from calibration.engine.geometry.joints import JOINT_PARAMETERS
from calibration.robot.simulation.joints import joint_model, joint_values
from calibration.robot.simulation.placement import Placement, views
from calibration.robot.simulation.system import System


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
        model=joint_model(nominal),
        parameters=tuple(parameter for parameter in JOINT_PARAMETERS if parameter in asked),
        values=joint_values(nominal, system.joint_errors.get(name)),
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
