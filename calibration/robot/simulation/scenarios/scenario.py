"""Scenario: a variation of a described system, its reproducible id, its result, and its system.

The system of a scenario is the described one, changed by the values of the parameters.
"""

import hashlib
import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from calibration import __version__
from calibration.base import InputError, one_line, shorten
from calibration.base.arrays import Array
from calibration.base.records import Converted, Place, between, field, length, matching, record
from calibration.engine.geometry import rotations
from calibration.engine.geometry.frames import JOINT_PARAMETERS, JointParameter
from calibration.engine.geometry.transforms import apply, from_xyz_rpy, inverse, transform
from calibration.robot.simulation.kinematics import stream
from calibration.robot.simulation.motion import Motion, motion_document
from calibration.robot.simulation.motion_generation import filling_distances, generate_motion
from calibration.robot.simulation.scene import Box, Scene
from calibration.robot.simulation.system import MotionRanges, System
from calibration.robot.urdf import Joint, Robot, compose, with_errors

MAX_SEED = 2**53
"""Limit of a seed, so that it is exact in JSON."""
_SCENARIO_ID = re.compile(r"s(0|[1-9][0-9]{0,15})-([0-9]{5,8})")
_HASH_DIGITS = 12
_LONGEST_LINE = 1000


@dataclass(frozen=True)
class Scenario:
    """Parameters of a scenario, drawn from its seed and index alone."""

    seed: int
    index: int
    """Index, from 0."""
    values: Mapping[str, float]
    """Values by the parameter's name (`calibration.robot.simulation.scenarios.scenario_set`)."""
    attempt: int = 0
    """Number of previous draws that broke a constraint."""

    @property
    def id(self) -> str:
        """Id, such as "s1-00017": seed 1, index 17."""
        return scenario_id(self.seed, self.index)

    @property
    def collection_seed(self) -> int:
        """Seed of its sensor data and of a motion that is generated for it."""
        return int(self.random("collection").integers(MAX_SEED))

    def random(self, *purpose: str | int) -> np.random.Generator:
        """Return random numbers for one purpose in this scenario."""
        return stream(self.seed, "scenario", self.index, self.attempt, *purpose)


def scenario_id(seed: int, index: int) -> str:
    """Format the id of a scenario."""
    return f"s{seed}-{index:05d}"


def parse_id(text: str) -> tuple[int, int]:
    """Parse an id to the seed and the index.

    Raises:
        InputError: it is not an id.
    """
    match = _SCENARIO_ID.fullmatch(text)
    seed, index = (int(match[1]), int(match[2])) if match else (-1, -1)
    if not 0 <= seed < MAX_SEED or scenario_id(seed, index) != text:
        raise InputError(f"scenario: found '{text}', expected an id such as s1-00017 (seed 1, index 17)")
    return seed, index


def content_hash(system: System, scenario: Scenario, motion: Motion | None = None) -> str:
    """Return a hash that identifies a scenario: 12 hexadecimal digits of a SHA-256.

    It covers the scenario's id and values, the system's files, the motion if one is given, and the version
    of this package. Other content of a scenario set, such as its formatting, has no effect.
    """
    content = {
        "version": __version__,
        "system": {name: hashlib.sha256(data).hexdigest() for name, data in system.sources.items()},
        "motion": None if motion is None else motion_document(motion),
        "scenario": scenario.id,
        "attempt": scenario.attempt,
        "values": dict(scenario.values),
    }
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:_HASH_DIGITS]


Amount = Annotated[float, between(0, 1e300)]


def _as_short_lines(lines: tuple[str, ...], _: Place) -> tuple[str, ...]:
    return tuple(shorten(one_line(line), _LONGEST_LINE) for line in lines)


Lines = Annotated[
    tuple[str, ...],
    Converted(Annotated[tuple[Annotated[str, length(most=10_000)], ...], length(most=1000)], _as_short_lines),
]
"""Texts from untrusted sources, made safe to print."""


def _as_lost_poses(lost: Mapping[str, tuple[str, ...]], _: Place) -> Mapping[str, tuple[str, ...]]:
    return {one_line(pose): reasons for pose, reasons in lost.items()}


@record(case="snake", nulls=True)
class ScenarioResult:
    """Result of one scenario. Numbers are None if not available."""

    id: Annotated[str, matching("s(0|[1-9][0-9]{0,15})-[0-9]{5,8}", "an id such as s1-00017")] = field(
        "Its seed and index: s1-00017."
    )
    hash: Annotated[str, matching("[0-9a-f]{12}", "12 hexadecimal digits")] = field(
        "Of its content: equal scenarios have equal hashes."
    )
    values: Mapping[str, float] = field("Its parameters.")
    poses: Annotated[int, between(0, 100_000)] = field("Of its motion; 0 where none was found.", default=0)
    lost: (
        Annotated[
            Mapping[str, tuple[str, ...]],
            Converted(
                Annotated[Mapping[Annotated[str, length(most=100)], Lines], length(most=100_000)], _as_lost_poses
            ),
        ]
        | None
    ) = field("The poses that gave no collection, by key, and why.", default=None)
    detection: (
        Annotated[
            Mapping[Annotated[str, length(most=200)], Annotated[float, between(0, 1)]],
            length(most=1000),
        ]
        | None
    ) = field("The share of the poses at which each sensor detects a pattern.", default=None)
    corner_rms_px: Amount | None = field("Detected corners against the true ones.", default=None, unit="px")
    converged: bool = field("Whether there is a calibration.", default=False)
    rms_px: Amount | None = field("RMS of the reprojection errors.", default=None, unit="px")
    translation_mm: Amount | None = field(
        "The worst error of a calibrated sensor against the truth.", default=None, unit="mm"
    )
    rotation_deg: Amount | None = field("Likewise.", default=None, unit="degrees")
    joint_mm: Amount | None = field(
        "The worst error of a calibrated joint against the truth, of those that are lengths.", default=None, unit="mm"
    )
    joint_deg: Amount | None = field(
        "Largest error of the joints' parameters that are angles.", default=None, unit="degrees"
    )
    sigma_mm: Amount | None = field(
        "The standard deviation that the calibration states, of the sensor of which it is least sure.",
        default=None,
        unit="mm",
    )
    sigma_deg: Amount | None = field("Likewise.", default=None, unit="degrees")
    error_sigmas: Amount | None = field(
        "The worst error of a calibrated sensor in its stated standard deviations: the root mean square over six "
        "directions, 1 on average.",
        default=None,
    )
    chance: Annotated[float, between(0, 1)] | None = field("Probability that chance makes it as large.", default=None)
    reasons: Lines = field("Reason why there is no calibration; empty if there is one.", default=())

    @property
    def kept(self) -> int:
        """Number of poses that gave a collection."""
        return self.poses - len(self.lost or {})


DEFAULT_POSES = 12
"""Default number of poses of a generated motion, without ``motion/poses`` in the scenario set."""
_OCCLUDER_REACH = (0.35, 0.75)
"""Positions of occluders between a camera and the pattern's closest position, as fractions of the distance."""
_PLACE_DECIMALS = 6  # of an occluder's position: micrometres and microradians

Values = Mapping[str, float]


def build_world(system: System, scenario: Scenario) -> System:
    """Return the system of a scenario. Parts that the scenario does not vary are as described.

    Its ``robot`` has the errors of the assembly; ``nominal`` is unchanged.

    Raises:
        InputError: there are occluders, but no camera to occlude; a lens has no such coefficient.
    """
    values = scenario.values
    motion = _motion_ranges(system.motion, values)
    joint_errors = _joint_errors(system, values)
    same = joint_errors == system.joint_errors
    return replace(
        system,
        robot=_assembled_robot(system, system.robot if same else with_errors(system.nominal, joint_errors), values),
        joint_errors=joint_errors,
        sensors={name: sensor.with_values(name, _values_of(values, name)) for name, sensor in system.sensors.items()},
        scene=_scenario_scene(system, motion, scenario),
        motion=motion,
        bows={**system.bows, **_pattern_bows(system, values)},
        sway=values["motion.sway_mm"] / 1000 if "motion.sway_mm" in values else system.sway,
    )


def scenario_motion(world: System, scenario: Scenario) -> Motion:
    """Generate the motion of a scenario with its system.

    Raises:
        InputError: too few poses are seen by every sensor (see `generate_motion`).
    """
    return generate_motion(world, int(scenario.values.get("motion.poses", DEFAULT_POSES)), scenario.collection_seed)


def clearance(system: System) -> float:
    """Return the smallest distance from the origin of a sensor to a box, with the robot at rest, m.

    0 inside a box, infinite without boxes.
    """
    origins = np.stack([_rest_pose(system, name)[:3, 3] for name in system.sensors])
    distances = [
        np.linalg.norm(np.maximum(np.abs(apply(inverse(box.T_world_box), origins)) - box.size / 2, 0), axis=-1)
        for box in system.scene.boxes
    ]
    return float(np.min(distances, initial=math.inf))


def _values_of(values: Values, thing: str) -> dict[str, float]:
    """Return the values of a sensor, of a pattern, or of a part of the scene, by key."""
    prefix = f"{thing}."
    return {name.removeprefix(prefix): value for name, value in values.items() if name.startswith(prefix)}


def _rest_pose(system: System, sensor: str) -> Array:
    """Return ``T_world_sensor`` (4, 4) with the robot at rest."""
    configuration = system.configuration
    transforms = system.robot.transforms({})
    link = configuration.sensors[sensor].link
    return np.asarray(compose(system.robot.tree, transforms, configuration.world_link, link)[0])


def _joint_errors(system: System, values: Values) -> dict[str, dict[JointParameter, float]]:
    """Return the errors of the joints: the scenario's values, else those of the system."""
    errors = {name: dict(own) for name, own in system.joint_errors.items()}
    for name in system.configuration.joints:
        for parameter in JOINT_PARAMETERS:
            for key, value in _values_of(values, f"{name}.{parameter}").items():
                error = value / 1000 if key == "translation_mm" else math.radians(value)
                errors.setdefault(name, {})[parameter] = error
    return errors


def _assembled_robot(system: System, robot: Robot, values: Values) -> Robot:
    """Return a robot with errors of its assembly: calibrated transforms are moved by twists in their child frames."""
    errors = {}
    for name, sensor in system.configuration.sensors.items():
        own = _values_of(values, name)
        shift = np.array([own.get(f"translation_{axis}_mm", 0.0) for axis in "xyz"]) / 1000
        turn = np.radians([own.get(f"rotation_{axis}_deg", 0.0) for axis in "xyz"])
        if shift.any() or turn.any():
            errors[sensor.parent_link, sensor.child_link] = transform(rotations.exp(turn), shift)

    def moved(joint: Joint) -> Joint:
        error = errors.get(joint.edge)
        return joint if error is None else replace(joint, T_parent_joint=joint.T_parent_joint @ error)

    return replace(robot, joints=tuple(moved(joint) for joint in robot.joints)) if errors else robot


def _motion_ranges(ranges: MotionRanges, values: Values) -> MotionRanges:
    own = _values_of(values, "motion")
    if "nearest_m" in own:
        near, far = sorted((own["nearest_m"], own["farthest_m"]))
        ranges = replace(ranges, distance=(near, far))
    return replace(
        ranges,
        tilt=math.radians(own["tilt_deg"]) if "tilt_deg" in own else ranges.tilt,
        roll=math.radians(own["roll_deg"]) if "roll_deg" in own else ranges.roll,
        partial=own.get("partial", ranges.partial),
    )


def _pattern_bows(system: System, values: Values) -> dict[str, tuple[float, float]]:
    """Return the bows of the patterns in the values, m."""
    own = {name: _values_of(values, name) for name in system.patterns}
    return {
        name: (each["bow_x_mm"] / 1000, each["bow_y_mm"] / 1000) for name, each in own.items() if "bow_x_mm" in each
    }


def _scenario_scene(system: System, motion: MotionRanges, scenario: Scenario) -> Scene:
    """Return the scene with the scenario's light and occluders."""
    scene, own = system.scene, _values_of(scenario.values, "light")
    light = replace(
        scene.light,
        ambient=own.get("ambient", scene.light.ambient),
        intensity=own.get("intensity", scene.light.intensity),
    )
    if "elevation_deg" in own:
        elevation, azimuth = math.radians(own["elevation_deg"]), math.radians(own["azimuth_deg"])
        level = math.cos(elevation)
        towards = np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)])
        light = replace(light, direction=towards)
    count = int(scenario.values.get("occluders.count", 0))
    occluders = tuple(_draw_occluder(system, motion, scenario, number) for number in range(count))
    return replace(scene, light=light, boxes=(*scene.boxes, *occluders))


def _draw_occluder(system: System, motion: MotionRanges, scenario: Scenario, number: int) -> Box:
    """Return a cube on the line of sight of some pixel of some camera, nearer than the pattern comes."""
    if not system.cameras:
        raise InputError(f"occluders stand between a camera and the pattern, but {system.name} has no camera")
    random = scenario.random("occluder", number)
    name = list(system.cameras)[random.integers(len(system.cameras))]
    camera = system.cameras[name].camera
    pattern = system.moved_pattern or next(iter(system.patterns.values()))
    nearest, _ = motion.distance or filling_distances(camera, pattern)
    pixel = random.random(2) * [camera.width, camera.height] - 0.5
    sight = camera.rays(pixel)
    least, most = _OCCLUDER_REACH
    way = nearest * (least + (most - least) * random.random())
    centre = apply(_rest_pose(system, name), way / np.linalg.norm(sight) * sight[None])[0]
    yaw = np.pi / 2 * random.random()
    edge = scenario.values["occluders.size_m"]
    return Box(
        from_xyz_rpy(np.round(centre, _PLACE_DECIMALS), (0.0, 0.0, round(yaw, _PLACE_DECIMALS))), np.full(3, edge)
    )
