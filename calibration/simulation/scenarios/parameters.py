"""What may vary between the worlds of a system: the parameters, their limits, their names.

A scenario set speaks of groups, such as ``cameras`` and ``noise_levels``; a world has a value for
each thing in the group: ``left_camera.noise_levels`` and ``right_camera.noise_levels``. A parameter
that has axes, such as ``translation_mm`` under ``assembly``, has one for each of them:
``left_camera.translation_x_mm``.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from calibration.dataset.document import Node
from calibration.geometry.joints import JOINT_PARAMETERS
from calibration.simulation.description import only
from calibration.simulation.joints import joint_model
from calibration.simulation.scenarios.distributions import Distribution, read_distribution
from calibration.simulation.system import System


@dataclass(frozen=True)
class Kind:
    """A kind of parameter: what its values may be."""

    low: float
    high: float
    axes: str = ""
    """Such as "xyz", where it has a value for each."""
    whole: bool = False

    def keys(self, key: str) -> list[str]:
        """The keys of its values: the axis stands before the unit."""
        stem, _, unit = key.rpartition("_")
        return [f"{stem}_{axis}_{unit}" for axis in self.axes] if self.axes else [key]


CAMERA = {
    "exposure": Kind(0.01, 100),  # factor on the light
    "noise_levels": Kind(0, 100),  # standard deviation, grey levels of 255
    "blur_px": Kind(0, 20),  # standard deviation of the lens
    "vignetting": Kind(0, 1),  # how much darker the corners of the image are
    "k1": Kind(-1, 1),  # of the distortion, in place of the sensor's own
    "k2": Kind(-1, 1),
    "p1": Kind(-0.1, 0.1),
    "p2": Kind(-0.1, 0.1),
    "k3": Kind(-1, 1),
}
LIDAR = {"noise_m": Kind(0, 1)}  # standard deviation along the ray
DEPTH_CAMERA = {"noise_m": Kind(0, 1)}
ASSEMBLY = {  # a twist of the calibrated transform, in its child frame
    "translation_mm": Kind(-1000, 1000, axes="xyz"),
    "rotation_deg": Kind(-90, 90, axes="xyz"),
}
JOINTS = {  # of each parameter under calibration, in place of what the simulation's description says of it
    "translation_mm": Kind(-1000, 1000),  # of those that are lengths
    "rotation_deg": Kind(-45, 45),  # of those that are angles
}
PATTERN = {"bow_mm": Kind(-100, 100, axes="xy")}  # how far the middle stands out towards the viewer
LIGHT = {
    "ambient": Kind(0, 10),
    "intensity": Kind(0, 10),
    "elevation_deg": Kind(-90, 90),  # of the light above the horizon
    "azimuth_deg": Kind(-360, 360),  # about the world's z axis, from its x axis
}
OCCLUDERS = {
    "count": Kind(0, 100, whole=True),
    "size_m": Kind(0.001, 100),  # the edge of the cubes
}
MOTION = {
    "poses": Kind(1, 1000, whole=True),  # of a motion that is generated
    "nearest_m": Kind(0.01, 1000),  # between the camera and the pattern's centre
    "farthest_m": Kind(0.01, 1000),
    "tilt_deg": Kind(0, 70),
    "roll_deg": Kind(0, 180),
    "partial": Kind(0, 1),  # the share of views that see only a part of the pattern
    "sway_mm": Kind(0, 1000),  # how far a moved pattern still swings while the sensors look
}

_OF_SENSORS = {"cameras": CAMERA, "lidars": LIDAR, "depth_cameras": DEPTH_CAMERA, "assembly": ASSEMBLY}
_OF_THE_WORLD = {"light": LIGHT, "occluders": OCCLUDERS, "motion": MOTION}
GROUPS = (*_OF_THE_WORLD, "pattern", "joints", *_OF_SENSORS, "sensors")
"""The keys of a scenario set that hold parameters."""
_TOGETHER = (
    ("occluders", "count", "size_m"),
    ("motion", "nearest_m", "farthest_m"),
    ("light", "elevation_deg", "azimuth_deg"),
)
"""Parameters of a group that mean nothing alone."""


@dataclass(frozen=True)
class Parameters:
    """What varies between the worlds of one system."""

    distributions: Mapping[str, Distribution]
    """By the parameter's name."""
    groups: Mapping[str, tuple[str, ...]]
    """The names of the parameters behind what a scenario set may call them together: ``cameras.exposure``."""

    def named(self, name: str) -> tuple[str, ...]:
        """The parameters of this name, or behind the name of a group; none if there is no such thing."""
        return (name,) if name in self.distributions else self.groups.get(name, ())


def read_parameters(root: Node, system: System) -> Parameters:
    """Read what a scenario set says of parameters.

    What ``sensors`` says of one sensor stands in place of what ``cameras``, ``lidars``,
    ``depth_cameras`` and ``assembly`` say of all.

    Raises:
        InputError: a key is unknown, a sensor is not the system's, a distribution is wrong.
    """
    distributions: dict[str, Distribution] = {}
    groups: dict[str, list[str]] = {}

    def read(node: Node | None, kinds: Mapping[str, Kind], group: str, things: list[str]) -> None:
        if node is None:
            return
        only(node, *kinds)
        for key, value in node.items():
            add(value, kinds[key], group, key, things)

    def add(value: Node, kind: Kind, group: str, key: str, things: list[str]) -> None:
        distribution = read_distribution(value, kind.low, kind.high, whole=kind.whole)
        for thing in things:
            names = [f"{thing}.{each}" for each in kind.keys(key)]
            distributions.update(dict.fromkeys(names, distribution))
            groups.setdefault(f"{group}.{key}", []).extend(names)

    for group, kinds in _OF_THE_WORLD.items():
        read(root.get(group), kinds, group, [group])
    read(root.get("pattern"), PATTERN, "pattern", list(system.patterns))
    if joints := root.get("joints"):
        only(joints, *JOINTS)
        for key, value in joints.items():
            add(value, JOINTS[key], "joints", key, _joint_parameters(system, key))
    for group, kinds in _OF_SENSORS.items():
        read(root.get(group), kinds, group, _members(system)[group])
    own = root.get("sensors")
    if own is not None:
        only(own, *system.sensors)
        for sensor, node in own.items():
            kinds = {}
            for group, members in _members(system).items():
                kinds.update(_OF_SENSORS[group] if sensor in members else {})
            read(node, kinds, f"sensors.{sensor}", [sensor])
    for group, *keys in _TOGETHER:
        missing = [key for key in keys if f"{group}.{key}" not in distributions]
        if missing and len(missing) < len(keys):
            raise root[group].fault(f"missing key '{missing[0]}', expected {' and '.join(keys)} together")
    return Parameters(distributions, {name: tuple(dict.fromkeys(names)) for name, names in groups.items()})


def _joint_parameters(system: System, key: str) -> list[str]:
    """The parameters under calibration that a key of `JOINTS` speaks of: "elbow.origin_yaw"."""
    unit = "m" if key == "translation_mm" else "rad"
    return [
        f"{name}.{parameter}"
        for name, parameters in system.configuration.joints.items()
        for parameter in JOINT_PARAMETERS
        if parameter in parameters and joint_model(system.nominal.movable[name]).unit(parameter) == unit
    ]


def _members(system: System) -> dict[str, list[str]]:
    """The sensors that each group of sensors speaks of. One that is anchored is where its description says."""
    anchored = system.configuration.anchored_sensor
    return {
        **{
            group: [name for name, sensor in system.sensors.items() if sensor.scenario_group == group]
            for group in _OF_SENSORS
        },
        "assembly": [name for name in system.sensors if name != anchored],
    }
