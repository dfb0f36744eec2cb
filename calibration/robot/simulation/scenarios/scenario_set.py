"""Scenario sets: distributions of the parameters that vary between scenarios, and constraints on them.

A scenario set is YAML, such as::

    light: {elevation_deg: {uniform: [20, 80]}, azimuth_deg: {uniform: [-180, 180]}}
    cameras: {noise_levels: {log_uniform: [0.5, 4]}, k1: {normal: [0, 0.05]}}
    sensors: {left_camera: {exposure: 1.5}}
    assembly: {translation_mm: {normal: [0, 3]}, rotation_deg: {normal: [0, 0.5]}}
    occluders: {count: {integer: [0, 3]}, size_m: {uniform: [0.05, 0.2]}}
    constraints:
      - {parameter: scene.clearance_m, min: 0.1}

A scenario has a value for each member of a group: ``cameras`` and ``noise_levels`` give ``left_camera.noise_levels``
and ``right_camera.noise_levels``. A parameter with axes, such as ``translation_mm`` under ``assembly``, has one for
each of them: ``left_camera.translation_x_mm``. Distributions are in
`calibration.robot.simulation.scenarios.distributions`.

``constraints`` is a list of

- ``{parameter: NAME, min: A, max: B}``, with one of the two or both;
- ``{less: [NAME, NAME, ...]}``: each below the next.

A name is that of a parameter, ``left_camera.exposure``, or of all of a kind, ``cameras.exposure``, or
`CLEARANCE_KEY`. Values that break a constraint are drawn again.

Scenario i of seed s is addressed directly: each of its values depends on s, i and the parameter's
name alone, so any subset of the scenarios has the same values, in any order and on any machine, and
adding a parameter to the set does not change the values of the others.
"""

import math
import typing
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

from calibration.base import InputError, read_yaml, shorten
from calibration.base.records import (
    Misfit,
    Place,
    exactly_one,
    excludes,
    field,
    flat_fields,
    length,
    needs,
    read,
    record,
    unknown_key,
)
from calibration.engine.geometry.frames import JOINT_PARAMETERS
from calibration.robot.simulation.scenarios.distributions import Distribution, Drawn, drawn
from calibration.robot.simulation.scenarios.scenario import Scenario, build_world, clearance
from calibration.robot.simulation.system import System

CLEARANCE_KEY = "scene.clearance_m"
"""Smallest distance from a sensor to a box, m, with the robot at rest."""

Value = Callable[[str], float]
"""Function that returns the value of a parameter or of `CLEARANCE_KEY`, by its name."""


@dataclass(frozen=True)
class Constraint:
    """Constraint on the values of a scenario."""

    text: str
    """Name in messages."""
    holds: Callable[[Value], bool]
    """Whether a scenario satisfies it."""


@record(case="snake", rules=(exactly_one("parameter", "less"), excludes("less", "min"), excludes("less", "max")))
class ConstraintEntry:
    """Constraint as it is in the document."""

    parameter: Annotated[str, length(1)] | None = field("The name of what lies between min and max.", default=None)
    min: float | None = field("The least value.", default=None)
    max: float | None = field("The largest value.", default=None)
    less: Annotated[tuple[Annotated[str, length(1)], ...], length(2)] | None = field(
        "Names: each of them below the next.", default=None
    )

    def __post_init__(self) -> None:
        """Refuse a parameter without limits, and empty intervals."""
        if self.parameter is not None and self.min is None and self.max is None:
            raise Misfit("found neither 'min' nor 'max', expected one of them or both")
        if self.min is not None and self.max is not None and self.min > self.max:
            raise Misfit(f"found min {self.min:g} above max {self.max:g}")

    def constraint(self, named: Callable[[str], tuple[str, ...]]) -> Constraint:
        """Create the constraint; ``named`` returns the parameters of a name."""
        if self.less is not None:
            groups = list(map(named, self.less))
            return Constraint(
                " < ".join(self.less),
                lambda value: all(max(map(value, lower)) < min(map(value, upper)) for lower, upper in pairwise(groups)),
            )
        name = self.parameter or ""
        names = named(name)
        limits = [f"at least {self.min:g}"] if self.min is not None else []
        limits += [f"at most {self.max:g}"] if self.max is not None else []
        low, high = -math.inf if self.min is None else self.min, math.inf if self.max is None else self.max
        return Constraint(
            f"{name} {' and '.join(limits)}", lambda value: all(low <= value(each) <= high for each in names)
        )


def broken(constraints: tuple[Constraint, ...], values: Mapping[str, float], clearance: Callable[[], float]) -> int:
    """Return the index of the first constraint that a scenario breaks; -1 if it satisfies all.

    Args:
        constraints: in the order of the file.
        values: the scenario's parameters.
        clearance: function for the value of `CLEARANCE_KEY`, called only if a constraint names it.
    """

    def value(name: str) -> float:
        return clearance() if name == CLEARANCE_KEY else values[name]

    return next((i for i, constraint in enumerate(constraints) if not constraint.holds(value)), -1)


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
        if parameter in parameters and system.nominal.movable[name].model.unit(parameter) == unit
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


MAX_ATTEMPTS = 100
"""Limit of the draws of one scenario until it satisfies all constraints."""


@dataclass(frozen=True, eq=False)
class ScenarioSet:
    """Scenarios of one system."""

    path: Path
    """File that it was read from."""
    system: System
    """System as described, which the scenarios vary."""
    parameters: Parameters
    constraints: tuple[Constraint, ...]

    def scenario(self, seed: int, index: int) -> Scenario:
        """Draw scenario ``index`` of a seed.

        Raises:
            InputError: `MAX_ATTEMPTS` draws in a row broke a constraint; names the one that was broken most often.
        """
        failures: Counter[int] = Counter()
        for attempt in range(MAX_ATTEMPTS):
            scenario = self._draw_scenario(seed, index, attempt)
            fault = broken(self.constraints, scenario.values, partial(self._clearance_of, scenario))
            if fault < 0:
                return scenario
            failures[fault] += 1
        worst, count = failures.most_common(1)[0]
        raise InputError(
            f"{self.path}: constraints.{worst}: '{self.constraints[worst].text}' is broken by {count} of "
            f"{MAX_ATTEMPTS} draws of scenario {scenario.id}, and another by the rest; "
            "loosen it, or narrow the distributions"
        )

    def _clearance_of(self, scenario: Scenario) -> float:
        return clearance(build_world(self.system, scenario))

    def _draw_scenario(self, seed: int, index: int, attempt: int) -> Scenario:
        empty = Scenario(seed, index, {}, attempt)
        values = {
            name: distribution.value(empty.random("value", name).random())
            for name, distribution in self.parameters.distributions.items()
        }
        return Scenario(seed, index, values, attempt)


def read_scenario_set(path: Path, system: System) -> ScenarioSet:
    """Read a scenario set for a system.

    Raises:
        InputError: in one line, with file and key: not YAML, an unknown key, a
            invalid distribution, a constraint on a parameter that does not vary.
    """
    place = Place(str(path))
    file = read(ScenarioSetFile, read_yaml(path, "a scenario set"), str(path))
    parameters = parameters_of(file, system, place)

    def constraint(index: int, entry: ConstraintEntry) -> Constraint:
        def named(name: str) -> tuple[str, ...]:
            names = (name,) if name == CLEARANCE_KEY else parameters.named(name)
            if not names:
                known = ", ".join((*parameters.groups, CLEARANCE_KEY))
                where = place.below("constraints").below(index)
                raise where.fault(f"found '{shorten(name)}', which this scenario set does not draw (it draws {known})")
            return names

        return entry.constraint(named)

    constraints = tuple(constraint(index, entry) for index, entry in enumerate(file.constraints))
    return ScenarioSet(path, system, parameters, constraints)
