from typing import Any

import numpy as np
import pytest

from calibration.engine.dataset.sensor_data import DEPTH_UNIT_M, NO_RETURN
from calibration.engine.geometry.lenses import PlumbBob
from calibration.engine.geometry.transforms import apply, from_xyz_rpy, inverse
from calibration.robot.simulation.kinematics import stream
from calibration.robot.simulation.scene import Box, Scene
from calibration.robot.simulation.sensors import SimulatedDepthCamera
from tests.robot.simulation.rendering.views import (
    CHARUCO,
    DISTORTION,
    T_WORLD_CAMERA,
    board,
    camera,
    random_pose,
    square_on,
)


def exact(distortion: PlumbBob | None = None, **options: Any) -> SimulatedDepthCamera:
    return SimulatedDepthCamera(camera(distortion=distortion), **{"noise": 0.0, "noise_growth": 0.0, **options})


def render(sensor: SimulatedDepthCamera, *boards: object, scene: Scene | None = None) -> np.ndarray:
    return sensor.render(T_WORLD_CAMERA, scene or Scene(), boards, stream(0))  # type: ignore[arg-type]


@pytest.mark.parametrize("distortion", [PlumbBob(), DISTORTION])
@pytest.mark.parametrize("bow", [(0.0, 0.0), (0.02, -0.01)])
def test_points_lie_on_the_pattern(distortion: PlumbBob, bow: tuple[float, float]) -> None:
    sensor = exact(distortion)
    T = random_pose(np.random.default_rng(3), CHARUCO, 1.0, 1.2)
    pattern = board(T, bow=bow)
    depth = render(sensor, pattern)
    assert depth.dtype == np.uint16
    rows, columns = np.nonzero(depth != NO_RETURN)
    assert len(rows) > 10_000
    rays = sensor.camera.normalise(np.stack([columns, rows], -1).astype(float))
    points = np.column_stack([rays, np.ones(len(rows))]) * (depth[rows, columns] * DEPTH_UNIT_M)[:, None]
    on_pattern = apply(inverse(T), points)
    np.testing.assert_allclose(on_pattern, pattern.surface(on_pattern[:, :2]), atol=1.5 * DEPTH_UNIT_M)
    low, high = pattern.limits
    assert (on_pattern[:, :2] > low - 1e-4).all()
    assert (on_pattern[:, :2] < high + 1e-4).all()


def test_a_square_on_pattern_has_one_depth_to_its_border() -> None:
    depth = render(exact(), board(square_on(CHARUCO, 0.0, 0.0, 1.2345)))
    assert set(np.unique(depth)) == {12345, NO_RETURN}
    assert (depth == 12345).sum() == pytest.approx(0.8 * 0.6 * (300 / 1.2345) ** 2, rel=0.01)


def test_the_nearest_counts() -> None:
    near, far = (board(square_on(CHARUCO, 0.0, 0.0, z)) for z in (1.0, 2.0))
    np.testing.assert_array_equal(render(exact(), near, far), render(exact(), far, near))
    assert render(exact(), near, far)[120, 160] == 10000
    box = Box(T_WORLD_CAMERA @ from_xyz_rpy([0, 0, 0.8], [0, 0, 0]), np.full(3, 0.2))
    assert render(exact(), near, far, scene=Scene(boxes=(box,)))[120, 160] == 7000


def test_the_ground() -> None:
    depth = render(exact(reach=(0.3, 100.0)), scene=Scene(ground=0.0))
    row = np.arange(200, 240)
    np.testing.assert_allclose(depth[200:, 7] * DEPTH_UNIT_M, 1.2 * 300 / (row - 119.5), atol=DEPTH_UNIT_M)
    assert (depth[:120] == NO_RETURN).all()


@pytest.mark.parametrize(
    ("z", "limits", "expected"),
    [
        (1.0, (0.3, 6.5), 10000),
        (0.2, (0.3, 6.5), NO_RETURN),
        (3.0, (0.3, 2.9), NO_RETURN),
        (6.5534, (0.3, 100.0), 65534),
        (6.5535, (0.3, 100.0), NO_RETURN),  # 16 bits end
        (20.0, (0.3, 100.0), NO_RETURN),
    ],
)
def test_range_limits(z: float, limits: tuple[float, float], expected: int) -> None:
    depth = render(exact(reach=limits), board(square_on(CHARUCO, 0.0, 0.0, z)))
    assert depth[120, 160] == expected


def test_noise_grows_with_the_square_of_the_depth() -> None:
    for z in (0.8, 1.6):
        pattern = board(square_on(CHARUCO, 0.0, 0.0, z))
        depth = render(exact(noise=0.001, noise_growth=0.002), pattern)
        error = depth[100:140, 130:190] * DEPTH_UNIT_M - z
        assert error.std() == pytest.approx(0.001 + 0.002 * z**2, rel=0.05)
        assert abs(error.mean()) < 0.0004


def test_noise_does_not_depend_on_what_is_seen() -> None:
    sensor = exact(noise=0.002)
    near, far = (render(sensor, board(square_on(CHARUCO, 0, 0, z))).astype(int) for z in (1.0, 1.1))
    both = (near != NO_RETURN) & (far != NO_RETURN)
    assert (far - near)[both].min() >= 999
    assert (far - near)[both].max() <= 1001


def test_nothing_is_measured_of_nothing() -> None:
    assert (render(exact()) == NO_RETURN).all()
    assert (render(exact(), board(square_on(CHARUCO, 0, 0, -1.0))) == NO_RETURN).all()


def test_large_noise_does_not_overflow_the_depth() -> None:
    depth = render(exact(noise=10.0), board(square_on(CHARUCO, 0, 0, 1.0)))
    measured = depth[60:180, 60:260]
    assert (measured == NO_RETURN).mean() > 0.5
    assert np.ptp(measured[measured != NO_RETURN]) > 50_000
