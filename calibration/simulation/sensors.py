"""The sensors of a simulated system, as ``simulation.yml`` describes them beside the robot.

A camera: ``width`` and ``height``; ``hfov_deg`` with ``principal_point`` if it is not Gazebo's, or
``K``; ``distortion_model``, one of ROS's (plumb_bob), and ``distortion``, its coefficients;
``blur_px``, ``noise_levels``, ``vignetting`` and ``exposure`` of its images.

A depth camera: its size and lens as a camera's; ``range_m``, ``noise_m``, ``noise_per_m2``.

A LiDAR: ``rings`` and ``vertical_deg``, or the ``elevations_deg`` of every ring; ``azimuths`` in one
revolution; ``range_m``, ``noise_m``, ``resolution_m``; ``margin_deg`` that is stored around the pattern.

A 2D LiDAR: ``rays`` over the angles ``angle_deg``, its first and its last; ``range_m``, ``noise_m``, ``resolution_m``.
"""

import math
from dataclasses import dataclass

import numpy as np

from calibration.dataset.document import Node
from calibration.geometry.cameras import Camera
from calibration.geometry.distortion import MODELS, Distortion, Equidistant, PlumbBob
from calibration.geometry.types import Array
from calibration.simulation.description import interval, number, numbers, only, whole

MAX_PIXELS = 25_000_000
"""Of one image: beyond it memory runs out."""
MAX_RINGS = 1000
MAX_RAYS = 4_000_000
"""Of one scan: beyond it memory runs out before anything useful comes of it."""


@dataclass(frozen=True)
class SimulatedCamera:
    """A camera, and what its lens and its chip make of the light."""

    camera: Camera
    blur: float = 0.65
    """The standard deviation of the lens's Gaussian blur, px."""
    noise: float = 2.0
    """The standard deviation of a pixel's brightness, grey levels; the same on its three colours."""
    vignetting: float = 0.1
    """How much darker the corners of the image are than its middle, 0 to 1."""
    exposure: float = 1.0
    """A factor on the light."""


@dataclass(frozen=True)
class SimulatedDepthCamera:
    """A camera that measures how far along its optical axis things are."""

    camera: Camera
    noise: float = 0.001
    """The standard deviation of a depth near the camera, m."""
    noise_growth: float = 0.0015
    """What the square of the depth adds to it, m per m^2, as triangulation does."""
    least_range: float = 0.3
    """m along the axis; a surface nearer than that gives no depth."""
    most_range: float = 6.5


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


@dataclass(frozen=True)
class SimulatedLidar2d:
    """A LiDAR whose rays lie in the plane z = 0 of its frame; x is angle 0, y a quarter of a revolution."""

    angle_min: float
    """Of the first ray, rad."""
    angle_max: float
    """Of the last ray, rad."""
    rays: int
    least_range: float = 0.1
    """m; a surface nearer than that gives no return."""
    most_range: float = 30.0
    noise: float = 0.01
    """The standard deviation of a range, m."""
    resolution: float = 0.001
    """Ranges are multiples of it, m; 0 for none."""

    @property
    def step(self) -> float:
        """The angle between two rays, rad."""
        return (self.angle_max - self.angle_min) / (self.rays - 1)

    def directions(self) -> Array:
        """(1, rays, 3): unit vectors in the sensor's frame, a single ring."""
        angle = self.angle_min + self.step * np.arange(self.rays)
        return np.stack([np.cos(angle), np.sin(angle), np.zeros(self.rays)], -1)[None]


SimulatedSensor = SimulatedCamera | SimulatedDepthCamera | SimulatedLidar | SimulatedLidar2d


_LENS = ("width", "height", "hfov_deg", "principal_point", "K", "distortion_model", "distortion")


def read_camera(node: Node) -> SimulatedCamera:
    """Read a camera's description.

    Raises:
        InputError: a key is missing, unknown, or its value out of range.
    """
    only(node, *_LENS, "blur_px", "noise_levels", "vignetting", "exposure")
    usual = SimulatedCamera(_read_lens(node))
    return SimulatedCamera(
        usual.camera,
        blur=number(node, "blur_px", usual.blur, least=0, most=20),
        noise=number(node, "noise_levels", usual.noise, least=0, most=255),
        vignetting=number(node, "vignetting", usual.vignetting, least=0, most=1),
        exposure=number(node, "exposure", usual.exposure, least=0, most=100),
    )


def read_depth_camera(node: Node) -> SimulatedDepthCamera:
    """Read a depth camera's description.

    Raises:
        InputError: a key is missing, unknown, or its value out of range.
    """
    only(node, *_LENS, "range_m", "noise_m", "noise_per_m2")
    usual = SimulatedDepthCamera(_read_lens(node))
    least_range, most_range = interval(node, "range_m", (usual.least_range, usual.most_range), least=0)
    return SimulatedDepthCamera(
        usual.camera,
        noise=number(node, "noise_m", usual.noise, least=0, most=10),
        noise_growth=number(node, "noise_per_m2", usual.noise_growth, least=0, most=10),
        least_range=least_range,
        most_range=most_range,
    )


def _read_lens(node: Node) -> Camera:
    width, height = whole(node, "width", 2, 100_000), whole(node, "height", 2, 100_000)
    if width * height > MAX_PIXELS:
        raise node["width"].fault(f"found {width} x {height} pixels, expected {MAX_PIXELS} at most")
    distortion = _read_distortion(node)
    if node.get("K"):
        fx, fy, cx, cy = _intrinsics(node)
    else:
        half = math.radians(number(node, "hfov_deg", least=1, most=170)) / 2
        fx = fy = width / 2 / (half if isinstance(distortion, Equidistant) else math.tan(half))
        # Gazebo's principal point, and so that of ATOM's systems
        cx, cy = numbers(node, "principal_point", 2, (width / 2 + 0.5, height / 2 + 0.5))
    return Camera(fx, fy, cx, cy, width, height, distortion)


def _read_distortion(node: Node) -> Distortion:
    name = node.get("distortion_model")
    if name and name.text() not in MODELS:
        raise name.unexpected(f"one of {', '.join(MODELS)}")
    model = MODELS[name.value] if name else PlumbBob
    count = len(model.names())
    return model(*numbers(node, "distortion", count, (0.0,) * count))


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


def read_lidar2d(node: Node) -> SimulatedLidar2d:
    """Read a 2D LiDAR's description.

    Raises:
        InputError: a key is missing, unknown, or its value out of range.
    """
    only(node, "rays", "angle_deg", "range_m", "noise_m", "resolution_m")
    first, last = interval(node, "angle_deg", (-135.0, 135.0), least=-360, most=360)
    if last - first > 360:
        raise node["angle_deg"].unexpected("at most one revolution, 360 degrees")
    if first == last:
        raise node["angle_deg"].unexpected("two different angles")
    least_range, most_range = interval(node, "range_m", (0.1, 30.0), least=0)
    return SimulatedLidar2d(
        angle_min=math.radians(first),
        angle_max=math.radians(last),
        rays=whole(node, "rays", 8, 100_000),
        least_range=least_range,
        most_range=most_range,
        noise=number(node, "noise_m", 0.01, least=0, most=10),
        resolution=number(node, "resolution_m", 0.001, least=0, most=10),
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
