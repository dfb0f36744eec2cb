"""Simulated system: the robot, the calibration's configuration, the sensors, and the scene.

A system is a folder with

- ``robot.urdf``, or ``robot.urdf.xacro``, which is expanded: the robot, and the patterns that are fixed to it or to
  the world;
- ``config.yml``: ATOM's calibration configuration;
- ``simulation.yml``: everything else (`Simulation`). Lengths are metres, angles radians unless the key
  says otherwise.
"""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from calibration.base import InputError, read_bytes, read_yaml
from calibration.base.arrays import Array
from calibration.base.records import Converted, Place, between, field, read, read_as, record, unknown_key
from calibration.engine.dataset.configuration import Configuration, SensorConfiguration, read_configuration
from calibration.engine.dataset.model import Edge
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.geometry.frames import JOINT_PARAMETERS
from calibration.robot.robot_description import ENDING, NO_INPUTS, XacroInputs, read_robot_description
from calibration.robot.simulation.scene import MAX_BYTES, Board, Pose, Scene, degrees, listed, rising
from calibration.robot.simulation.sensors import (
    SIMULATED_SENSORS,
    SimulatedCamera,
    SimulatedDepthCamera,
    SimulatedLidar,
    SimulatedLidar2d,
    SimulatedSensor,
)
from calibration.robot.urdf import ROBOT_FILE, JointErrors, Robot, check_calibrated_joints, parse_robot, with_errors

CONFIGURATION_FILE = "config.yml"
SIMULATION_FILE = "simulation.yml"
MOTION_FILE = "motion.json"
MAX_BOW_MM = 100
"""Limit of a pattern's bow."""
_TWO_BOWS = listed(2, f"two numbers from -{MAX_BOW_MM} to {MAX_BOW_MM}", lambda bow: max(map(abs, bow)) <= MAX_BOW_MM)


@record(case="snake", nulls=True)
class MotionRanges:
    """Limits of a generated motion."""

    distance: Annotated[tuple[float, float], rising(0.01, 1000)] | None = field(
        "Least and largest distance between the camera and the pattern's centre, m; where it is absent, what fills "
        "the image well.",
        default=None,
        key="distance_m",
    )
    tilt: Annotated[float, degrees(0, 70)] = field(
        "Largest angle between the pattern's normal and the line of sight, deg.",
        default=math.radians(45),
        implied=45,
        key="tilt_deg",
    )
    roll: Annotated[float, degrees(0, 180)] = field(
        "Largest turn about the line of sight from upright, deg.",
        default=math.radians(30),
        implied=30,
        key="roll_deg",
    )
    partial: Annotated[float, between(0, 1)] = field(
        "Share of camera views that see only a part of the pattern.", default=1 / 3
    )


@record(case="snake", nulls=True)
class MovedPattern:
    """Motion of the pattern: its pose on the model that a motion sequence moves, and ranges of generated motions."""

    ranges: MotionRanges = field(flat=True, default_factory=MotionRanges)
    pattern_in_model: Pose = field("Pose of the pattern on the model that is moved.", default_factory=Pose)
    sway: Annotated[float, Converted(Annotated[float, between(0, 1000)], lambda sway, _: sway / 1000)] = field(
        "Standard deviation of the pattern's place, each axis, between what two sensors see of it, mm.",
        default=0.0,
        key="sway_mm",
    )


@record(case="snake", nulls=True)
class PrintedPattern:
    """Deviation of a pattern from a flat one of the default layout."""

    bow: Annotated[
        tuple[float, float],
        Converted(Annotated[tuple[float, float], _TWO_BOWS], lambda bow, _: (bow[0] / 1000, bow[1] / 1000)),
    ] = field("Height of the centre of a bowed pattern, along x and along y, mm.", implied=[0, 0], key="bow_mm")
    legacy_layout: bool = field("Whether a charuco pattern has OpenCV's layout of before 4.6.", default=False)


_Sensors = Converted(
    Mapping[str, dict],  # type: ignore[type-arg]
    lambda sensors, _: sensors,
    described_as=Mapping[str, SimulatedCamera | SimulatedLidar | SimulatedLidar2d | SimulatedDepthCamera],
)


@record(case="snake", nulls=True)
class Simulation:
    """Content of simulation.yml: sensors, patterns, joints, scene."""

    sensors: Annotated[Mapping[str, Any], _Sensors] = field(
        "Sensors by the names that they have in config.yml, which says the modality of each."
    )
    patterns: Mapping[str, PrintedPattern] = field(
        "Patterns that are bent or laid out otherwise.", default_factory=dict
    )
    joints: JointErrors = field(
        "By how much the true robot's joints differ from robot.urdf: by joint and parameter, m or rad.",
        default_factory=dict,
    )
    scene: Scene = field("What stands around.", default_factory=Scene)
    motion: MovedPattern = field("Motion of the pattern.", default_factory=MovedPattern)
    xacro: XacroInputs = field(flat=True, default_factory=XacroInputs)


@dataclass(frozen=True, eq=False)
class System:
    """System with everything that a collection needs, except for the motion."""

    name: str
    """Name of the system's folder."""
    configuration: Configuration
    robot: Robot
    """True robot."""
    nominal: Robot
    """Robot as designed: the transforms of a dataset before its calibration."""
    patterns: Mapping[str, Pattern]
    sensors: Mapping[str, SimulatedSensor]
    """Sensors by name, in the order of the configuration."""
    scene: Scene
    T_model_pattern: Array
    """(4, 4): pose of the moved pattern on the model that a motion sequence moves."""
    motion: MotionRanges
    sources: Mapping[str, bytes]
    """Files of the description, by their names in a system's folder."""
    bows: Mapping[str, tuple[float, float]]
    """Height of the centre of a bowed pattern, along x and along y, m (`Board.bow`); others are flat."""
    legacy_layouts: frozenset[str]
    """Charuco patterns with OpenCV's layout of before 4.6."""
    sway: float
    """Standard deviation of a moved pattern's position, each axis, between the measurements of two sensors, m."""
    joint_errors: JointErrors
    """Errors of the joints of `robot` relative to those of `nominal`."""

    @property
    def cameras(self) -> dict[str, SimulatedCamera]:
        """The cameras, whose images are searched for patterns without an expected pose."""
        return {name: sensor for name, sensor in self.sensors.items() if isinstance(sensor, SimulatedCamera)}

    @property
    def by_modality(self) -> list[tuple[str, SimulatedSensor]]:
        """The sensors with their names, in the order of `SIMULATED_SENSORS`: the order of labels in datasets."""
        order = list(SIMULATED_SENSORS)
        return sorted(self.sensors.items(), key=lambda item: order.index(item[1].modality.name))

    def boards(self, T_world_pattern: Mapping[str, Array]) -> list[Board]:
        """Return the patterns at poses (4, 4) in the world, in the order of the configuration."""
        return [
            Board(
                self.configuration.patterns[name],
                pattern,
                T_world_pattern[name],
                self.bows.get(name, (0.0, 0.0)),
                name in self.legacy_layouts,
            )
            for name, pattern in self.patterns.items()
        ]

    @property
    def unknown_motions(self) -> frozenset[Edge]:
        """Additional transforms that differ between collections: those of moving joints, such as of a mobile base."""
        additional = set(self.configuration.additional_tfs.values())
        return frozenset(joint.edge for joint in self.robot.joints if joint.is_movable and joint.edge in additional)

    @property
    def moved_pattern(self) -> Pattern | None:
        """The pattern that a motion sequence moves; None if all are fixed."""
        return next((pattern for pattern in self.patterns.values() if not pattern.fixed), None)


def read_system(folder: Path, robot: Path | None = None, configuration: Path | None = None) -> System:
    """Read a system from its folder, with another robot or another configuration if they are given.

    Raises:
        InputError: a file is missing or wrong, or the three are inconsistent.
        InfrastructureError: the robot is a xacro, and xacrodoc is not installed.
    """
    robot_path, configuration_path = robot or _robot_file(folder), configuration or folder / CONFIGURATION_FILE
    simulation_path = folder / SIMULATION_FILE
    place = Place(str(simulation_path), folder=folder)
    document = read_yaml(simulation_path, "the description of a simulation")
    simulation = read(Simulation, document, place.where, place.folder)
    inputs = simulation.xacro if robot_path.name.endswith(ENDING) else NO_INPUTS  # a URDF may be kept of a xacro
    sources = {ROBOT_FILE: read_robot_description(robot_path, inputs)} | {
        name: read_bytes(path, MAX_BYTES, "a file of the system")
        for name, path in (
            (CONFIGURATION_FILE, configuration_path),
            (SIMULATION_FILE, simulation_path),
        )
    }
    config, urdf = read_configuration(configuration_path), parse_robot(sources[ROBOT_FILE], robot_path)
    for key, known in (("sensors", config.sensors), ("patterns", config.patterns), ("joints", urdf.movable)):
        _check_names(getattr(simulation, key), known, place.below(key))
    system = System(
        name=folder.resolve().name,
        configuration=config,
        robot=with_errors(urdf, simulation.joints),
        nominal=urdf,
        patterns={name: pattern.pattern() for name, pattern in config.patterns.items()},
        sensors={
            name: _simulated_sensor(simulation.sensors, sensor, place.below("sensors"), configuration_path)
            for name, sensor in config.sensors.items()
        },
        scene=simulation.scene,
        T_model_pattern=simulation.motion.pattern_in_model.transform,
        motion=simulation.motion.ranges,
        sources=sources,
        bows={name: printed.bow for name, printed in simulation.patterns.items()},
        legacy_layouts=frozenset(name for name, printed in simulation.patterns.items() if printed.legacy_layout),
        sway=simulation.motion.sway,
        joint_errors={
            name: {parameter: own[parameter] for parameter in JOINT_PARAMETERS if own.get(parameter)}
            for name, own in simulation.joints.items()
        },
    )
    _check_against_robot(system, configuration_path)
    return system


def _robot_file(folder: Path) -> Path:
    xacro = folder / f"{ROBOT_FILE}{ENDING}"
    return xacro if xacro.is_file() and not (folder / ROBOT_FILE).exists() else folder / ROBOT_FILE


def _check_names(found: Collection[str], known: Collection[str], place: Place) -> None:
    for name in found:
        if name not in known:
            raise place.fault(unknown_key(name, known))


def _simulated_sensor(
    sensors: Mapping[str, Any], sensor: SensorConfiguration, place: Place, configuration: Path
) -> SimulatedSensor:
    if sensor.name not in sensors:
        raise place.fault(f"missing key '{sensor.name}'")
    if sensor.modality not in SIMULATED_SENSORS:
        *others, last = (f"'{name}'" for name in SIMULATED_SENSORS)
        where = f"{configuration}: sensors/{sensor.name}/modality"
        raise InputError(f"{where}: found '{sensor.modality}', expected {', '.join(others)} or {last}")
    found: SimulatedSensor = read_as(SIMULATED_SENSORS[sensor.modality], sensors[sensor.name], place.below(sensor.name))
    return found


def _check_against_robot(system: System, path: Path) -> None:
    """Check the configuration against the robot."""
    config, tree = system.configuration, system.robot.tree

    def fault(key: str, message: str) -> InputError:
        return InputError(f"{path}: {key}: {message}")

    def check_frame(key: str, frame: str) -> None:
        if frame not in tree:
            raise fault(key, f"frame '{frame}' is not in {system.robot.path}")

    check_frame("world_link", config.world_link)
    edges = system.robot.by_edge

    def check_known(key: str, frame: str) -> None:
        """Refuse a frame whose pose in the world depends on a joint without a position."""
        for step in tree.path(config.world_link, frame):
            if (joint := edges[step.parent, step.child]).without_position:
                raise fault(
                    key,
                    f"joint '{joint.name}', which {joint.without_position}, lies between '{config.world_link}' and "
                    f"'{frame}' in {system.robot.path}, and a simulation has no pose for it: expected other joints",
                )

    for name, sensor in config.sensors.items():
        key = f"sensors/{name}"
        if not name or len(name) > 100 or name.startswith(".") or not all(c.isalnum() or c in "_.-" for c in name):
            raise fault(key, "a sensor's name is part of file names: expected letters, digits and _ . - only")
        check_frame(f"{key}/link", sensor.link)
        check_known(f"{key}/link", sensor.link)
        chain = {(step.parent, step.child) for step in tree.path(config.world_link, sensor.link)}
        if (sensor.parent_link, sensor.child_link) not in chain:
            raise fault(
                key,
                f"no joint from '{sensor.parent_link}' to '{sensor.child_link}' lies between "
                f"'{config.world_link}' and '{sensor.link}' in {system.robot.path}",
            )
    for name, edge in config.additional_tfs.items():
        if edge not in edges:
            raise fault(f"additional_tfs/{name}", f"no joint from '{edge[0]}' to '{edge[1]}' in {system.robot.path}")
    check_calibrated_joints(config.joints, system.robot, f"{path}: joints")
    whole = {*config.additional_tfs.values(), *((s.parent_link, s.child_link) for s in config.sensors.values())}
    for name in config.joints:
        edge = system.robot.movable[name].edge
        if edge in whole:
            raise fault(f"joints/{name}", f"the whole transform from '{edge[0]}' to '{edge[1]}' is calibrated already")
    for name, pattern in system.patterns.items():
        key = f"calibration_patterns/{name}"
        check_frame(f"{key}/parent_link", pattern.parent_link)
        check_known(f"{key}/parent_link", pattern.parent_link)
        if pattern.fixed:
            check_frame(f"{key}/link", pattern.link)
            if (pattern.parent_link, pattern.link) not in edges:
                raise fault(key, f"no joint from '{pattern.parent_link}' to '{pattern.link}' in {system.robot.path}")
        elif pattern.link in tree:
            raise fault(f"{key}/fixed", f"found false, but {system.robot.path} fixes '{pattern.link}' with a joint")
    moved = [name for name, pattern in system.patterns.items() if not pattern.fixed]
    if len(moved) > 1:
        raise fault("calibration_patterns", f"{' and '.join(moved)} all move; a motion sequence moves one pattern")
