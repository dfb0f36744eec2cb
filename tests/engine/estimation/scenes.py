"""Small synthetic datasets of any structure: a tree of frames, sensors, patterns, and what the sensors would see."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.modalities import DEPTH, LIDAR2D, LIDAR3D, RGB
from calibration.engine.dataset.model import Collection, CornerLabels, Dataset, Edge, Joint, Labels, PointLabels, Sensor
from calibration.engine.dataset.pattern import Pattern, grid, outline
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.start.build import Setup
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import PlumbBob
from calibration.engine.geometry.transforms import (
    apply,
    distance,
    from_xyz_rpy,
    inverse,
    local,
    retract,
    transform,
    translation,
)

PINHOLE = Camera(800.0, 790.0, 640.0, 480.0, 1280, 960)
WIDE = replace(PINHOLE, distortion=PlumbBob(-0.10, 0.05, 0.001, -0.0005, 0.01))
DEPTH_CAMERA = Camera(160.0, 160.0, 160.0, 120.0, 320, 240)
# A LiDAR's frame (x ahead, z up) in a camera's axes (z ahead, y down).
AHEAD = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


@dataclass(frozen=True)
class Scene:
    """The truth, from which `dataset` makes labels."""

    transforms: Mapping[Edge, Array]
    """``T_parent_child``, (4, 4) or (N, 4, 4), those of the patterns among them."""
    sensors: Sequence[Sensor]
    patterns: Sequence[Pattern]
    anchored: str | None = None
    additional: tuple[Edge, ...] = ()
    moving: frozenset[Edge] = frozenset()
    """The additional transforms that are free per collection."""
    joints: tuple[Joint, ...] = ()
    """With their true values; their transforms need not be among `transforms`."""
    sees: Callable[[str, str, int], bool] = lambda sensor, pattern, collection: True
    """Whether a sensor sees a pattern in a collection."""
    pixel_noise: float = 0.0
    range_noise: float = 0.0
    partial: float = 0.0
    """The share of camera views that see only a random half of the corners."""
    border: bool = True
    """Whether LiDAR labels have limit points."""

    def dataset(self, seed: int = 0) -> Dataset:
        """Labels of the true scene; the transforms of the dataset are the truth."""
        rng = np.random.default_rng(seed)
        N = max(
            [len(T) for T in self.transforms.values() if T.ndim == 3] + [len(joint.positions) for joint in self.joints]
        )
        given = {**self.transforms, **{joint.edge: joint.transform for joint in self.joints}}
        edges = {edge: np.broadcast_to(T, (N, 4, 4)).copy() for edge, T in given.items()}
        labels: list[dict[tuple[str, str], Labels]] = [{} for _ in range(N)]
        dataset = Dataset(
            path=Path("scene/dataset.json"),
            version="3.0",
            world="world",
            sensors={sensor.name: sensor for sensor in self.sensors},
            patterns={pattern.name: pattern for pattern in self.patterns},
            anchored=self.anchored,
            additional_transforms=self.additional,
            collections=tuple(Collection(f"{i:03}", labels[i]) for i in range(N)),
            transforms=edges,
            document={},
            moving_transforms=self.moving,
            joints={joint.name: joint for joint in self.joints},
        )
        for pattern in self.patterns:
            for sensor in self.sensors:
                T = dataset.transform(sensor.frame, pattern.link)
                for i in range(N):
                    if self.sees(sensor.name, pattern.name, i):
                        labels[i][pattern.name, sensor.name] = self._label(sensor, pattern, T[i], rng)
        return dataset

    def _label(self, sensor: Sensor, pattern: Pattern, T: Array, rng: np.random.Generator) -> Labels:
        if sensor.modality == LIDAR2D:
            return scan_line(pattern, T, rng, self.range_noise, self.border)
        if sensor.modality == DEPTH:
            return depth_pixels(pattern, T, sensor.camera or DEPTH_CAMERA, rng, self.range_noise)
        if sensor.camera is None:
            return scan(pattern, T, rng, self.range_noise, self.border)
        pixels = sensor.camera.project(apply(T, pattern.corners))
        pixels += rng.normal(size=pixels.shape) * self.pixel_noise
        K = len(pattern.corners)
        count = K // 2 if rng.random() < self.partial else K
        ids = np.sort(rng.permutation(K)[:count])
        return CornerLabels(ids, pixels[ids])


def scan(
    pattern: Pattern, T: Array, rng: np.random.Generator, noise: float = 0.0, border: bool = True, step: float = 0.4
) -> PointLabels:
    """The points of a LiDAR of 16 rings, 2 degrees apart, on a pattern at ``T_sensor_pattern``; the ends of rings."""
    polar, azimuth = np.radians(90 - np.arange(-15, 16, 2)), np.radians(np.arange(-180, 180, step))
    rays = np.stack(
        [
            np.sin(polar)[:, None] * np.cos(azimuth),
            np.sin(polar)[:, None] * np.sin(azimuth),
            np.cos(polar)[:, None] + 0 * azimuth,
        ],
        -1,
    )
    with np.errstate(divide="ignore"):
        distance = (T[:3, 2] @ T[:3, 3]) / (rays @ T[:3, 2])
    at = (rays * distance[..., None] - T[:3, 3]) @ T[:3, :2]
    low, high = pattern.outline.min(0), pattern.outline.max(0)
    hit = (distance > 0) & (at >= low).all(-1) & (at <= high).all(-1)
    points = rays[hit] * (distance[hit] + rng.normal(size=hit.sum()) * noise)[:, None]
    if not border:
        return PointLabels(points, np.zeros(0, int))
    ring, column = np.nonzero(hit)
    # rings across the seam at 180 degrees are in one piece when counted from the pattern's own azimuth
    middle = np.arctan2(T[1, 3], T[0, 3])
    around = np.mod(azimuth[column] - middle + np.pi, 2 * np.pi)
    limits = []
    for r in np.unique(ring):
        own = np.flatnonzero(ring == r)
        limits += [own[around[own].argmin()], own[around[own].argmax()]]
    return PointLabels(points, np.unique(limits).astype(int))


def scan_line(
    pattern: Pattern, T: Array, rng: np.random.Generator, noise: float = 0.0, border: bool = True, step: float = 0.5
) -> PointLabels:
    """Scan line of a 2D LiDAR, a ray every `step` degrees, on a pattern at ``T_sensor_pattern``, with its ends.

    The scan begins at a random angle, so that the border is at a random position between two rays.
    """
    azimuth = np.radians(np.arange(-180, 180, step) + step * rng.random())
    rays = np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], -1)
    with np.errstate(divide="ignore"):
        distance = (T[:3, 2] @ T[:3, 3]) / (rays @ T[:3, 2])
    at = (rays * distance[:, None] - T[:3, 3]) @ T[:3, :2]
    hit = np.flatnonzero((distance > 0) & ((at >= pattern.outline.min(0)) & (at <= pattern.outline.max(0))).all(-1))
    points = rays[hit] * (distance[hit] + rng.normal(size=len(hit)) * noise)[:, None]
    around = np.mod(azimuth[hit] - np.arctan2(T[1, 3], T[0, 3]) + np.pi, 2 * np.pi)
    ends = [around.argmin(), around.argmax()] if border and len(hit) else []
    return PointLabels(points, np.unique(ends).astype(int))


def depth_pixels(
    pattern: Pattern, T: Array, model: Camera, rng: np.random.Generator, noise: float = 0.0
) -> PointLabels:
    """Every fourth row and column of a depth camera's pixels on a pattern, none of them labelled as its border."""
    low, high = pattern.outline.min(0), pattern.outline.max(0)
    x, y = np.meshgrid(np.arange(0, model.width, 4.0), np.arange(0, model.height, 4.0))
    rays = np.append(model.normalise(np.stack([x, y], -1)), np.ones((*x.shape, 1)), -1)
    depth = (T[:3, 2] @ T[:3, 3]) / (rays @ T[:3, 2])
    at = (rays * depth[..., None] - T[:3, 3]) @ T[:3, :2]
    hit = (depth > 0) & (at >= low).all(-1) & (at <= high).all(-1)
    points = rays[hit] * (depth[hit] + rng.normal(size=hit.sum()) * noise)[:, None]
    return PointLabels(points, np.zeros(0, int))


def board(name: str = "board", parent: str = "world", fixed: bool = False, square: float = 0.06) -> Pattern:
    """6 x 5 corners in a border of half a square."""
    border = outline(6, 5, square, (square / 2, square / 2), (0.0, 0.0))
    return Pattern(name, "chessboard", f"{name}_link", parent, fixed, grid(6, 5, square, (0.0, 0.0)), border)


def camera(name: str, parent: str = "world", model: Camera = WIDE) -> Sensor:
    return Sensor(name, RGB, name, parent, name, model)


def lidar(name: str, parent: str = "world") -> Sensor:
    return Sensor(name, LIDAR3D, name, parent, name)


def lidar2d(name: str, parent: str = "world") -> Sensor:
    return Sensor(name, LIDAR2D, name, parent, name)


def depth_camera(name: str, parent: str = "world") -> Sensor:
    return Sensor(name, DEPTH, name, parent, name, DEPTH_CAMERA)


def pose(x: float, y: float, z: float, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> Array:
    return from_xyz_rpy((x, y, z), (roll, pitch, yaw))


def looks(n: int, seed: int = 0, tilt: float = 0.6, pattern: Pattern | None = None) -> Array:
    """``T_camera_pattern`` (n, 4, 4): patterns 1 to 2 m away, tilted by about `tilt` rad."""
    rng = np.random.default_rng(1000 + seed)
    axis = rng.normal(size=(n, 3))
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    R = rotations.exp(axis * rng.uniform(0.3, 1.0, (n, 1)) * tilt)
    centre = rng.uniform((-0.3, -0.2, 1.0), (0.3, 0.2, 2.0), (n, 3))
    return transform(R, centre - R @ (pattern or board()).centre)


def true_values(setup: Setup) -> Values:
    """The truth of all blocks, the dataset's transforms and intrinsics being true; patterns about their centre."""
    joints = {joint.edge: joint.values for joint in setup.dataset.joints.values()}
    centres = {setup.pattern_edge(name): translation(p.centre) for name, p in setup.dataset.patterns.items()}
    values = []
    for block in setup.problem.blocks:
        if block.intrinsics:
            values.append(block.intrinsics.camera.intrinsics)
        elif block.edge in joints:
            values.append(joints[block.edge])
        else:
            T = setup.dataset.transforms[block.edge]
            values.append((T if block.per_collection else T[0]) @ centres.get(block.edge, np.eye(4)))
    return tuple(values)


def shaken(setup: Setup, values: Values, size: float, seed: int = 0) -> Values:
    """The values with random twists on all blocks that are not fixed, each coordinate up to `size` (m, rad)."""
    rng = np.random.default_rng(seed)
    return tuple(
        value if block.held else retract(value, rng.uniform(-size, size, (*value.shape[:-2], 6)))
        for value, block in zip(values, setup.problem.blocks, strict=True)
    )


def relabelled(dataset: Dataset, change: Callable[[int, str, Labels], Labels | None]) -> Dataset:
    """The dataset with what `change(collection, sensor, labels)` makes of the labels of each view; None: not seen."""
    collections = []
    for i, collection in enumerate(dataset.collections):
        changed = {key: change(i, key[1], label) for key, label in collection.labels.items()}
        collections.append(
            replace(collection, labels={key: label for key, label in changed.items() if label is not None})
        )
    return replace(dataset, collections=tuple(collections))


def errors(dataset: Dataset, transforms: Mapping[Edge, Array], gauge: str | None = None) -> tuple[float, float]:
    """The largest errors (m, rad) against the dataset's transforms, relative to the fixed sensor."""
    edge = dataset.sensors[gauge].edge if gauge else None
    back = dataset.transforms[edge][0] @ inverse(transforms[edge]) if edge else np.eye(4)
    apart = [distance(dataset.transforms[e][0], back @ T) for e, T in transforms.items()]
    return max(float(t) for t, _ in apart), max(float(r) for _, r in apart)


def relative(result: Calibration) -> dict[Edge, Array]:
    """The transforms relative to the fixed sensor."""
    back = inverse(result.transforms[result.dataset.sensors[result.gauge].edge]) if result.gauge else np.eye(4)
    return {edge: back @ T for edge, T in result.transforms.items()}


def sigmas_apart(a: Calibration, b: Calibration) -> float:
    """The largest distance between two results in the first one's standard deviations."""
    apart = []
    for edge, covariance in a.covariances.items():
        d = local(relative(a)[edge], relative(b)[edge])
        apart.append(float(np.sqrt(d @ np.linalg.solve(covariance, d))))
    return max(apart)
