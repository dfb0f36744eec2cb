"""A simulated system: the robot, what is calibrated, its sensors, and the world around it.

A system is a folder with

- ``robot.urdf``: the robot, and the patterns that are fixed to it or to the world;
- ``config.yml``: ATOM's calibration configuration;
- ``simulation.yml``: what the two do not say. Under ``sensors``, one entry for each of the
  configuration's (`calibration.simulation.sensors`); under ``patterns``, how a pattern differs from a
  flat one of the usual layout (``bow_mm``, ``legacy_layout``); under ``joints``, by how much the true robot
  differs from its description (`calibration.simulation.joints`); under ``scene``, ``ground_m`` and
  ``boxes`` of ``centre``, ``size``, ``rpy``; under ``motion``, ``pattern_in_model`` (``xyz`` and
  ``rpy`` of the moved pattern on the model that a motion sequence moves), ``sway_mm`` and what a
  generated motion keeps to (`MotionRanges`). Lengths are metres, angles radians unless the key says
  otherwise.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from calibration.dataset.configuration import Configuration, SensorConfiguration, read_configuration
from calibration.dataset.document import Node
from calibration.dataset.model import Edge
from calibration.dataset.pattern import Pattern
from calibration.errors import InputError
from calibration.files import read_bytes
from calibration.geometry.transforms import from_xyz_rpy
from calibration.geometry.types import Array
from calibration.simulation.board import Board
from calibration.simulation.description import MAX_BYTES, interval, number, numbers, only
from calibration.simulation.joints import JointErrors, check_calibrated_joints, read_joint_errors, with_errors
from calibration.simulation.robot import Robot, read_robot
from calibration.simulation.scene import Scene, read_scene
from calibration.simulation.sensors import KINDS, SimulatedCamera, SimulatedSensor
from calibration.yaml_file import read_yaml

ROBOT_FILE = "robot.urdf"
CONFIGURATION_FILE = "config.yml"
SIMULATION_FILE = "simulation.yml"
MOTION_FILE = "motion.json"
MAX_BOW_MM = 100
"""A pattern that is bent more is none."""


@dataclass(frozen=True)
class MotionRanges:
    """What a generated motion keeps to."""

    distance: tuple[float, float] | None = None
    """Between the camera and the pattern's centre, m; None for what fills the image well."""
    tilt: float = math.radians(45)
    """The largest angle between the pattern's normal and the line of sight, rad."""
    roll: float = math.radians(30)
    """The largest turn about the line of sight from upright, rad."""
    partial: float = 1 / 3
    """The share of camera views that see only a part of the pattern."""


@dataclass(frozen=True, eq=False)
class System:
    """Everything that a collection needs but the motion."""

    name: str
    """The name of the system's folder."""
    configuration: Configuration
    robot: Robot
    """As it is."""
    nominal: Robot
    """As it was designed: what a dataset says of it before it is calibrated."""
    patterns: Mapping[str, Pattern]
    sensors: Mapping[str, SimulatedSensor]
    """In the order of the configuration."""
    scene: Scene
    T_model_pattern: Array
    """(4, 4): the moved pattern on the model that a motion sequence moves."""
    motion: MotionRanges
    sources: Mapping[str, bytes]
    """The files that describe it, by the names that they have in a system's folder."""
    bows: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """How far the middle of a pattern stands out, along x and along y, m (`Board.bow`); others are flat."""
    legacy_layouts: frozenset[str] = frozenset()
    """The charuco patterns that are laid out as OpenCV did before 4.6."""
    sway: float = 0.0
    """The standard deviation of a moved pattern's place, each axis, between what two sensors see of it, m."""
    joint_errors: JointErrors = field(default_factory=dict)
    """By how much the joints of `robot` differ from those of `nominal`."""

    @property
    def cameras(self) -> dict[str, SimulatedCamera]:
        """The sensors in whose images patterns are found without being told where they are."""
        return {name: sensor for name, sensor in self.sensors.items() if isinstance(sensor, SimulatedCamera)}

    @property
    def by_modality(self) -> list[tuple[str, SimulatedSensor]]:
        """The sensors with their names, in the order of `KINDS`: the order in which datasets write labels."""
        order = list(KINDS)
        return sorted(self.sensors.items(), key=lambda item: order.index(item[1].modality.name))

    def boards(self, T_world_pattern: Mapping[str, Array]) -> list[Board]:
        """The patterns at poses (4, 4) in the world, in the order of the configuration."""
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
        """The additional transforms that each collection has its own of: those of joints that move, as a base does."""
        additional = set(self.configuration.additional_tfs.values())
        return frozenset(joint.edge for joint in self.robot.movable.values() if joint.edge in additional)

    @property
    def moved_pattern(self) -> Pattern | None:
        """The pattern that a motion sequence moves; None where all are fixed."""
        return next((pattern for pattern in self.patterns.values() if not pattern.fixed), None)


def read_system(folder: Path, robot: Path | None = None, configuration: Path | None = None) -> System:
    """Read a system from its folder, with another robot or another configuration if they are given.

    Raises:
        InputError: a file is missing or wrong, or the three do not fit together.
    """
    robot_path, configuration_path = robot or folder / ROBOT_FILE, configuration or folder / CONFIGURATION_FILE
    simulation_path = folder / SIMULATION_FILE
    sources = {
        name: read_bytes(path, MAX_BYTES, "a file of the system")
        for name, path in (
            (ROBOT_FILE, robot_path),
            (CONFIGURATION_FILE, configuration_path),
            (SIMULATION_FILE, simulation_path),
        )
    }
    config = read_configuration(configuration_path)
    simulation = Node(simulation_path, (), read_yaml(simulation_path, "the description of a simulation"))
    only(simulation, "sensors", "patterns", "joints", "scene", "motion")
    only(simulation["sensors"], *config.sensors)
    urdf, empty = read_robot(robot_path), _empty(simulation)
    joint_errors = read_joint_errors(simulation.get("joints"), urdf)
    scene, motion, printed = (simulation.get(key) or empty for key in ("scene", "motion", "patterns"))
    only(printed, *config.patterns)
    only(motion, "pattern_in_model", "sway_mm", "distance_m", "tilt_deg", "roll_deg", "partial")
    for pattern in printed.mapping():
        only(printed[pattern], "bow_mm", "legacy_layout")
    system = System(
        name=folder.resolve().name,
        configuration=config,
        robot=with_errors(urdf, joint_errors),
        nominal=urdf,
        patterns={name: pattern.pattern() for name, pattern in config.patterns.items()},
        sensors={
            name: _sensor(simulation["sensors"][name], sensor, configuration_path)
            for name, sensor in config.sensors.items()
        },
        scene=read_scene(scene),
        T_model_pattern=_model_to_pattern(motion),
        motion=_motion(motion),
        sources=sources,
        bows={name: _bow(entry) for name, entry in printed.items()},
        legacy_layouts=frozenset(name for name, entry in printed.items() if _has_legacy_layout(entry)),
        sway=number(motion, "sway_mm", 0.0, least=0, most=1000) / 1000,
        joint_errors=joint_errors,
    )
    _check(system, configuration_path)
    return system


def _empty(node: Node) -> Node:
    return Node(node.file, (), {})


def _sensor(node: Node, sensor: SensorConfiguration, configuration: Path) -> SimulatedSensor:
    if sensor.modality not in KINDS:
        *others, last = (f"'{name}'" for name in KINDS)
        where = f"{configuration}: sensors/{sensor.name}/modality"
        raise InputError(f"{where}: found '{sensor.modality}', expected {', '.join(others)} or {last}")
    return KINDS[sensor.modality].read(node)


def _bow(node: Node) -> tuple[float, float]:
    along_x, along_y = numbers(node, "bow_mm", 2, (0.0, 0.0))
    if max(abs(along_x), abs(along_y)) > MAX_BOW_MM:
        raise node["bow_mm"].unexpected(f"two numbers from -{MAX_BOW_MM} to {MAX_BOW_MM}")
    return along_x / 1000, along_y / 1000


def _has_legacy_layout(node: Node) -> bool:
    value = node.get("legacy_layout")
    return value is not None and value.flag()


def _model_to_pattern(node: Node) -> Array:
    pose = node.get("pattern_in_model")
    if pose is None:
        return np.eye(4)
    only(pose, "xyz", "rpy")
    return from_xyz_rpy(numbers(pose, "xyz", 3, (0.0, 0.0, 0.0)), numbers(pose, "rpy", 3, (0.0, 0.0, 0.0)))


def _motion(node: Node) -> MotionRanges:
    ranges = MotionRanges()
    return MotionRanges(
        distance=interval(node, "distance_m", least=0.01, most=1000) if node.get("distance_m") else None,
        tilt=math.radians(number(node, "tilt_deg", math.degrees(ranges.tilt), least=0, most=70)),
        roll=math.radians(number(node, "roll_deg", math.degrees(ranges.roll), least=0, most=180)),
        partial=number(node, "partial", ranges.partial, least=0, most=1),
    )


def _check(system: System, path: Path) -> None:
    """Check what the configuration says against the robot."""
    config, tree = system.configuration, system.robot.tree

    def fault(key: str, message: str) -> InputError:
        return InputError(f"{path}: {key}: {message}")

    def check_frame(key: str, frame: str) -> None:
        if frame not in tree:
            raise fault(key, f"frame '{frame}' is not in {system.robot.path}")

    check_frame("world_link", config.world_link)
    edges = {joint.edge for joint in system.robot.joints}
    for name, sensor in config.sensors.items():
        key = f"sensors/{name}"
        if not name or len(name) > 100 or name.startswith(".") or not all(c.isalnum() or c in "_.-" for c in name):
            raise fault(key, "a sensor's name is part of file names: expected letters, digits and _ . - only")
        check_frame(f"{key}/link", sensor.link)
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
        if pattern.fixed:
            check_frame(f"{key}/link", pattern.link)
            if (pattern.parent_link, pattern.link) not in edges:
                raise fault(key, f"no joint from '{pattern.parent_link}' to '{pattern.link}' in {system.robot.path}")
        elif pattern.link in tree:
            raise fault(f"{key}/fixed", f"found false, but {system.robot.path} fixes '{pattern.link}' with a joint")
    moved = [name for name, pattern in system.patterns.items() if not pattern.fixed]
    if len(moved) > 1:
        raise fault("calibration_patterns", f"{' and '.join(moved)} all move; a motion sequence moves one pattern")
