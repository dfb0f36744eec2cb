import numpy as np
import pytest

from calibration.base.arrays import Array
from calibration.engine.geometry.transforms import from_xyz_rpy
from calibration.robot.simulation.rendering.facets import UNKNOWN_FACET, Bounds, Sight, facets
from calibration.robot.simulation.scene import GROUND_SURFACE, NO_SURFACE, Box, Scene, turned
from tests.robot.simulation.rendering.views import T_WORLD_CAMERA

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
