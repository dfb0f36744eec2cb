"""Grids of circles: centres where the truth projects them, whatever the tilt, numbered by a rule."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.base.arrays import Array
from calibration.base.errors import InputError
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.model import CornerLabels
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import apply
from calibration.robot.labelling.corner_detector import corner_detector
from calibration.robot.labelling.detection import Image, NotDetected
from calibration.robot.simulation.random_streams import stream
from calibration.robot.simulation.scene import Scene
from calibration.robot.simulation.sensors import SimulatedCamera
from tests.robot.labelling.pictures import HD_DISTORTED, VGA, facing
from tests.robot.simulation.rendering.views import T_WORLD_CAMERA, board


def circles(columns: int, rows: int, spacing: float, diameter: float, asymmetric: bool = False) -> PatternConfiguration:
    kind = "asymmetric-circles" if asymmetric else "circles"
    size = (columns, rows)
    return PatternConfiguration("grid", kind, "grid", "world", False, size, spacing, diameter, (0.02, 0.02))


SYMMETRIC, ASYMMETRIC = (
    circles(9, 6, 0.05, 0.035),
    circles(4, 11, 0.03, 0.025, True),
)


def rendered(pattern: PatternConfiguration, T: Array, camera: Camera = VGA, seed: int = 0) -> Image:
    view = board(T, pattern)
    return SimulatedCamera(camera).render(T_WORLD_CAMERA, Scene(ground=0.0), [view], stream(seed))


def off(pattern: PatternConfiguration, T: Array, camera: Camera = VGA, image: Image | None = None) -> Array:
    found = corner_detector(pattern).detect(rendered(pattern, T, camera) if image is None else image)
    assert isinstance(found, CornerLabels), found
    assert len(found.ids) == len(pattern.pattern().corners)
    return found.pixels - camera.project(apply(T, pattern.pattern().corners))[found.ids]


@pytest.mark.parametrize("pattern", [SYMMETRIC, ASYMMETRIC], ids=lambda each: each.kind)
@pytest.mark.parametrize("camera", [VGA, HD_DISTORTED], ids=["pinhole", "distorted"])
def test_centres_of_large_circles_have_no_bias_at_45_degrees(pattern: PatternConfiguration, camera: Camera) -> None:
    """The centres of the dark areas are 0.2 px off there: towards the camera, and so each of a view to one side."""
    for towards in (0.0, 1.2, 2.5):
        T = facing(pattern, 0.75 if camera is VGA else 0.95, np.pi / 4, towards, 0.2)
        error = off(pattern, T, camera)
        assert np.sqrt((error**2).sum(-1).mean()) < 0.03
        assert np.abs(error.mean(0)).max() < 0.02


@pytest.mark.parametrize("roll", np.linspace(-np.pi, np.pi, 7))
def test_an_asymmetric_grid_of_odd_rows_keeps_its_ids_at_any_angle(roll: float) -> None:
    assert np.abs(off(ASYMMETRIC, facing(ASYMMETRIC, 0.75, 0.3, 0.5, roll))).max() < 0.1


def test_a_symmetric_grid_is_numbered_from_the_more_upright_end() -> None:
    pattern = SYMMETRIC
    assert np.abs(off(pattern, facing(pattern, 0.9, 0.3, 0.5, 1.2))).max() < 0.1
    T = facing(pattern, 0.9, 0.3, 0.5, np.pi - 0.2)
    found = corner_detector(pattern).detect(rendered(pattern, T))
    assert isinstance(found, CornerLabels), found
    assert np.abs(found.pixels - VGA.project(apply(T, pattern.pattern().corners))[::-1]).max() < 0.1


def test_uneven_light_and_inverted_colours_move_no_centre() -> None:
    T = facing(SYMMETRIC, 0.9, 0.4, 1.0, 0.1)
    light = np.linspace(0.4, 1.0, VGA.width)[:, None]
    assert np.abs(off(SYMMETRIC, T, image=(rendered(SYMMETRIC, T) * light).astype(np.uint8))).max() < 0.1
    inverted = replace(SYMMETRIC, inverted=True)
    assert np.abs(off(inverted, T)).max() < 0.1


def test_a_covered_circle_is_left_out_and_moves_no_other() -> None:
    T = facing(SYMMETRIC, 0.9, 0.4, 1.0, 0.1)
    image, truth = rendered(SYMMETRIC, T), VGA.project(apply(T, SYMMETRIC.pattern().corners))
    x, y = np.round(truth[20]).astype(int).tolist()
    image[y - 12 : y - 4, x - 12 : x + 12] = 200
    found = corner_detector(SYMMETRIC).detect(image)
    assert isinstance(found, CornerLabels), found
    assert found.ids.tolist() == [i for i in range(54) if i != 20]
    assert np.abs(found.pixels - truth[found.ids]).max() < 0.1


def test_another_diameter_than_described_is_said() -> None:
    image = rendered(SYMMETRIC, facing(SYMMETRIC, 0.9, 0.3))
    found = corner_detector(replace(SYMMETRIC, inner_size=0.0175)).detect(image)
    assert isinstance(found, NotDetected)
    assert "times as large as described" in found.reason


@pytest.mark.parametrize("shape", [(0, 0), (1, 1), (3, 40), (40, 3), (100, 100)])
def test_images_without_a_grid(shape: tuple[int, int]) -> None:
    for image in (np.zeros(shape, np.uint8), np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)):
        assert isinstance(corner_detector(SYMMETRIC).detect(image), NotDetected)


def test_what_cannot_be_found_is_refused() -> None:
    with pytest.raises(InputError, match="2 x 6 circles"):
        corner_detector(circles(2, 6, 0.05, 0.03))
    with pytest.raises(InputError, match=r"10 rows, expected an odd number"):
        corner_detector(circles(4, 10, 0.03, 0.02, True))
    with pytest.raises(InputError, match="diameter"):
        corner_detector(replace(SYMMETRIC, inner_size=None))
