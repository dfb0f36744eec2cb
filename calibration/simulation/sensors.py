"""The sensors of a simulated system, as ``simulation.yml`` describes them beside the robot.

A camera: ``width`` and ``height``; ``hfov_deg`` with ``principal_point`` if it is not Gazebo's, or
``K``; ``distortion``, the five coefficients of plumb_bob; ``noise_px`` of its labels.

A LiDAR: ``rings`` and ``vertical_deg``, or the ``elevations_deg`` of every ring; ``azimuths`` in one
revolution; ``range_m``, ``noise_m``, ``resolution_m``; ``margin_deg`` that is stored around the pattern.
"""

import math
from dataclasses import dataclass

import numpy as np

from calibration.dataset.document import Node
from calibration.geometry.cameras import Camera, PlumbBob
from calibration.geometry.types import Array
from calibration.simulation.description import interval, number, numbers, only, whole

MAX_RINGS = 1000
MAX_RAYS = 4_000_000
"""Of one scan: beyond it memory runs out before anything useful comes of it."""


@dataclass(frozen=True)
class SimulatedCamera:
    """A camera and the noise of its labels."""

    camera: Camera
    noise: float = 0.3
    """The standard deviation of a detected corner, each of x and y, px."""


@dataclass(frozen=True)
class SimulatedLidar:
    """A LiDAR that turns about the z axis of its frame; x is azimuth 0."""

    elevations: tuple[float, ...]
    """One for each ring, rad above the x-y plane."""
    azimuths: int
    """How many rays a ring has in one revolution; the first points backwards, along -x."""
    least_range: float = 0.9
    """m; a surface nearer than that gives no return."""
    most_range: float = 130.0
    noise: float = 0.008
    """The standard deviation of a range, m."""
    resolution: float = 0.001
    """Ranges are multiples of it, m; 0 for none."""
    margin: float = math.radians(5)
    """Returns are stored up to this azimuth beyond the pattern, rad."""

    @property
    def step(self) -> float:
        """The azimuth between two rays of a ring, rad."""
        return 2 * math.pi / self.azimuths

    def directions(self) -> Array:
        """(rings, azimuths, 3): unit vectors in the sensor's frame."""
        elevation = np.array(self.elevations)[:, None]
        azimuth = -np.pi + self.step * np.arange(self.azimuths)
        shape = (len(self.elevations), self.azimuths)
        x, y = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
        return np.stack([x, y, np.broadcast_to(np.sin(elevation), shape)], -1)


SimulatedSensor = SimulatedCamera | SimulatedLidar


def read_camera(node: Node) -> SimulatedCamera:
    """Read a camera's description.

    Raises:
        InputError: a key is missing, unknown, or its value out of range.
    """
    only(node, "width", "height", "hfov_deg", "principal_point", "K", "distortion", "noise_px")
    width, height = whole(node, "width", 2, 100_000), whole(node, "height", 2, 100_000)
    if node.get("K"):
        fx, fy, cx, cy = _intrinsics(node)
    else:
        hfov = number(node, "hfov_deg", least=1, most=170)
        fx = fy = width / 2 / math.tan(math.radians(hfov) / 2)
        # Gazebo's principal point, and so that of ATOM's systems
        cx, cy = numbers(node, "principal_point", 2, (width / 2 + 0.5, height / 2 + 0.5))
    distortion = PlumbBob(*numbers(node, "distortion", 5, (0.0, 0.0, 0.0, 0.0, 0.0)))
    return SimulatedCamera(
        Camera(fx, fy, cx, cy, width, height, distortion), number(node, "noise_px", 0.3, least=0, most=100)
    )


def _intrinsics(node: Node) -> tuple[float, float, float, float]:
    for other in ("hfov_deg", "principal_point"):
        if node.get(other):
            raise node[other].fault("stands beside K, which says the same; give one of them")
    fx, skew, cx, zero, fy, cy, *last = numbers(node, "K", 9)
    if min(fx, fy) <= 0 or skew or zero or last != [0, 0, 1]:
        raise node["K"].fault("expected [fx, 0, cx, 0, fy, cy, 0, 0, 1] with fx and fy above 0")
    return fx, fy, cx, cy


def read_lidar(node: Node) -> SimulatedLidar:
    """Read a LiDAR's description.

    Raises:
        InputError: a key is missing, unknown, or its value out of range.
    """
    only(
        node, "rings", "vertical_deg", "elevations_deg", "azimuths", "range_m", "noise_m", "resolution_m", "margin_deg"
    )
    elevations, azimuths = _elevations(node), whole(node, "azimuths", 8, 100_000)
    if len(elevations) * azimuths > MAX_RAYS:
        raise node["azimuths"].fault(f"found {len(elevations)} rings of {azimuths}, expected {MAX_RAYS} rays at most")
    least_range, most_range = interval(node, "range_m", (0.9, 130.0), least=0)
    return SimulatedLidar(
        elevations=tuple(map(math.radians, elevations)),
        azimuths=azimuths,
        least_range=least_range,
        most_range=most_range,
        noise=number(node, "noise_m", 0.008, least=0, most=10),
        resolution=number(node, "resolution_m", 0.001, least=0, most=10),
        margin=math.radians(number(node, "margin_deg", 5.0, least=0, most=360)),
    )


def _elevations(node: Node) -> list[float]:
    """One for each ring: listed, or evenly between two; degrees."""
    listed = node.get("elevations_deg")
    if listed is None:
        low, high = interval(node, "vertical_deg", least=-90, most=90)
        return [float(angle) for angle in np.linspace(low, high, whole(node, "rings", 1, MAX_RINGS))]
    for other in ("rings", "vertical_deg"):
        if node.get(other):
            raise node[other].fault("stands beside elevations_deg, which says the same; give one of them")
    elevations = [element.number() for element in listed.elements()]
    if not 1 <= len(elevations) <= MAX_RINGS or not all(abs(angle) <= 90 for angle in elevations):
        raise listed.unexpected(f"1 to {MAX_RINGS} angles from -90 to 90")
    return elevations
