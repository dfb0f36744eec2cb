"""Each column of fixed parameters against finite differences of the cost, with changed labels, camera or pattern."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.base.arrays import Array
from calibration.engine.dataset.model import CornerLabels, Dataset, PointLabels
from calibration.engine.estimation.least_squares.label_columns import (
    COLUMNS_OF_BENT_PATTERN,
    COLUMNS_OF_PATTERN,
    COLUMNS_OF_RANGES,
    POSE_COLUMNS,
    ColumnNames,
    products,
)
from calibration.engine.estimation.least_squares.normal_equations import Weighting
from calibration.engine.estimation.residuals.corner_residuals import ERRORS_BEYOND_LENS_MODEL
from calibration.engine.estimation.residuals.ray_residuals import elevations
from calibration.engine.estimation.start.build import build
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import apply, inverse, retract, translation
from tests.engine.estimation.scenes import WIDE, relabelled, true_values
from tests.engine.estimation.systems import camera_and_lidar, stereo

WEIGHTING = Weighting({"pixel": 0.5, "range": 0.01, "border": 0.02}, None)
CAMERA = stereo(4).dataset()
LIDAR = camera_and_lidar(4).dataset()


def poses(dataset: Dataset, sensor: str) -> Array:
    """``T_sensor_pattern`` (V, 4, 4) about the corners' centre, a little off the truth."""
    T = dataset.transform(dataset.sensors[sensor].frame, "board_link") @ translation(dataset.patterns["board"].centre)
    rng = np.random.default_rng(5)
    off: Array = retract(T, 0.0005 * rng.normal(size=(len(T), 6)))
    return off


def terms_of(dataset: Dataset, sensor: str) -> list:
    setup = build(dataset)
    (group,) = (group for group in setup.problem.groups if group.sensor == sensor)
    return list(setup.problem.terms(group, true_values(setup)))


def cost(dataset: Dataset, sensor: str, T: Array, centre: Array) -> Array:
    """(V,): the sum of squared residuals of each view, at poses about a centre that a changed pattern has elsewhere."""
    moved = T @ translation(dataset.patterns["board"].centre - centre)
    terms = terms_of(dataset, sensor)
    camera, pattern = dataset.sensors[sensor].camera, dataset.patterns["board"]
    if camera:  # projected here, as the engine has the corners of every pattern in a plane
        errors = camera.project(apply(moved, pattern.corners - pattern.centre)).swapaxes(1, 2) - terms[0].pixels
        return np.asarray((errors**2).sum((1, 2)) / WEIGHTING.scales["pixel"] ** 2)
    return np.sum([term.linearise(moved, WEIGHTING.scales[term.kind], None)[0] for term in terms], axis=0)


def changed(dataset: Dataset, sensor: str, name: str, size: float, T: Array) -> Dataset:
    """The dataset in which a parameter has this value, or its labels as they would be without it."""
    pattern, camera = dataset.patterns["board"], dataset.sensors[sensor].camera
    if camera and name in camera.parameters:
        at = np.array([parameter == name for parameter in camera.parameters])
        return dataset.with_cameras({sensor: camera.with_intrinsics(camera.intrinsics + size * at)})
    half, middle = np.ptp(pattern.outline, axis=0) / 2, pattern.outline.mean(0)
    if name.startswith("size") or (camera and name in COLUMNS_OF_PATTERN):
        return replace(dataset, patterns={"board": _shaped(pattern, name, size, half, middle)})
    if name == "border":
        outward = np.sign(pattern.outline - middle)
        return replace(dataset, patterns={"board": replace(pattern, outline=pattern.outline + size * outward)})

    def without(i: int, own: str, label: CornerLabels | PointLabels) -> CornerLabels | PointLabels:
        if own != sensor:
            return label
        if isinstance(label, CornerLabels):
            assert camera is not None
            return replace(label, pixels=label.pixels - size * _drawn_aside(name, camera, label.pixels))
        return replace(label, points=label.points + size * _correction(name, label.points, T[i], pattern, half, middle))

    return relabelled(dataset, without)


def _bend(name: str, a: Array, b: Array) -> Array:
    return {"bow_x": a * a - 1, "bow_y": b * b - 1, "twist": a * b}[name]


def _shaped(pattern, name: str, size: float, half: Array, middle: Array):
    if name == "border":
        return pattern
    if name.startswith("size"):
        scale = 1 + size * np.array([name == "size_x", name == "size_y", False])
        corners = pattern.centre + (pattern.corners - pattern.centre) * scale
        outline = pattern.centre[:2] + (pattern.outline - pattern.centre[:2]) * scale[:2]
        return replace(pattern, corners=corners, outline=outline)
    a, b = ((pattern.corners[:, :2] - middle) / half).T
    return replace(pattern, corners=pattern.corners + np.outer(size * _bend(name, a, b), (0, 0, 1)))


def _drawn_aside(name: str, camera: Camera, pixels: Array) -> Array:
    """By what pixels (n, 2) would be elsewhere without one unit of an error of the lens."""
    focal = np.array([camera.fx, camera.fy])
    x, y = ((pixels - (camera.cx, camera.cy)) / focal).T
    r2, none = x * x + y * y, np.zeros_like(x)
    return focal * np.stack({"skew": (y, none), "prism_x": (r2, none), "prism_y": (none, r2)}[name], -1)


def _correction(name: str, points: Array, T: Array, pattern, half: Array, middle: Array) -> Array:
    """By what points (n, 3) would be elsewhere without one unit of an error."""
    x, y, z = points.T
    flat, length = np.hypot(x, y), np.linalg.norm(points, axis=-1, keepdims=True)
    if name in ("bias", "scale"):
        return -points / (length if name == "bias" else 1.0)
    if name == "elevation":
        return np.stack([-x * z / flat, -y * z / flat, flat], -1)
    if name.startswith("sweep"):
        return np.outer(np.arctan2(y, x) / (2 * np.pi), np.eye(3)["xyz".index(name[-1])])
    places = apply(inverse(T), points)[:, :2] + pattern.centre[:2]
    a, b = ((places - middle) / half).T
    return -np.outer(_bend(name, a, b), T[:3, 2])


@pytest.mark.parametrize(
    ("dataset", "sensor", "name"),
    [
        *((CAMERA, "left", name) for name in (*WIDE.parameters, *ERRORS_BEYOND_LENS_MODEL, *COLUMNS_OF_BENT_PATTERN)),
        *((LIDAR, "lidar", name) for name in (*COLUMNS_OF_RANGES, *COLUMNS_OF_PATTERN)),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_column_is_the_derivative_of_the_labels_errors(dataset: Dataset, sensor: str, name: str) -> None:
    T, pattern = poses(dataset, sensor), dataset.patterns["board"]
    camera = dataset.sensors[sensor].camera
    M = np.concatenate([part for _, part in products(terms_of(dataset, sensor), camera, pattern, T, WEIGHTING)])
    names = ColumnNames(camera)
    at = POSE_COLUMNS + (*names.of_sensor, *names.of_pattern).index(name)
    m = M[:, :, -1]
    strength = np.sqrt(M[:, at, at])
    step = 1e-3 / strength.max()
    up, down = (cost(changed(dataset, sensor, name, s, T), sensor, T, pattern.centre) for s in (step, -step))
    slope = (up - down) / (2 * step) / 2
    tolerance = 0.005 * (strength * np.sqrt(cost(dataset, sensor, T, pattern.centre))).max()
    assert slope == pytest.approx(m[:, at], abs=tolerance)
    if (sensor, name) != ("lidar", "size_y"):  # which hardly moves the ends of rings
        assert np.abs(m[:, at]).max() > 3 * tolerance  # the column of another error, or of none, would not do


def test_the_columns_of_rings_are_that_of_the_elevation_each_on_its_ring() -> None:
    T, pattern, terms = poses(LIDAR, "lidar"), LIDAR.patterns["board"], terms_of(LIDAR, "lidar")
    rings = np.unique(np.round(elevations(terms[0].rays)[terms[0].present], 6)).tolist()
    assert len(rings) > 4
    M = np.concatenate([part for _, part in products(terms, None, pattern, T, WEIGHTING, rings)])
    names = ColumnNames(None, rings=tuple(rings)).of_sensor
    elevation, first = POSE_COLUMNS + names.index("elevation"), POSE_COLUMNS + len(COLUMNS_OF_RANGES)
    of_rings = slice(first, first + len(rings))
    np.testing.assert_allclose(M[:, of_rings].sum(1), M[:, elevation], atol=1e-9 * np.abs(M[:, elevation]).max())
    among = M[:, of_rings, of_rings]
    assert np.abs(among * (1 - np.eye(len(rings)))).max() == 0  # no label is on two
    assert (among.max(0).diagonal() > 0).all()
