"""Parameters of a system that may vary between scenarios: names, limits and groups.

A scenario set has groups, such as ``cameras`` and ``noise_levels``; a scenario has a value for
each member of the group: ``left_camera.noise_levels`` and ``right_camera.noise_levels``. A parameter
with axes, such as ``translation_mm`` under ``assembly``, has one for each of them:
``left_camera.translation_x_mm``.
"""

import typing
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from calibration.base.records import Place, field, flat_fields, length, needs, record, unknown_key
from calibration.engine.geometry.joints import JOINT_PARAMETERS
from calibration.robot.simulation.joints import joint_model
from calibration.robot.simulation.scenarios.constraints import ConstraintEntry
from calibration.robot.simulation.scenarios.distributions import Distribution, Drawn, drawn
from calibration.robot.simulation.system import System

Varied = Distribution | None


def _varied_field(help: str) -> Any:  # noqa: A002 (as in `field`)
    return field(help, default=None)


@record(case="snake", rules=(needs("elevation_deg", "azimuth_deg"), needs("azimuth_deg", "elevation_deg")))
class Light:
    """Light of the scene."""

    ambient: Annotated[Varied, drawn(0, 10)] = _varied_field("Light from everywhere.")
    intensity: Annotated[Varied, drawn(0, 10)] = _varied_field("Light from one direction.")
    elevation_deg: Annotated[Varied, drawn(-90, 90)] = _varied_field("Elevation of the light above the horizon, deg.")
    azimuth_deg: Annotated[Varied, drawn(-360, 360)] = _varied_field(
        "Azimuth of the light about the world's z axis, from its x axis, deg."
    )


@record(case="snake", rules=(needs("count", "size_m"), needs("size_m", "count")))
class Occluders:
    """Boxes between the cameras and the pattern."""

    count: Annotated[Varied, drawn(0, 100, whole=True)] = _varied_field("How many boxes.")
    size_m: Annotated[Varied, drawn(0.001, 100)] = _varied_field("The edge of the boxes, m.")


@record(case="snake", rules=(needs("nearest_m", "farthest_m"), needs("farthest_m", "nearest_m")))
class MotionEntry:
    """Motion of the pattern."""

    poses: Annotated[Varied, drawn(1, 1000, whole=True)] = _varied_field("Number of poses of a generated motion.")
    nearest_m: Annotated[Varied, drawn(0.01, 1000)] = _varied_field(
        "The least distance from a camera to the pattern's centre, m."
    )
    farthest_m: Annotated[Varied, drawn(0.01, 1000)] = _varied_field("The largest distance, m.")
    tilt_deg: Annotated[Varied, drawn(0, 70)] = _varied_field(
        "The largest angle between the pattern's normal and the line of sight, deg."
    )
    roll_deg: Annotated[Varied, drawn(0, 180)] = _varied_field("The largest turn about the line of sight, deg.")
    partial: Annotated[Varied, drawn(0, 1)] = _varied_field(
        "The share of views that see only a part of the pattern, 0 to 1."
    )
    sway_mm: Annotated[Varied, drawn(0, 1000)] = _varied_field("Sway of a moved pattern while the sensors measure, mm.")


@record(case="snake")
class PatternEntry:
    """Deviation of each pattern from a flat one."""

    bow_mm: Annotated[Varied, drawn(-100, 100, axes="xy")] = _varied_field(
        "Height of the pattern's centre towards the viewer, along x and along y, mm."
    )


@record(case="snake")
class Joints:
    """Errors of the calibrated joints' parameters, relative to the robot's description."""

    translation_mm: Annotated[Varied, drawn(-1000, 1000)] = _varied_field("Error of those that are lengths, mm.")
    rotation_deg: Annotated[Varied, drawn(-45, 45)] = _varied_field("Error of those that are angles, deg.")


@record(case="snake")
class Cameras:
    """Parameters of every camera."""

    exposure: Annotated[Varied, drawn(0.01, 100)] = _varied_field("Factor on the light.")
    noise_levels: Annotated[Varied, drawn(0, 100)] = _varied_field(
        "Standard deviation of a pixel's brightness, grey levels of 255."
    )
    blur_px: Annotated[Varied, drawn(0, 20)] = _varied_field("Standard deviation of the lens's blur, px.")
    vignetting: Annotated[Varied, drawn(0, 1)] = _varied_field(
        "Darkening of the image's corners relative to its centre, 0 to 1."
    )
    k1: Annotated[Varied, drawn(-1, 1)] = _varied_field("Distortion (plumb_bob), in place of the sensor's own.")
    k2: Annotated[Varied, drawn(-1, 1)] = _varied_field("Distortion.")
    p1: Annotated[Varied, drawn(-0.1, 0.1)] = _varied_field("Distortion.")
    p2: Annotated[Varied, drawn(-0.1, 0.1)] = _varied_field("Distortion.")
    k3: Annotated[Varied, drawn(-1, 1)] = _varied_field("Distortion.")


@record(case="snake")
class Lidars:
    """Parameters of every LiDAR."""

    noise_m: Annotated[Varied, drawn(0, 1)] = _varied_field("Standard deviation of a measured distance, m.")


@record(case="snake")
class DepthCameras:
    """Parameters of every depth camera."""

    noise_m: Annotated[Varied, drawn(0, 1)] = _varied_field("Standard deviation of a measured distance, m.")


@record(case="snake")
class Assembly:
    """Errors of the calibrated sensors' poses, relative to the robot's description."""

    translation_mm: Annotated[Varied, drawn(-1000, 1000, axes="xyz")] = _varied_field(
        "Error of the calibrated transform along each axis of its child frame, mm."
    )
    rotation_deg: Annotated[Varied, drawn(-90, 90, axes="xyz")] = _varied_field(
        "Error of the calibrated transform about each axis of its child frame, deg."
    )


@record(case="snake")
class OneSensor:
    """Parameters of the scenarios that can be set for a single sensor."""

    cameras: Cameras = field(flat=True)
    lidars: Lidars = field(flat=True)
    depth_cameras: DepthCameras = field(flat=True)
    assembly: Assembly = field(flat=True)


@record(case="snake")
class ScenarioSetFile:
    """Parameters that vary between the scenarios of a simulated system, and constraints on them."""

    light: Light | None = field("The light on the scene.", default=None)
    occluders: Occluders | None = field("Boxes between the cameras and the pattern.", default=None)
    motion: MotionEntry | None = field("Motion of the pattern.", default=None)
    pattern: PatternEntry | None = field("Deviation of each pattern from a flat one.", default=None)
    joints: Joints | None = field(
        "Errors of the calibrated joints' parameters, relative to the robot's description.", default=None
    )
    cameras: Cameras | None = field("Every camera.", default=None)
    lidars: Lidars | None = field("Every LiDAR.", default=None)
    depth_cameras: DepthCameras | None = field("Every depth camera.", default=None)
    assembly: Assembly | None = field(
        "Errors of the calibrated sensors' poses, relative to the robot's description.", default=None
    )
    sensors: Mapping[str, OneSensor] = field(
        "Single sensors by name, overriding the entries for all.", default_factory=dict
    )
    constraints: Annotated[tuple[ConstraintEntry, ...], length(0, 100)] = field(
        "Constraints on every scenario; values that break one are drawn again.", default=()
    )


@dataclass(frozen=True)
class Parameters:
    """Varying parameters of a system's scenarios."""

    distributions: Mapping[str, Distribution]
    """Distributions by the name of their parameter."""
    groups: Mapping[str, tuple[str, ...]]
    """Names of the parameters of each group, such as ``cameras.exposure``."""

    def named(self, name: str) -> tuple[str, ...]:
        """Return the parameter of this name, or the parameters of a group; empty if there is no such name."""
        return (name,) if name in self.distributions else self.groups.get(name, ())


def parameters_of(file: ScenarioSetFile, system: System, place: Place) -> Parameters:
    """Return the parameters of a system that vary in a scenario set.

    The entries of one sensor under ``sensors`` replace those of all sensors under ``cameras``, ``lidars``,
    ``depth_cameras`` and ``assembly``.

    Raises:
        InputError: a sensor is not the system's, or has no such parameter; its place is below ``place``.
    """
    distributions: dict[str, Distribution] = {}
    groups: dict[str, list[str]] = {}

    def add(entry: Any, group: str, things: list[str]) -> None:
        for key, distribution, axes in _given_distributions(entry):
            own = _joint_parameters(system, key) if group == "joints" else things
            names = [f"{thing}.{each}" for thing in own for each in _with_axes(key, axes)]
            distributions.update(dict.fromkeys(names, distribution))
            groups.setdefault(f"{group}.{key}", []).extend(names)

    members = _group_members(system)
    for group in ("light", "occluders", "motion"):
        add(getattr(file, group), group, [group])
    add(file.pattern, "pattern", list(system.patterns))
    add(file.joints, "joints", [])
    for group, things in members.items():
        add(getattr(file, group), group, things)
    for sensor, own in file.sensors.items():
        if sensor not in system.sensors:
            raise place.below("sensors").fault(unknown_key(sensor, list(system.sensors)))
        its = [getattr(own, group) for group, things in members.items() if sensor in things]
        known = [key for entry in its for key in flat_fields(type(entry))]
        for key in (key for group in members for key, *_ in _given_distributions(getattr(own, group))):
            if key not in known:
                raise place.below("sensors").below(sensor).fault(unknown_key(key, known))
        for entry in its:
            add(entry, f"sensors.{sensor}", [sensor])
    return Parameters(distributions, {name: tuple(dict.fromkeys(names)) for name, names in groups.items()})


def _given_distributions(entry: Any) -> list[tuple[str, Distribution, str]]:
    """Return key, distribution and axes of each parameter in a part of a scenario set."""
    if entry is None:
        return []
    found = []
    for key, declared in flat_fields(type(entry)).items():
        if (distribution := getattr(entry, declared.name)) is not None:
            kind = next(each for each in typing.get_args(declared.type) if isinstance(each, Drawn))
            found.append((key, distribution, kind.axes))
    return found


def _with_axes(key: str, axes: str) -> list[str]:
    """Return the keys of a parameter's values: the axis is inserted before the unit."""
    stem, _, unit = key.rpartition("_")
    return [f"{stem}_{axis}_{unit}" for axis in axes] if axes else [key]


def _joint_parameters(system: System, key: str) -> list[str]:
    """Return the calibrated parameters that a key of `Joints` selects: "elbow.origin_yaw"."""
    unit = "m" if key == "translation_mm" else "rad"
    return [
        f"{name}.{parameter}"
        for name, parameters in system.configuration.joints.items()
        for parameter in JOINT_PARAMETERS
        if parameter in parameters and joint_model(system.nominal.movable[name]).unit(parameter) == unit
    ]


def _group_members(system: System) -> dict[str, list[str]]:
    """Return the sensors of each group. An anchored one is left out of ``assembly``: its pose is given."""
    anchored = system.configuration.anchored_sensor
    return {
        **{
            group: [name for name, sensor in system.sensors.items() if sensor.scenario_group == group]
            for group in ("cameras", "lidars", "depth_cameras")
        },
        "assembly": [name for name in system.sensors if name != anchored],
    }
