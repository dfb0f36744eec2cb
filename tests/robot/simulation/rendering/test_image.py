from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.lib.stride_tricks import sliding_window_view

from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import PlumbBob
from calibration.engine.geometry.transforms import apply, from_xyz_rpy
from calibration.robot.simulation.kinematics import stream
from calibration.robot.simulation.rendering.image import BACK_REFLECTANCE
from calibration.robot.simulation.rendering.texture import INK_REFLECTANCE, PAPER_REFLECTANCE
from calibration.robot.simulation.scene import Board, Box, Light, Scene
from tests.properties import at_most
from tests.robot.simulation.rendering.views import (
    CHARUCO,
    CHESSBOARD,
    DARK,
    DISTORTION,
    EVEN,
    T_WORLD_CAMERA,
    board,
    camera,
    perfect,
    random_pose,
    square_on,
)

BRIGHT = Scene(light=EVEN)
CAMERA = camera()


def render(boards: list[Board], scene: Scene = BRIGHT, of: object = CAMERA) -> np.ndarray:
    """The green of what a perfect camera sees, as numbers."""
    return perfect(of).render(T_WORLD_CAMERA, scene, boards, stream(0))[..., 1].astype(float)  # type: ignore[arg-type]


def crossing(profile: np.ndarray) -> float:
    """Position of the step in a rising or falling profile of pixels, by its area: exact for box-shaped pixels."""
    low, high = profile[0], profile[-1]
    return float(((high - profile) / (high - low)).sum() - 0.5)


def test_edges_of_squares_are_where_they_are_projected() -> None:
    """A chessboard 0.9 m away: an edge between two columns of squares crosses the rows at one x."""
    T = square_on(CHESSBOARD, 0.0137, -0.0071, 0.9)
    image = render([board(T, CHESSBOARD)])
    u = CAMERA.project(apply(T, CHESSBOARD.pattern().corners))
    for row in range(5):
        for column in range(9):
            (x, y), half = u[row * 9 + column], 13
            middle = round(y + half)
            across = image[middle, round(x) - 10 : round(x) + 11]
            assert sorted({across[0], across[-1]}) == [INK_REFLECTANCE, PAPER_REFLECTANCE]
            assert round(x) - 10 + crossing(across) == pytest.approx(x, abs=0.02)
            middle = round(x + half)
            down = image[round(y) - 10 : round(y) + 11, middle]
            assert round(y) - 10 + crossing(down) == pytest.approx(y, abs=0.02)


def test_the_border_is_where_it_is_projected() -> None:
    T = square_on(CHARUCO, 0.0137, -0.0071, 1.1)
    image = render([board(T)], Scene(light=Light(1.0, 0.0), boxes=(wall(3.0, (0, 0, 0)),)))
    outline = CAMERA.project(apply(T, np.column_stack([CHARUCO.pattern().outline, np.zeros(4)])))
    (left, top), (right, bottom) = outline[0], outline[2]
    x, y = [round(left) - 4, round(right) - 3], [round(top) - 4, round(bottom) - 3]
    found = [crossing(image[120, start : start + 8]) + start for start in x]
    found += [crossing(image[start : start + 8, 130]) + start for start in y]
    np.testing.assert_allclose(found, [left, right, top, bottom], atol=1 / 32 + 0.003)


def wall(x: float, colour: tuple[float, float, float], size: float = 40.0) -> Box:
    """A wall across the view, its face x in front of the camera."""
    return Box(T_WORLD_CAMERA @ from_xyz_rpy([0, 0, x + 0.5], [0, 0, 0]), np.array([size, size, 1.0]), colour)


def test_one_pixel_to_the_right_is_the_image_one_pixel_to_the_right() -> None:
    scene = Scene(light=EVEN, boxes=(wall(3.0, (90, 90, 90)),))
    here, there = (render([board(square_on(CHARUCO, 0.02 + shift, 0.01, 1.0))], scene) for shift in (0.0, 1 / 300))
    assert np.abs(there[:, 1:] - here[:, :-1]).max() <= 6  # samples between texels round
    assert np.abs(there[:, 1:] - here[:, :-1]).mean() < 0.1


def test_a_common_motion_of_the_scene_and_the_camera_changes_nothing() -> None:
    box = Box(from_xyz_rpy([3, 0.3, 1], [0.3, 0.1, 0.2]), np.ones(3))
    scene = Scene(light=Light(0.5, 0.5), boxes=(box, wall(5.0, (50, 60, 70))))  # no sky: it stays above
    moved = from_xyz_rpy([5, -3, 2], [0.4, -1.2, 2.0])
    T = T_WORLD_CAMERA @ random_pose(np.random.default_rng(1), CHARUCO, 1.0, 1.2)
    turned_scene = Scene(
        light=replace(scene.light, direction=moved[:3, :3] @ scene.light.direction),
        boxes=tuple(replace(box, T_world_box=moved @ box.T_world_box) for box in scene.boxes),
    )
    here = perfect(CAMERA).render(T_WORLD_CAMERA, scene, [Board(CHARUCO, CHARUCO.pattern(), T)], stream(0))
    there = perfect(CAMERA).render(
        moved @ T_WORLD_CAMERA, turned_scene, [Board(CHARUCO, CHARUCO.pattern(), moved @ T)], stream(0)
    )
    difference = np.abs(here.astype(int) - there)
    assert difference.max() <= 1
    assert (difference > 0).mean() < 1e-3


@pytest.mark.parametrize("distortion", [PlumbBob(), DISTORTION])
def test_an_image_is_the_mean_of_a_four_times_finer_one(distortion: PlumbBob) -> None:
    """Also where a pattern, a bowed one behind it, a box and the background meet."""
    coarse, fine = camera(160, 120, 150, distortion), camera(640, 480, 600, distortion)
    box = Box(T_WORLD_CAMERA @ from_xyz_rpy([0.1, 0.0, 0.7], [0.3, 0.2, 0.5]), np.array([0.05, 0.3, 0.05]), (90, 9, 9))
    scene = Scene(ground=0.0, boxes=(box, wall(4.0, (60, 60, 60), 3.0)), light=EVEN)
    random = np.random.default_rng(2)
    boards = [
        board(random_pose(random, CHARUCO, 0.9, 1.0)),
        board(random_pose(random, CHESSBOARD, 1.2, 1.4), CHESSBOARD, bow=(0.05, 0.02)),
    ]
    small, large = render(boards, scene, coarse), render(boards, scene, fine)
    difference = small - large.reshape(120, 4, 160, 4).mean(axis=(1, 3))
    assert np.abs(difference).mean() < 0.9
    assert np.abs(difference).max() < 55  # the texels of the small image are as wide as its samples
    assert abs(difference.mean()) < 0.1


def test_nearer_objects_occlude() -> None:
    T = square_on(CHESSBOARD, 0, 0, 1.0)
    box = Box(T_WORLD_CAMERA @ from_xyz_rpy([0.05, 0, 0.6], [0, 0, 0]), np.array([0.08, 0.3, 0.02]), (120, 120, 120))
    behind = replace(box, T_world_box=T_WORLD_CAMERA @ from_xyz_rpy([0.05, 0, 1.2], [0, 0, 0]))
    free, hidden = (render([board(T, CHESSBOARD)], Scene(boxes=(b,), light=EVEN)) for b in (behind, box))
    left, right = 159.5 + 300 * np.array([0.01, 0.09]) / 0.59
    top, bottom = 119.5 + 300 * np.array([-0.15, 0.15]) / 0.59
    inside = np.zeros(free.shape, bool)
    inside[int(top) + 2 : int(bottom), int(left) + 2 : int(right)] = True
    assert (hidden[inside] == 120).all()
    assert np.isin(free[inside], 120).mean() < 0.01
    near = np.zeros(free.shape, bool)
    near[int(top) - 1 : int(bottom) + 3, int(left) - 1 : int(right) + 3] = True
    np.testing.assert_array_equal(hidden[~near], free[~near])


def test_the_edge_of_what_hides_is_as_fine_as_samples() -> None:
    white = board(square_on(CHESSBOARD, 0, 0, 1.0), replace(CHESSBOARD, border_size=(1.0, 1.0)))
    for share in (0.0, 0.25, 0.5, 0.75):
        edge = (120 - 0.5 + share - 119.5) / 300 * 0.5  # so much of row 120 is above it
        box = Box(
            T_WORLD_CAMERA @ from_xyz_rpy([0, edge + 0.5, 0.5 + 0.005], [0, 0, 0]), np.array([1, 1, 0.01]), (0, 0, 0)
        )
        image = render([white], Scene(boxes=(box,), light=EVEN))
        assert image[120, 30] == pytest.approx(PAPER_REFLECTANCE * share, abs=2)
        assert image[119, 30] == PAPER_REFLECTANCE
        assert image[121, 30] == 0


def test_of_two_patterns_the_nearer_is_seen_in_any_order() -> None:
    near = board(square_on(CHESSBOARD, 0.1, 0.0, 1.0), CHESSBOARD)
    far = board(square_on(CHARUCO, 0.4, 0.2, 1.5))
    together = render([near, far])
    np.testing.assert_array_equal(together, render([far, near]))
    alone = render([near])
    inside = np.zeros(alone.shape, bool)
    inside[60:180, 100:250] = True
    np.testing.assert_array_equal(together[inside], alone[inside])
    assert not np.array_equal(together, alone)


def test_two_patterns_through_each_other_both_show() -> None:
    turned = T_WORLD_CAMERA @ square_on(CHARUCO, 0, 0, 1.2) @ from_xyz_rpy([0.4, 0, 0], [0, 0.5, 0])
    pair = [board(square_on(CHARUCO, 0, 0, 1.2)), Board(CHARUCO, CHARUCO.pattern(), turned)]
    image = render(pair)
    singles = [render([b]) for b in pair]
    same = [(image == single)[80:160, 100:220] for single in singles]
    assert (same[0] | same[1]).mean() > 0.97
    assert min(s.mean() for s in same) < 0.9


def test_the_back_is_plain() -> None:
    T = square_on(CHARUCO, 0, 0, 1.0)
    T[:3, :3] = np.diag([-1.0, 1.0, -1.0])
    T[0, 3] = CHARUCO.pattern().outline.mean(axis=0)[0]
    image = render([board(T)])
    assert (image[60:180, 80:240] == BACK_REFLECTANCE).all()


def test_the_back_is_lit_from_behind() -> None:
    T = square_on(CHARUCO, 0, 0, 1.0) @ from_xyz_rpy([CHARUCO.pattern().outline[1, 0], 0, 0], [0, np.pi, 0])
    for direction, level in ((-T_WORLD_CAMERA[:3, 2], 0.9), (T_WORLD_CAMERA[:3, 2], 0.2)):
        image = render([board(T)], Scene(light=Light(0.2, 0.7, direction)))
        assert image[120, 160] == pytest.approx(BACK_REFLECTANCE * level, abs=0.5)


def test_light_from_a_direction_obeys_lambert() -> None:
    for angle in (0.0, 0.5, 1.0):
        light = Light(0.2, 0.7, T_WORLD_CAMERA[:3, :3] @ [0, -3 * np.sin(angle), -3 * np.cos(angle)])
        image = render([board(square_on(CHESSBOARD, 0, 0, 1.0), CHESSBOARD)], Scene(light=light))
        factor = 0.2 + 0.7 * np.cos(angle)
        values = set(image[100:140, 120:200].ravel().tolist())
        assert {round(INK_REFLECTANCE * factor), round(PAPER_REFLECTANCE * factor)} <= values
    behind = Light(0.2, 0.7, T_WORLD_CAMERA[:3, 2])  # it lights the back
    assert render([board(square_on(CHESSBOARD, 0, 0, 1.0))], Scene(light=behind)).max() <= PAPER_REFLECTANCE


def test_the_usual_light_leaves_room_for_noise() -> None:
    for direction in np.concatenate([np.eye(3), -np.eye(3)]):
        level = Light().on(direction)
        assert INK_REFLECTANCE * level > 15
        assert PAPER_REFLECTANCE * level < 250


def test_a_bow_moves_the_middle_and_not_the_border() -> None:
    T = square_on(CHESSBOARD, 0.0, 0.0, 1.0)
    pattern = CHESSBOARD.pattern()
    bowed = board(T, CHESSBOARD, bow=(0.05, 0.03))
    image, flat = render([bowed]), render([board(T, CHESSBOARD)])
    corners = bowed.surface(pattern.corners[:, :2])
    u, unbowed = CAMERA.project(apply(T, corners)), CAMERA.project(apply(T, pattern.corners))
    assert np.linalg.norm(u - unbowed, axis=-1).max() > 3
    for x, y in u[::5]:  # the four squares around a corner are where the bowed corner is
        around = image[round(y) - 6 : round(y) + 7, round(x) - 6 : round(x) + 7]
        assert around[0, 0] == around[-1, -1] != around[0, -1] == around[-1, 0]
    outline = CAMERA.project(apply(T, np.column_stack([pattern.outline, np.zeros(4)])))
    (left, top), (right, bottom) = outline[0].round().astype(int), outline[2].round().astype(int)
    for row in (top, bottom):  # the ends of the border stay, its middle comes nearer
        np.testing.assert_allclose(image[row, [left + 1, right - 1]], flat[row, [left + 1, right - 1]], atol=10)
    assert image[top - 2, 160] == PAPER_REFLECTANCE > flat[top - 2, 160]
    assert image[120, left - 2] == PAPER_REFLECTANCE > flat[120, left - 2]


def test_the_same_from_the_same_seed_and_from_a_fresh_cache() -> None:
    random = np.random.default_rng(5)
    sensor = replace(perfect(CAMERA), noise=2.0, blur=0.6)
    pattern = board(random_pose(random, CHARUCO, 1.0, 1.5))
    first = sensor.render(T_WORLD_CAMERA, Scene(ground=0.0), [pattern], stream(4))
    again = sensor.render(T_WORLD_CAMERA.copy(), Scene(ground=0.0), [pattern], stream(4))
    other = sensor.render(T_WORLD_CAMERA, Scene(ground=0.0), [pattern], stream(5))
    assert first.dtype == np.uint8
    assert first.shape == (240, 320, 3)
    np.testing.assert_array_equal(first, again)
    assert (first != other).mean() > 0.3


def test_the_last_bits_of_poses_do_not_show() -> None:
    T = random_pose(np.random.default_rng(6), CHARUCO, 1.0, 1.5)
    nudged = T * (1 + 1e-15)
    scene = Scene(ground=0.0)
    for a, b in (([board(T)], [board(nudged)]), ([], [])):
        first = perfect(CAMERA).render(T_WORLD_CAMERA, scene, a, stream(0))
        second = perfect(CAMERA).render(T_WORLD_CAMERA * (1 - 1e-16), scene, b, stream(0))
        np.testing.assert_array_equal(first, second)


# Hostile views: none fails, and what must be seen is.


def test_behind_the_camera_nothing_is_seen() -> None:
    T = square_on(CHARUCO, 0, 0, -1.0)
    np.testing.assert_array_equal(render([board(T)]), render([]))


def test_beside_the_image_nothing_is_seen() -> None:
    np.testing.assert_array_equal(render([board(square_on(CHARUCO, 5, 0, 1.0))]), render([]))


@pytest.mark.parametrize("distortion", [PlumbBob(), DISTORTION])
def test_a_board_across_the_camera_plane_is_seen_in_front_of_it(distortion: PlumbBob) -> None:
    """A long floor of squares under the camera, from behind it to the horizon."""
    floor = replace(CHESSBOARD, dimension=(9, 200), size=0.1)
    T = from_xyz_rpy([-0.5, 0.5, 10.0], [-np.pi / 2, 0, 0])
    image = render([board(T, floor)], DARK if distortion.is_identity else BRIGHT, camera(distortion=distortion))
    lit = render([board(T, floor)], BRIGHT, camera(distortion=distortion))
    assert image.shape == lit.shape
    below = lit[200:239, 100:220]
    assert below.min() < INK_REFLECTANCE + 20
    assert below.max() > PAPER_REFLECTANCE - 20
    np.testing.assert_array_equal(lit[:110], render([], BRIGHT, camera(distortion=distortion))[:110])


def test_a_board_that_fills_the_image() -> None:
    image = render([board(square_on(CHARUCO, 0.01, 0.01, 0.02))])
    assert INK_REFLECTANCE <= image.min() <= image.max() <= PAPER_REFLECTANCE


def test_a_board_that_is_smaller_than_a_pixel() -> None:
    tiny = replace(CHESSBOARD, size=5e-4, border_size=(0.0, 0.0))
    scene = Scene(boxes=(wall(3, (0, 0, 0)),), light=EVEN)
    image = render([board(square_on(tiny, 0.5 / 300, 0.5 / 300, 1.0), tiny)], scene)
    assert image[120, 160] > 0
    assert (image > 0).sum() <= 9
    area = 10 * 7 * 25e-8 * 300**2
    assert image.sum() == pytest.approx((INK_REFLECTANCE + PAPER_REFLECTANCE) / 2 * area, rel=0.5)


def test_a_board_between_two_rows_of_pixels_is_seen() -> None:
    """Half a pixel high: no centre of a pixel is on it."""
    strip = replace(CHESSBOARD, size=1e-4, dimension=(9, 4), border_size=(0.2, 0.5 / 300 / 2 - 2.5e-4))
    scene = Scene(boxes=(wall(3, (0, 0, 0)),), light=EVEN)
    image = render([board(square_on(strip, 0, 0, 1.0), strip)], scene)  # about the edge between rows 119 and 120
    np.testing.assert_allclose(image[[119, 120]][:, [120, 200]], PAPER_REFLECTANCE / 4, atol=2)
    assert not image[[118, 121]].any()


def test_a_board_seen_on_edge_has_no_width() -> None:
    T = from_xyz_rpy([0, 0, 1], [0, np.pi / 2, 0])
    difference = render([board(T)]) != render([])
    assert difference.sum(axis=1).max() <= 2


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (9, 1), (2, 2), (3, 2)])
def test_the_smallest_images(size: tuple[int, int]) -> None:
    of = camera(*size, focal=5.0)
    image = perfect(of).render(T_WORLD_CAMERA, BRIGHT, [board(square_on(CHESSBOARD, 0, 0, 0.3))], stream(0))
    assert image.shape == (size[1], size[0], 3)
    assert INK_REFLECTANCE <= image[size[1] // 2, size[0] // 2, 1] <= PAPER_REFLECTANCE


def test_where_the_lens_shows_nothing_it_is_black() -> None:
    folding = camera(320, 240, 100, PlumbBob(-0.45, 0.0, 0.0, 0.0, 0.0))
    image = render([board(square_on(CHESSBOARD, 0, 0, 0.3), CHESSBOARD)], BRIGHT, folding)
    assert image[0, 0] == 0
    assert image[120, 160] > 0


def near_the_camera(pattern: Board, of: Camera) -> np.ndarray:
    """Mask of the pixels in which a board may be nearer than 0.2 mm."""
    u, v = np.meshgrid(np.arange(-1, of.width + 1), np.arange(-1, of.height + 1))
    rays = of.normalise(np.stack([u, v], -1).astype(float))
    rays = np.concatenate([rays, np.ones((*u.shape, 1))], -1) @ T_WORLD_CAMERA[:3, :3].T
    near = ~(pattern.cast(T_WORLD_CAMERA[:3, 3], rays) > 2e-4)
    return np.asarray(sliding_window_view(near, (3, 3)).any((2, 3)))


@at_most(30)
@example(305, 0.001, 2.0, False, 0.0)  # a tilted board that comes nearer than the wall
@given(st.integers(0, 2**32), st.floats(0.001, 30), st.floats(0, 3.2), st.booleans(), st.floats(-0.1, 0.1))
def test_any_view_is_an_image(seed: int, distance: float, tilt: float, distorted: bool, bow: float) -> None:
    random = np.random.default_rng(seed)
    of = camera(48, 36, 40, DISTORTION if distorted else None)
    pattern = board(random_pose(random, CHARUCO, distance, distance, tilt), bow=(bow, -bow / 2))
    scene = Scene(ground=0.0, boxes=(Box(from_xyz_rpy([2, 0, 1], [0.1, 0.2, 0.3]), np.ones(3)),), light=EVEN)
    with_board, without = render([pattern], scene, of), render([], scene, of)
    hidden = render([pattern], Scene(light=EVEN, boxes=(wall(1e-4, (50, 50, 50)),)), of)
    assert with_board.shape == (36, 48)
    seen = with_board != without
    assert (np.sort(with_board[seen]) <= PAPER_REFLECTANCE).all()
    assert (hidden[~near_the_camera(pattern, of)] == 50).all()
