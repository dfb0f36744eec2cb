import numpy as np
import pytest

from calibration.base.arrays import Array
from calibration.engine.geometry.lenses import Equidistant, PlumbBob, Rational
from calibration.engine.geometry.transforms import from_xyz_rpy
from calibration.robot.simulation.rendering.rays import (
    CELL_SIZE,
    SAMPLES_PER_PIXEL,
    UNKNOWN_FACET,
    Bounds,
    Sight,
    cells,
    facets,
    in_cells,
    rays,
    rounded,
    sample_rays,
)
from calibration.robot.simulation.scene import GROUND_SURFACE, NO_SURFACE, Box, Scene, turned
from tests.robot.simulation.rendering.views import DISTORTION, T_WORLD_CAMERA, camera

CUBE = Box(T_WORLD_CAMERA @ from_xyz_rpy([0, 0, 3], [0, 0, 0]), np.array([1.0, 1.0, 1.0]))
WALL = Box(T_WORLD_CAMERA @ from_xyz_rpy([0, 0, 5], [0, 0, 0]), np.array([9.0, 9.0, 0.1]))


def random_scene(random: np.random.Generator) -> Scene:
    boxes = tuple(
        Box(from_xyz_rpy(random.normal(scale=2, size=3), random.uniform(-3, 3, 3)), random.uniform(0.05, 3, 3))
        for _ in range(4)
    )
    return Scene(ground=-1.5, boxes=boxes)


def bundles(random: np.random.Generator, count: int) -> Array:
    """Rays (3, N, 50) around N random ones."""
    xy = random.uniform(-1, 1, (2, count, 1)) + random.uniform(0.01, 0.2, (count, 1)) * random.uniform(
        -1, 1, (2, count, 50)
    )
    return np.concatenate([xy, np.ones((1, count, 50))])


def seen(scene: Scene, T: Array, rays: Array) -> tuple[Sight, Array, Array]:
    """What is seen in the rectangles around bundles of rays, and the facets and depths that each ray hits."""
    some = facets(scene, T)
    sight = Sight.of(some, Bounds.of(rays))
    hit, _ = sight.hit(rays, np.arange(rays.shape[1]))
    world, depth = turned(T, rays), np.full(hit.shape, np.inf)
    for index, facet in enumerate(some):
        depth[hit == index] = facet.distance(scene, T[:3, 3], world[:, hit == index])
    return sight, hit, depth


def surfaces(scene: Scene, T: Array, hit: Array) -> Array:
    """The surfaces of facets."""
    of = [facet.surface for facet in facets(scene, T)]
    found: Array = np.array([*of, NO_SURFACE])[hit]
    return found


def test_rays_hit_what_they_hit_in_the_scene_at_the_same_distance() -> None:
    random, decided, hits = np.random.default_rng(1), 0, set()
    for _ in range(40):
        scene, rays = random_scene(random), bundles(random, 30)
        T = from_xyz_rpy(random.normal(scale=1.5, size=3), random.uniform(-3, 3, 3))
        _, hit, depth = seen(scene, T, rays)
        distance, surface = scene.hit(T[:3, 3], turned(T, rays))
        known = hit != UNKNOWN_FACET
        np.testing.assert_array_equal(surfaces(scene, T, hit)[known], surface[known])
        np.testing.assert_array_equal(depth[known], distance[known])
        decided += int(known.sum())
        hits |= set(surface[known].tolist())
    assert decided > 0.999 * 40 * 30 * 50
    assert hits == {NO_SURFACE, GROUND_SURFACE, 0, 1, 2, 3}


def test_where_only_one_is_seen_every_ray_hits_it_and_none_is_nearer_than_the_bound() -> None:
    random, alone, share = np.random.default_rng(2), 0, []
    for _ in range(40):
        scene, rays = random_scene(random), bundles(random, 30)
        T = from_xyz_rpy(random.normal(scale=1.5, size=3), random.uniform(-3, 3, 3))
        sight, hit, _ = seen(scene, T, rays)
        distance, surface = scene.hit(T[:3, 3], turned(T, rays))
        only = sight.only != UNKNOWN_FACET
        np.testing.assert_array_equal(surface[only], surfaces(scene, T, sight.only[only, None].repeat(50, axis=1)))
        assert (distance.min(axis=1) >= sight.depth).all()
        alone += int(only.sum())
        near = np.isfinite(sight.depth)
        share += (sight.depth[near] / distance.min(axis=1)[near]).tolist()
        assert not (~sight.may[hit, np.arange(30)[:, None]] & (hit != UNKNOWN_FACET)).any()
    assert alone > 300
    assert np.median(share) > 0.7


def test_rays_within_the_limit_of_another_hit_the_same() -> None:
    random, within, share = np.random.default_rng(7), 0, []
    for _ in range(40):
        scene, rays = random_scene(random), bundles(random, 30)
        T = from_xyz_rpy(random.normal(scale=1.5, size=3), random.uniform(-3, 3, 3))
        hit, limit = Sight.of(facets(scene, T), Bounds.of(rays)).hit(rays, np.arange(30))
        apart = np.abs(rays[:2, :, :, None] - rays[:2, :, None]).max(axis=0)
        near = (apart < limit[..., None]) & (hit[:, None] != UNKNOWN_FACET)
        assert (hit[..., None] == hit[:, None])[near].all()
        within += int(near.sum())
        other = np.where(hit[..., None] != hit[:, None], apart, np.inf).min(axis=2)
        seen = np.isfinite(other)
        share += (limit[seen] / other[seen]).tolist()
    assert within > 0.1 * 40 * 30 * 50 * 50
    assert np.median(share) > 0.1


def test_on_an_edge_nothing_is_decided() -> None:
    along, beside = np.linspace(-0.19, 0.19, 9), np.full(9, 0.2)  # its front is 2.5 m away
    xy = np.concatenate([(along, beside), (along, -beside), (beside, along), (-beside, along)], axis=1)
    xy = np.concatenate([xy, xy + 1e-12, xy - 1e-12], axis=1)
    rays = np.concatenate([xy, np.ones((1, xy.shape[1]))])[..., None]
    for boxes in ((CUBE,), (CUBE, WALL), (WALL, CUBE)):
        assert (seen(Scene(boxes=boxes), T_WORLD_CAMERA, rays)[1] == UNKNOWN_FACET).all()


def test_a_face_is_alone_before_what_it_hides() -> None:
    rays = bundles(np.random.default_rng(6), 40)
    (front,) = np.nonzero((np.abs(rays[:2]) < 0.199).all(axis=(0, 2)))
    for boxes in ((CUBE, WALL), (WALL, CUBE)):
        scene = Scene(boxes=boxes)
        sight, _, _ = seen(scene, T_WORLD_CAMERA, rays[:, front])
        assert set(surfaces(scene, T_WORLD_CAMERA, sight.only)) == {boxes.index(CUBE)}


def test_equal_depths_are_not_decided() -> None:
    for boxes, hit in (((CUBE,), 0), ((CUBE, CUBE), UNKNOWN_FACET)):
        assert seen(Scene(boxes=boxes), T_WORLD_CAMERA, np.array([0.1, 0, 1.0]).reshape(3, 1, 1))[1].item() == hit


@pytest.mark.parametrize("place", [(0.5, 0.0), (0.5, 0.5), (0.5, 0.2)])
@pytest.mark.parametrize("pitch", [1.5, -1.5])
def test_a_camera_on_a_box_decides_nothing_of_it(place: tuple[float, float], pitch: float) -> None:
    """It looks away from the box, and into it."""
    scene = Scene(boxes=(Box(np.eye(4), np.ones(3)),))
    T = from_xyz_rpy([*place, 0.1], [0.1, pitch, 0.2])
    sight, hit, _ = seen(scene, T, bundles(np.random.default_rng(3), 20))
    assert (hit == UNKNOWN_FACET).all()
    assert np.isnan(sight.depth).all()


def test_a_camera_in_the_plane_of_a_face_decides_all_but_what_that_face_may_hide() -> None:
    scene, rays = Scene(boxes=(CUBE,)), bundles(np.random.default_rng(4), 200)
    T = T_WORLD_CAMERA @ from_xyz_rpy([0.5, 0, 0], [0, 0, 0])
    _, hit, _ = seen(scene, T, rays)
    known = hit != UNKNOWN_FACET
    assert 0.8 < known.mean() < 1
    assert (surfaces(scene, T, hit)[known] == 0).mean() > 0.01
    np.testing.assert_array_equal(surfaces(scene, T, hit)[known], scene.hit(T[:3, 3], turned(T, rays))[1][known])


def test_rays_of_which_nothing_is_known_are_not_decided() -> None:
    rays = np.full((3, 1, 2), np.nan)
    assert (seen(Scene(ground=0.0, boxes=(CUBE,)), T_WORLD_CAMERA, rays)[1] == UNKNOWN_FACET).all()


def test_without_a_scene_there_is_the_sky() -> None:
    sight, hit, _ = seen(Scene(), T_WORLD_CAMERA, bundles(np.random.default_rng(5), 3))
    assert (sight.only == 0).all()
    assert (hit == 0).all()
    assert np.isinf(sight.depth).all()


@pytest.mark.parametrize("turn", [0.4, 1.0, 1.3])
def test_the_limit_holds_where_two_steep_walls_cross(turn: float) -> None:
    """Their nearnesses change the most from ray to ray, in opposite directions."""
    walls = [
        Box(T_WORLD_CAMERA @ from_xyz_rpy([0, 0, 3], [0, sign * turn, 0]), np.array([9.0, 9.0, 0.1]))
        for sign in (1, -1)
    ]
    scene = Scene(boxes=tuple(walls))
    xy = np.random.default_rng(8).uniform(-0.05, 0.05, (2, 1, 400))
    rays = np.concatenate([xy, np.ones((1, 1, 400))])
    hit, limit = Sight.of(facets(scene, T_WORLD_CAMERA), Bounds.of(rays)).hit(rays, np.arange(1))
    apart = np.abs(rays[:2, :, :, None] - rays[:2, :, None]).max(axis=0)
    near = (apart < limit[..., None]) & (hit[:, None] != UNKNOWN_FACET)
    assert len(set(hit.ravel().tolist()) - {UNKNOWN_FACET}) > 1
    assert (hit[..., None] == hit[:, None])[near].all()


def test_rays_of_pixels_and_of_one_more_on_each_side() -> None:
    for distortion in (PlumbBob(), DISTORTION, Rational(0.2, 0.1, k4=0.4), Equidistant(-0.02, 0.01)):
        of = camera(20, 10, 15, distortion)
        found = rays(of)
        assert found.shape == (3, 12, 22)
        pixels = of.project(np.moveaxis(found, 0, -1))
        v, u = np.mgrid[-1:11, -1:21]
        np.testing.assert_allclose(pixels, np.stack([u, v], -1), atol=1e-9)


def test_no_ray_where_the_lens_shows_nothing() -> None:
    found = rays(camera(320, 240, 100, PlumbBob(-0.45, 0.0, 0.0, 0.0, 0.0)))
    assert np.isnan(found[:, 0, 0]).all()
    np.testing.assert_array_equal(found[2, 100:140, 140:180], 1)


def test_a_fisheye_lens_shows_what_lies_before_the_camera_and_beside_it() -> None:
    """Rays up to pi from the axis: a circle of 314 pixels for a focal length of 100."""
    found = rays(camera(700, 700, 100, Equidistant()))
    v, u = np.mgrid[-1:701, -1:701] - 349.5
    radius = np.hypot(u, v)
    np.testing.assert_array_equal(np.isfinite(found[0]), radius < 100 * np.pi)
    front, behind = radius < 150, (radius > 50 * np.pi) & (radius < 100 * np.pi)
    np.testing.assert_allclose(np.hypot(found[0], found[1])[front], np.tan(radius[front] / 100), rtol=1e-9)
    np.testing.assert_array_equal(found[2][front], 1)
    np.testing.assert_allclose(found[2][behind], np.cos(radius[behind] / 100), atol=1e-9)


def test_samples_lie_evenly_in_their_pixel() -> None:
    of = camera(20, 10, 15)
    rows, columns = np.array([3, 7]), np.array([0, 19])
    pixels = of.project(np.moveaxis(sample_rays(of, rows, columns), 0, -1))
    offset = pixels - np.stack([columns, rows], -1)
    assert offset.shape == (SAMPLES_PER_PIXEL, 2, 2)
    for axis in range(2):
        np.testing.assert_allclose(np.sort(offset[:, 0, axis]), (np.arange(16) - 7.5) / 16, atol=1e-9)
    fields = np.floor((offset[:, 0] + 0.5) * 4) @ [4, 1]
    assert sorted(fields) == list(range(16))
    np.testing.assert_allclose(np.sort(-offset[:, 0], axis=0), np.sort(offset[:, 0], axis=0), atol=1e-9)


def test_cells_cover_the_image_and_the_samples_of_its_pixels() -> None:
    for distortion in (PlumbBob(), DISTORTION):
        of = camera(50, 30, 40, distortion)
        found, (rows, columns) = cells(of), np.mgrid[:30, :50].reshape(2, -1)
        cell, samples = found.of_pixels(rows, columns), sample_rays(of, rows, columns)
        assert set(cell.tolist()) == set(range(found.rays.shape[1]))
        low, high = found.bounds.middle - found.bounds.half, found.bounds.middle + found.bounds.half
        assert ((samples[:2] >= low[:, None, cell]) & (samples[:2] <= high[:, None, cell])).all()
        reach = (
            np.abs(samples[:2] - rays(of)[:2, None, 1:-1, 1:-1].reshape(2, 1, -1)).max(axis=(0, 1)) / found.reach[cell]
        )
        assert reach.min() > 0.6
        assert reach.max() < 1
        for row, column in ((0, 0), (17, 23), (29, 49)):
            of_cell = found.rays[:, found.of_pixels(np.array(row), np.array(column))]
            assert (of_cell == rays(of)[:, row + 1, column + 1, None]).all(axis=0).any()
            part = found.around((slice(row, row + 1), slice(column, column + 1)))
            assert np.arange(len(found.bounds.margin)).reshape(found.shape)[part] == [[found.of_pixels(row, column)]]


def test_an_image_is_viewed_in_cells() -> None:
    image = np.arange(2 * CELL_SIZE[0] * 3 * CELL_SIZE[1]).reshape(2 * CELL_SIZE[0], 3 * CELL_SIZE[1])
    view = in_cells(image)
    assert view.shape == (2, 3, *CELL_SIZE)
    np.testing.assert_array_equal(view[1, 2], image[CELL_SIZE[0] :, 2 * CELL_SIZE[1] :])
    view[0, 1] = -1
    assert (image[: CELL_SIZE[0], CELL_SIZE[1] : 2 * CELL_SIZE[1]] == -1).all()


def test_a_pose_is_rounded_to_a_picometre() -> None:
    pose = np.round(T_WORLD_CAMERA, 9)
    np.testing.assert_array_equal(rounded(pose + 4e-13), rounded(pose))
    np.testing.assert_allclose(rounded(T_WORLD_CAMERA), T_WORLD_CAMERA, rtol=0, atol=1e-12)
