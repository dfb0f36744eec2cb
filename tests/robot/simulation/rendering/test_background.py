import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view

from calibration.base.arrays import Array
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import Equidistant, PlumbBob
from calibration.engine.geometry.transforms import from_xyz_rpy
from calibration.robot.simulation.rendering.background import (
    SAMPLES_PER_PIXEL,
    STEPS_PER_GREY_LEVEL,
    background,
    colours,
    rays,
    sample_rays,
)
from calibration.robot.simulation.scene import Box, Light, Scene, turned
from tests.robot.simulation.rendering.views import DISTORTION, EVEN, T_WORLD_CAMERA, camera

CAMERA = camera()
CAMERAS = [CAMERA, camera(distortion=DISTORTION), camera(focal=80, distortion=Equidistant())]
"""The last one sees up to 115 degrees from its axis."""
RED_BOX = Box(T_WORLD_CAMERA @ from_xyz_rpy([0, 0, 2.5], [0, 0, 0]), np.array([1.0, 1.0, 1.0]), (200.0, 100.0, 50.0))


def levels(scene: Scene) -> np.ndarray:
    return background(CAMERA, T_WORLD_CAMERA, scene).radiance / STEPS_PER_GREY_LEVEL


def test_a_box_has_its_colour_and_its_depth() -> None:
    seen = background(CAMERA, T_WORLD_CAMERA, Scene(boxes=(RED_BOX,), light=EVEN))
    np.testing.assert_array_equal(seen.radiance[120, 160] / STEPS_PER_GREY_LEVEL, [50, 100, 200])  # blue first
    assert seen.depth[120, 160] == pytest.approx(2.0)
    assert np.isinf(seen.depth[0, 0])
    np.testing.assert_array_equal(
        seen.radiance[45:195, 86:234].reshape(-1, 3), np.tile(seen.radiance[120, 160], (150 * 148, 1))
    )


def test_the_edge_of_a_box_is_as_fine_as_samples() -> None:
    left = levels(Scene(boxes=(RED_BOX,), light=EVEN))[120, 80:90]
    shares = (left[:, 2] - left[0, 2]) / (left[-1, 2] - left[0, 2])
    edge = 159.5 - 300 * 0.5 / 2.0
    assert 80 + (1 - shares).sum() - 0.5 == pytest.approx(edge, abs=1 / 32)
    assert ((shares > 0) & (shares < 1)).sum() <= 1


def test_every_face_is_lit_by_its_own_normal() -> None:
    box = Box(from_xyz_rpy([2.5, 0.4, 0.4], [0, 0, 0.6]), np.array([1.0, 1.0, 1.0]), (200.0, 200.0, 200.0))
    normals = {
        "side": [-np.sin(0.6), np.cos(0.6), 0.0],
        "other side": [-np.cos(0.6), -np.sin(0.6), 0.0],
        "top": [0, 0, 1.0],
    }
    for direction in normals.values():
        light = Light(0.1, 0.8, np.array(direction))
        seen = set(np.round(levels(Scene(boxes=(box,), light=light))[..., 0].ravel(), 2).tolist())
        for normal in normals.values():
            expected = 200 * (0.1 + 0.8 * max(0.0, float(np.dot(direction, normal))))
            assert min(abs(value - expected) for value in seen) < 0.02


def test_from_inside_a_box_its_faces_are_lit_from_inside() -> None:
    room = Box(T_WORLD_CAMERA, np.array([4.0, 4.0, 4.0]), (100.0, 100.0, 100.0))
    towards_camera = -T_WORLD_CAMERA[:3, 2]
    assert levels(Scene(boxes=(room,), light=Light(0.2, 0.5, towards_camera)))[120, 160, 0] == pytest.approx(
        70, abs=0.02
    )
    assert levels(Scene(boxes=(room,), light=Light(0.2, 0.5, -towards_camera)))[120, 160, 0] == pytest.approx(
        20, abs=0.02
    )


def test_the_ground_is_not_of_one_shade_and_of_low_contrast() -> None:
    ground = levels(Scene(ground=0.0, light=EVEN))[130:]
    assert 1 < ground[..., 1].std() < 10
    assert np.ptp(ground[..., 1]) < 20


def test_darkness_is_dark() -> None:
    assert not levels(Scene(ground=0.0, boxes=(RED_BOX,), light=Light(0.0, 0.0))).any()


def test_where_the_lens_shows_nothing_it_is_black() -> None:
    folding = camera(320, 240, 100, PlumbBob(-0.45, 0.0, 0.0, 0.0, 0.0))
    seen = background(folding, T_WORLD_CAMERA, Scene(ground=0.0))
    assert not seen.radiance[0, 0].any()
    assert np.isinf(seen.depth[0, 0])
    assert seen.radiance[120, 160].all()


def test_a_fixed_camera_has_one_cached_read_only_background() -> None:
    scene = Scene(ground=0.0)
    seen = background(CAMERA, T_WORLD_CAMERA, scene)
    assert background(CAMERA, T_WORLD_CAMERA.copy(), scene) is seen
    assert background(CAMERA, from_xyz_rpy([1, 0, 0], [0, 0, 0]) @ T_WORLD_CAMERA, scene) is not seen
    assert background(CAMERA, T_WORLD_CAMERA, Scene(ground=0.0)) is not seen
    with pytest.raises(ValueError, match="read-only"):
        seen.radiance[0, 0] = 0


def seen_along(rays_: Array, T: Array, scene: Scene) -> Array:
    """Colours (3, ...) along rays (3, ...), each intersected with the whole scene."""
    world = turned(T, rays_.reshape(3, -1))
    return colours(scene, T[:3, 3], world, *scene.hit(T[:3, 3], world)).reshape(rays_.shape)


def in_steps(colour: Array) -> np.ndarray:
    return np.rint(np.clip(colour.astype(np.float32) * STEPS_PER_GREY_LEVEL, 0, 65535))


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("of", CAMERAS)
def test_every_pixel_has_the_colour_that_its_own_rays_see(of: Camera) -> None:
    """Each sample is intersected with the whole scene."""
    random = np.random.default_rng(6)
    for number in range(6):
        boxes = tuple(
            Box(from_xyz_rpy(random.normal(scale=3, size=3), random.uniform(-3, 3, 3)), random.uniform(0.05, 4, 3))
            for _ in range(5)
        )
        scene = Scene(ground=-1.0, boxes=boxes, light=Light(0.5, 0.2 * number))
        T = from_xyz_rpy(random.normal(scale=0.5, size=3), random.uniform(-3, 3, 3))
        centres = np.moveaxis(seen_along(rays(of)[:, 1:-1, 1:-1], T, scene), 0, -1)
        levels = np.pad(np.clip(centres.astype(np.float32), 0, 255).astype(int), ((1, 1), (1, 1), (0, 0)), mode="edge")
        around = sliding_window_view(levels, (3, 3), axis=(0, 1))
        rows, columns = np.nonzero((np.ptp(around, axis=(-2, -1)) > 6).any(axis=-1))
        expected = in_steps(centres)
        expected[rows, columns] = in_steps(
            seen_along(sample_rays(of, rows, columns), T, scene).sum(axis=1) / SAMPLES_PER_PIXEL
        ).T
        assert len(rows) > 500
        np.testing.assert_array_equal(background(of, T, scene).radiance, expected)


@pytest.mark.parametrize("of", CAMERAS)
def test_every_pixel_sees_what_its_own_ray_hits(of: Camera) -> None:
    random = np.random.default_rng(5)
    directions = rays(of)[:, 1:-1, 1:-1]
    for _ in range(6):
        boxes = tuple(
            Box(from_xyz_rpy(random.normal(scale=3, size=3), random.uniform(-3, 3, 3)), random.uniform(0.05, 4, 3))
            for _ in range(5)
        )
        scene = Scene(ground=-1.0, boxes=boxes)
        T = from_xyz_rpy(random.normal(scale=0.5, size=3), random.uniform(-3, 3, 3))
        seen = background(of, T, scene).depth
        world = np.moveaxis(turned(T, directions), 0, -1)
        np.testing.assert_array_equal(seen, scene.cast(T[:3, 3], world))
