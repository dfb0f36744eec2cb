"""Small datasets made by hand: what the sensors would see of true poses, with or without noise."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.comparison import COMPARISON_METHODS, Method
from calibration.engine.dataset.modalities import DEPTH, LIDAR3D, RGB
from calibration.engine.dataset.model import Collection, CornerLabels, Dataset, Edge, Labels, PointLabels, Sensor
from calibration.engine.dataset.pattern import Pattern, grid, outline
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import PlumbBob
from calibration.engine.geometry.transforms import apply, from_xyz_rpy, inverse, transform

CAMERA = Camera(554.0, 554.0, 320.5, 240.5, 640, 480)
WIDE = Camera(500.0, 510.0, 322.0, 238.0, 640, 480, PlumbBob(-0.25, 0.08, 1e-3, -5e-4, -0.01))
T_LINK_OPTICAL = from_xyz_rpy([0, 0, 0], [-np.pi / 2, 0, -np.pi / 2])
ORIGIN = (0.05, 0.05)


def pattern(*, fixed: bool = False, parent: str = "world", name: str = "board") -> Pattern:
    """A charuco board of 6 x 5 corners, 50 mm apart."""
    return Pattern(
        name,
        "charuco",
        f"{name}_link",
        parent,
        fixed,
        grid(6, 5, 0.05, ORIGIN),
        outline(6, 5, 0.05, (0.02, 0.01), ORIGIN),
    )


def rgb(name: str, camera: Camera = CAMERA) -> Sensor:
    """A camera whose link hangs under its mount: ``<name>_mount -> <name>_link`` is calibrated."""
    return Sensor(name, RGB, f"{name}_optical", f"{name}_mount", f"{name}_link", camera)


def lidar(name: str) -> Sensor:
    """A LiDAR whose base hangs under its mount."""
    return Sensor(name, LIDAR3D, f"{name}_scan", f"{name}_mount", f"{name}_base")


def dataset(
    sensors: list[Sensor],
    board: Pattern,
    transforms: Mapping[Edge, Array],
    labels: list[dict[str, Labels]],
    anchored: str | None = None,
) -> Dataset:
    """Collections "000", "001" and so on; labels by the sensor's name."""
    n = len(labels)
    return Dataset(
        path=Path("scene/dataset.json"),
        version="3.0",
        world="world",
        sensors={s.name: s for s in sensors},
        patterns={board.name: board},
        anchored=anchored,
        additional_transforms=(),
        collections=tuple(
            Collection(f"{i:03d}", {(board.name, sensor): label for sensor, label in seen.items()})
            for i, seen in enumerate(labels)
        ),
        transforms={edge: np.broadcast_to(T, (n, 4, 4)) for edge, T in transforms.items()},
        document={},
    )


def corner_labels(camera: Camera, board: Pattern, T_camera_pattern: Array, noise: Array) -> CornerLabels:
    """The corners on the image; noise (K, 2) in pixels."""
    pixels = camera.project(apply(T_camera_pattern, board.corners))
    ids = np.flatnonzero(camera.contains(pixels))
    return CornerLabels(ids, pixels[ids] + noise[ids])


def facing_poses(rng: np.random.Generator, board: Pattern, n: int) -> Array:
    """``T_world_pattern`` about 1.2 m in front of the origin, looking along x."""
    R = from_xyz_rpy([0, 0, 0], [-np.pi / 2, 0, -np.pi / 2])[:3, :3] @ rotations.exp(rng.normal(size=(n, 3)) * 0.35)
    centre = rng.uniform([1.0, -0.15, -0.1], [1.4, 0.15, 0.1], (n, 3))
    return transform(R, centre - R @ board.centre)


def two_cameras(seed: int = 0, n: int = 8, noise: float = 0.0, right: Camera = CAMERA) -> tuple[Dataset, Array]:
    """Cameras "left" and "right" 0.3 m apart and a moving pattern; also ``T_world_pattern`` (n, 4, 4)."""
    rng = np.random.default_rng(seed)
    board, sensors = pattern(), [rgb("left"), rgb("right", right)]
    T_world_pattern = facing_poses(rng, board, n)
    transforms = {
        ("world", "left_mount"): from_xyz_rpy([0, 0.15, 0.01], [0, 0, -0.1]),
        ("world", "right_mount"): from_xyz_rpy([0, -0.15, 0], [0.02, 0, 0.1]),
        **{(f"{s.name}_mount", f"{s.name}_link"): from_xyz_rpy([0.01, 0, 0.02], [0, 0, 0.03]) for s in sensors},
        **{(f"{s.name}_link", f"{s.name}_optical"): T_LINK_OPTICAL for s in sensors},
    }
    empty = dataset(sensors, board, transforms, [{}] * n)
    return with_corners(empty, T_world_pattern, rng, noise), T_world_pattern


def arm(
    seed: int = 0, n: int = 10, noise: float = 0.0, *, eye_in_hand: bool = False, axis: Array | None = None
) -> Dataset:
    """A camera and a fixed pattern on either side of an arm; with an axis, it turns about that one only."""
    rng = np.random.default_rng(seed)
    board, sensor = pattern(fixed=True, parent="world" if eye_in_hand else "flange"), rgb("eye", WIDE)
    # how the camera would see the pattern, and then where the flange has to be for that
    T_link_pattern = facing_poses(rng, board, n)
    if axis is not None:
        angles = np.linspace(-0.5, 0.5, n)[:, None]
        T_link_pattern = T_link_pattern[:1] @ transform(rotations.exp(angles * axis), np.zeros(3))
    T_mount_link = from_xyz_rpy([0.02, 0.01, 0.05], [0.1, -0.2, 0.3])
    T_world_mount = from_xyz_rpy([0.3, -0.2, 1.0], [0, 0.2, 0.4])
    T_flange_pattern = from_xyz_rpy([0.05, -0.06, 0.02], [0.3, 0.1, -0.5])
    T_world_pattern = from_xyz_rpy([1.5, 0.2, 0.6], [0.2, 1.5, 0.5])
    if eye_in_hand:
        T_world_flange = T_world_pattern @ inverse(T_mount_link @ T_link_pattern)
        placed = {
            ("world", "flange"): T_world_flange,
            ("flange", "eye_mount"): np.eye(4),
            ("world", "board_link"): T_world_pattern,
        }
    else:
        T_world_flange = T_world_mount @ T_mount_link @ T_link_pattern @ inverse(T_flange_pattern)
        placed = {
            ("world", "flange"): T_world_flange,
            ("world", "eye_mount"): T_world_mount,
            ("flange", "board_link"): T_flange_pattern,
        }
    transforms = {**placed, ("eye_mount", "eye_link"): T_mount_link, ("eye_link", "eye_optical"): T_LINK_OPTICAL}
    empty = dataset([sensor], board, transforms, [{}] * n)
    return with_corners(empty, empty.transform("world", "board_link"), rng, noise)


def lidar_and_camera(seed: int = 0, n: int = 4, camera: Camera = CAMERA) -> tuple[Dataset, Array]:
    """A LiDAR "scan" with exact points on the pattern's border, and a camera "eye"; also ``T_world_pattern``."""
    rng = np.random.default_rng(seed)
    board = pattern()
    T_world_pattern = facing_poses(rng, board, n)
    transforms = {
        ("world", "eye_mount"): from_xyz_rpy([0, 0.1, 0], [0, 0, -0.05]),
        ("eye_mount", "eye_link"): from_xyz_rpy([0.01, 0, 0.02], [0, 0, 0.03]),
        ("eye_link", "eye_optical"): T_LINK_OPTICAL,
        ("world", "scan_mount"): from_xyz_rpy([0, -0.2, 0], [0, 0, 0.3]),
        ("scan_mount", "scan_base"): from_xyz_rpy([0.015, 0, 0.006], [0, 0, 0.5]),
        ("scan_base", "scan_scan"): from_xyz_rpy([0, 0, 0.04], [0, 0, 0]),
    }
    empty = dataset([rgb("eye", camera), lidar("scan")], board, transforms, [{}] * n, anchored="eye")
    seen = with_corners(empty, T_world_pattern, rng, 0.0)
    share = rng.random((40, 1))
    side = rng.integers(0, 4, 40)
    border = (1 - share) * board.outline[side] + share * board.outline[(side + 1) % 4]
    inside = np.array([[0.15, 0.15], [0.2, 0.1]])
    flat = np.column_stack([np.concatenate([inside, border]), np.zeros(42)])
    points = apply(seen.transform("scan_scan", "world") @ T_world_pattern, flat)
    return with_labels(seen, "scan", [PointLabels(p, np.arange(2, 42)) for p in points]), T_world_pattern


def with_corners(base: Dataset, T_world_pattern: Array, rng: np.random.Generator, noise: float) -> Dataset:
    """The dataset with what its cameras see of the pattern."""
    board = next(iter(base.patterns.values()))
    for sensor in base.sensors.values():
        if sensor.camera is not None:
            T = base.transform(sensor.frame, "world") @ T_world_pattern
            draws = rng.normal(size=(len(T), len(board.corners), 2)) * noise
            base = with_labels(
                base, sensor.name, [corner_labels(sensor.camera, board, t, d) for t, d in zip(T, draws, strict=True)]
            )
    return base


def with_labels(base: Dataset, sensor: str, labels: list[Labels | None]) -> Dataset:
    """The dataset with other labels of one sensor, one for each collection; None for no detection."""
    board = next(iter(base.patterns))
    collections = []
    for collection, label in zip(base.collections, labels, strict=True):
        others = {key: value for key, value in collection.labels.items() if key != (board, sensor)}
        collections.append(replace(collection, labels=others if label is None else {**others, (board, sensor): label}))
    return replace(base, collections=tuple(collections))


def depth(name: str, camera: Camera = CAMERA) -> Sensor:
    """A depth camera whose link hangs under its mount."""
    return replace(rgb(name, camera), modality=DEPTH)


def range_pair(
    seed: int = 0, n: int = 4, kinds: tuple[str, str] = ("lidar3d", "depth"), *, fixed: bool = False, noise: float = 0.0
) -> tuple[Dataset, Array]:
    """Sensors "one" and "two" that see a pattern; noise of the points in m; also ``T_world_pattern``.

    LiDARs see points all over it and on its border, depth cameras every fourth pixel. A fixed pattern is on an arm.
    """
    rng = np.random.default_rng(seed)
    board = pattern(fixed=fixed, parent="flange" if fixed else "world")
    sensors = [
        lidar(name) if kind == "lidar3d" else depth(name) for name, kind in zip(("one", "two"), kinds, strict=True)
    ]
    T_world_pattern = facing_poses(rng, board, n)
    transforms = {
        ("world", "one_mount"): from_xyz_rpy([0, 0.1, 0], [0, 0, -0.05]),
        ("world", "two_mount"): from_xyz_rpy([0, -0.1, 0.02], [0.03, 0, 0.06]),
    }
    for sensor in sensors:
        transforms[sensor.edge] = from_xyz_rpy([0.015, 0, 0.006], [0, 0.02, 0.03])
        transforms[sensor.calibration_child, sensor.frame] = (
            T_LINK_OPTICAL if sensor.modality == DEPTH else from_xyz_rpy([0, 0, 0.04], [0, 0, 0])
        )
    if fixed:
        T_flange_pattern = from_xyz_rpy([0.05, -0.06, 0.02], [0.3, 0.1, -0.5])
        transforms["world", "flange"] = T_world_pattern @ inverse(T_flange_pattern)
        transforms["flange", board.link] = T_flange_pattern
    base = dataset(sensors, board, transforms, [{}] * n, anchored="one")
    for sensor in sensors:
        T = base.transform(sensor.frame, "world") @ T_world_pattern
        seen = _depth_points if sensor.modality == DEPTH else _lidar_points
        labels = [seen(rng, sensor, board, t) for t in T]
        noisy = [replace(label, points=label.points + rng.normal(size=label.points.shape) * noise) for label in labels]
        base = with_labels(base, sensor.name, list(noisy))
    return base, T_world_pattern


def _lidar_points(rng: np.random.Generator, _: Sensor, board: Pattern, T: Array) -> PointLabels:
    share, side = rng.random((60, 1)), rng.integers(0, 4, 60)
    border = (1 - share) * board.outline[side] + share * board.outline[(side + 1) % 4]
    inside = rng.uniform(board.outline[0], board.outline[2], (200, 2))
    flat = np.column_stack([np.concatenate([border, inside]), np.zeros(260)])
    return PointLabels(apply(T, flat), np.arange(60))


def _depth_points(_: np.random.Generator, sensor: Sensor, board: Pattern, T: Array) -> PointLabels:
    assert sensor.camera is not None
    v, u = np.mgrid[0 : sensor.camera.height : 4, 0 : sensor.camera.width : 4]
    rays = np.concatenate([sensor.camera.normalise(np.stack([u, v], -1).astype(float)), np.ones((*u.shape, 1))], -1)
    points = rays * ((T[:3, 2] @ T[:3, 3]) / (rays @ T[:3, 2]))[..., None]
    flat = apply(inverse(T), points.reshape(-1, 3))[:, :2].reshape(*u.shape, 2)
    on = ((flat >= board.outline[0]) & (flat <= board.outline[2])).all(-1)
    padded = np.pad(on, 1)
    within = padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    return PointLabels(points[on], np.flatnonzero(~within[on]))


def cut(base: Dataset, sensor: str, counts: list[int]) -> Dataset:
    """The dataset with only so many corners of a camera in each collection."""
    board = next(iter(base.patterns))
    labels: list[Labels | None] = []
    for collection, count in zip(base.collections, counts, strict=True):
        label = collection.labels[board, sensor]
        assert isinstance(label, CornerLabels)
        labels.append(CornerLabels(label.ids[:count], label.pixels[:count]))
    return with_labels(base, sensor, labels)


def applicable(dataset: Dataset) -> list[Method]:
    """The other methods that apply to a dataset."""
    return [] if dataset.joints else [each for each in COMPARISON_METHODS.values() if each.why_not(dataset) is None]
