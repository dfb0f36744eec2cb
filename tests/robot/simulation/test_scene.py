import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base import InputError
from calibration.base.records import read
from calibration.engine.geometry.transforms import apply, from_xyz_rpy, inverse
from calibration.robot.simulation.scene import GROUND_SURFACE, NO_SURFACE, Board, Box, Light, Scene
from tests.robot.simulation.rendering.views import CHARUCO, CHESSBOARD

BOX = Box(from_xyz_rpy([3.0, 0.0, 1.0], [0.2, -0.3, 0.5]), np.array([1.0, 2.0, 0.6]))


def test_the_ground() -> None:
    scene = Scene(ground=-1.0)
    directions = np.array([[0.0, 0.0, -2.0], [1.0, 0.0, -0.5], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    np.testing.assert_array_equal(scene.cast(np.array([5.0, 5.0, 1.0]), directions), [1, 4, np.inf, np.inf])


def test_no_scene_hides_nothing() -> None:
    scene = Scene()
    assert not scene.hides(np.zeros(3), np.ones((4, 3))).any()
    assert not scene.contains(np.ones((4, 3))).any()


def test_a_hit_lies_on_the_box_and_nothing_of_the_box_before_it() -> None:
    random = np.random.default_rng(1)
    origin, directions = np.zeros(3), random.normal([2, 0, 0.7], size=(4000, 3))
    t = Scene(boxes=(BOX,)).cast(origin, directions)
    hit = np.isfinite(t)
    assert 200 < hit.sum() < 2000

    def inside(points: np.ndarray) -> np.ndarray:
        local = apply(np.linalg.inv(BOX.T_world_box), points)
        return (np.abs(local) / (BOX.size / 2)).max(-1)

    np.testing.assert_allclose(inside(t[hit, None] * directions[hit]), 1, atol=1e-9)
    for share in np.linspace(0.01, 0.99, 30):
        assert (inside(share * t[hit, None] * directions[hit]) > 1).all()
    for far in np.linspace(0, 5, 300):  # rays that miss are never inside
        assert (inside(far * directions[~hit]) > 1 - 1e-9).all()


def test_objects_behind_the_origin_are_not_hit() -> None:
    scene = Scene(boxes=(Box(from_xyz_rpy([-2, 0, 0], [0, 0, 0]), np.ones(3)),))
    assert scene.cast(np.zeros(3), np.array([[1.0, 0, 0], [-1.0, 0, 0]])).tolist() == [np.inf, 1.5]


def test_from_inside_a_box_its_far_side_is_seen() -> None:
    scene = Scene(boxes=(Box(np.eye(4), np.array([2.0, 2.0, 2.0])),))
    assert scene.cast(np.zeros(3), np.array([[1.0, 0, 0]])).tolist() == [1]


def test_the_nearest_counts() -> None:
    near = Box(from_xyz_rpy([2, 0, 0], [0, 0, 0]), np.ones(3))
    far = Box(from_xyz_rpy([5, 0, 0], [0, 0, 0]), np.ones(3))
    ray = np.array([[1.0, 0, 0]])
    for boxes in ((near, far), (far, near)):
        assert Scene(ground=-9.0, boxes=boxes).cast(np.zeros(3), ray).tolist() == [1.5]


@pytest.mark.parametrize(("x", "hidden"), [(1.0, False), (1.49, False), (1.5, False), (1.6, True), (4.0, True)])
def test_objects_behind_are_occluded(x: float, hidden: bool) -> None:
    scene = Scene(boxes=(Box(from_xyz_rpy([2, 0, 0], [0, 0, 0]), np.ones(3)),))
    assert scene.hides(np.zeros(3), np.array([[x, 0.1, 0.1]])).tolist() == [hidden]


def test_batches_of_origins() -> None:
    scene = Scene(ground=0.0, boxes=(BOX,))
    random = np.random.default_rng(2)
    origins, points = random.uniform(0.1, 2, (7, 3)), random.uniform(0.1, 5, (7, 5, 3))
    together = scene.hides(origins, points)
    for i in range(7):
        np.testing.assert_array_equal(together[i], scene.hides(origins[i], points[i]))


def test_containing() -> None:
    scene = Scene(ground=0.0, boxes=(BOX,))
    points = np.array([[3.0, 0, 1], [0, 0, -0.1], [0, 0, 0.1], [9, 9, 9]])
    assert scene.contains(points).tolist() == [True, True, False, False]
    assert scene.contains(points, clearance=0.2).tolist() == [True, True, True, False]


def test_a_hit_has_the_index_of_its_surface() -> None:
    scene = Scene(ground=0.0, boxes=(BOX, Box(from_xyz_rpy([-2, 0, 1], [0, 0, 0]), np.ones(3))))
    origin = np.array([0.0, 0.0, 1.0])
    directions = np.random.default_rng(3).normal(size=(2, 200, 3))
    distance, surface = scene.hit(origin, np.moveaxis(directions, -1, 0))
    np.testing.assert_array_equal(distance, scene.cast(origin, directions))
    assert set(surface.ravel()) == {NO_SURFACE, GROUND_SURFACE, 0, 1}
    np.testing.assert_array_equal(surface == NO_SURFACE, np.isinf(distance))
    first = Scene(boxes=scene.boxes[:1]).cast(origin, directions)
    np.testing.assert_array_equal(first[surface == 0], distance[surface == 0])
    points = origin + distance[surface == GROUND_SURFACE][:, None] * directions[surface == GROUND_SURFACE]
    np.testing.assert_allclose(points[:, 2], 0, atol=1e-12)


def test_light_falls_by_the_cosine_and_never_below_the_ambient() -> None:
    light = Light(ambient=0.3, intensity=0.5, direction=np.array([0.0, 0.0, 7.0]))
    angles = np.linspace(0, math.pi, 9)
    normals = np.column_stack([np.sin(angles), np.zeros(9), np.cos(angles)])
    np.testing.assert_allclose(light.on(normals), 0.3 + 0.5 * np.maximum(np.cos(angles), 0))


def read_scene(**entries: Any) -> Scene:
    return read(Scene, entries, "simulation.yml: scene")


def test_reading_a_scene() -> None:
    empty = read_scene()
    assert (empty.ground, empty.boxes, empty.light.ambient) == (None, (), Light().ambient)
    box = {"centre": [1, 2, 3], "size": [1, 1, 2], "rpy": [0, 0, math.pi / 2], "colour": [255, 0, 10.5]}
    scene = read_scene(ground_m=-0.5, boxes=[box, {"centre": [0, 0, 0], "size": [1, 1, 1]}], light={"ambient": 0})
    assert (scene.ground, len(scene.boxes), scene.light.ambient) == (-0.5, 2, 0)
    assert scene.boxes[0].colour == (255, 0, 10.5)
    assert scene.boxes[1].colour == Box(np.eye(4), np.ones(3)).colour
    np.testing.assert_allclose(scene.boxes[0].T_world_box, from_xyz_rpy([1, 2, 3], [0, 0, math.pi / 2]))
    lit = read_scene(light={"direction": [0, -2, 0], "intensity": 2})
    np.testing.assert_array_equal(lit.light.direction, [0, -2, 0])
    assert lit.light.intensity == 2


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        (
            {"light": {"direction": [0, 0, 0]}},
            "scene: light.direction: found [0, 0, 0], expected a direction [x, y, z] towards",
        ),
        ({"light": {"ambient": -1}}, "scene: light.ambient: found -1, expected a number from 0 to 10"),
        (
            {"light": {"colour": 1}},
            "scene: light: unknown key 'colour' (known: ambient, intensity, direction)",
        ),
        (
            {"boxes": [{"centre": [0, 0, 0], "size": [1, 0, 1]}]},
            "scene: boxes.0.size: found [1, 0, 1], expected three lengths above 0",
        ),
        (
            {"boxes": [{"centre": [0, 0, 0], "size": [1, 1, 1], "colour": [0, 256, 0]}]},
            "scene: boxes.0.colour: found [0, 256, 0], expected three numbers from 0 to 255: red, green, blue",
        ),
        ({"walls": []}, "scene: unknown key 'walls' (known: ground_m, boxes, light)"),
    ],
)
def test_what_is_wrong_with_a_scene_is_named(entries: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as error:
        read_scene(**entries)
    assert message in str(error.value)


T_WORLD_PATTERN = from_xyz_rpy([1.9, 1.0, 1.5], [-1.4, 0.1, -0.8])
BOWS = [(0.0, 0.0), (0.05, 0.0), (0.0, -0.03), (0.04, 0.02), (-0.1, 0.1)]


def board(bow: tuple[float, float] = (0.0, 0.0)) -> Board:
    return Board(CHARUCO, CHARUCO.pattern(), T_WORLD_PATTERN, bow)


def rays(random: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """From a point about 1 m away to points on and around the board, in the world frame."""
    origin = apply(T_WORLD_PATTERN, np.array([[0.4, 0.3, 0.0]]) + random.normal(scale=0.6, size=(1, 3)))[0]
    targets = np.column_stack([random.uniform(-0.2, 1.0, (count, 2)), random.uniform(-0.05, 0.05, count)])
    return origin, apply(T_WORLD_PATTERN, targets) - origin


def test_the_surface_bows_towards_the_viewer_and_keeps_its_corners() -> None:
    pattern = board((0.05, 0.02))
    low, high = pattern.limits
    np.testing.assert_allclose(pattern.surface((low + high) / 2), [*(low + high) / 2, -0.07])
    corners = pattern.surface(pattern.pattern.outline)
    np.testing.assert_allclose(corners[:, 2], 0, atol=1e-15)
    sides = pattern.surface(np.array([[low[0], (low + high)[1] / 2], [(low + high)[0] / 2, low[1]]]))
    np.testing.assert_allclose(sides[:, 2], [-0.02, -0.05])
    np.testing.assert_array_equal(board().surface(np.ones((3, 4, 2)))[..., 2], 0)
    np.testing.assert_allclose(pattern.corners(), board().corners())


@given(st.integers(0, 2**32), st.sampled_from(BOWS))
def test_what_is_hit_lies_on_the_board_and_nothing_of_it_before(seed: int, bow: tuple[float, float]) -> None:
    pattern = board(bow)
    origin, directions = rays(np.random.default_rng(seed), 40)
    t = pattern.cast(origin, directions)
    low, high = pattern.limits
    start, step = apply(inverse(T_WORLD_PATTERN), origin[None])[0], directions @ T_WORLD_PATTERN[:3, :3]
    hit = np.isfinite(t)
    points = start + t[hit, None] * step[hit]
    np.testing.assert_allclose(points, pattern.surface(points[:, :2]), atol=1e-9)
    assert ((points[:, :2] >= low) & (points[:, :2] <= high)).all()
    # walking along each ray: it changes its side of the sheet, inside the border, only where it hits
    share = np.linspace(1e-6, np.where(hit, t * (1 - 1e-9), 5.0), 400, axis=1)
    walked = start + share[..., None] * step[:, None]
    side = walked[..., 2] - pattern.surface(walked[..., :2])[..., 2] > 0
    crosses = side[:, 1:] != side[:, :-1]
    inside = ((walked[..., :2] > low + 0.02) & (walked[..., :2] < high - 0.02)).all(-1)
    assert not (crosses & inside[:, 1:] & inside[:, :-1]).any()


@pytest.mark.parametrize("bow", BOWS)
def test_the_printed_side_is_the_one_towards_minus_z(bow: tuple[float, float]) -> None:
    pattern = board(bow)
    for z, printed in ((-1.0, True), (1.0, False)):
        start = np.array([0.3, 0.2, z])
        targets = np.moveaxis(pattern.surface(np.random.default_rng(0).uniform(0, 0.5, (50, 2))), -1, 0)
        directions = targets - start[:, None]
        t = pattern.meet(start, directions)
        np.testing.assert_allclose(t, 1, atol=1e-9)
        assert (pattern.shows_print(start, directions, t) == printed).all()


def test_rays_along_the_board_miss_it() -> None:
    origin = apply(T_WORLD_PATTERN, np.array([[-1.0, 0.3, -0.1]]))[0]
    for direction in np.eye(3)[:2]:
        assert board().cast(origin, T_WORLD_PATTERN[:3, :3] @ direction) == np.inf


def test_a_bowed_board_hides_its_far_side_from_a_flat_look() -> None:
    """Along the board, below its top: the near flank is hit."""
    pattern = Board(CHESSBOARD, CHESSBOARD.pattern(), np.eye(4), (0.1, 0.0))
    low, high = pattern.limits
    origin = np.array([low[0] - 1.0, (low + high)[1] / 2, -0.05])
    t = pattern.cast(origin, np.array([[1.0, 0.0, 0.0]]))
    x = (low + high)[0] / 2 - (high - low)[0] / 2 * np.sqrt(0.5)
    np.testing.assert_allclose(t, x - origin[0])


@pytest.mark.parametrize("bow", BOWS)
def test_batches_and_lengths_of_directions(bow: tuple[float, float]) -> None:
    origin, directions = rays(np.random.default_rng(7), 24)
    t = board(bow).cast(origin, directions)
    np.testing.assert_array_equal(board(bow).cast(origin, directions.reshape(2, 3, 4, 3)), t.reshape(2, 3, 4))
    np.testing.assert_allclose(board(bow).cast(origin, 4 * directions), t / 4)
    assert 0 < np.isfinite(t).sum() < 24
