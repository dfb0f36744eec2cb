import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.engine.geometry.transforms import apply, from_xyz_rpy, inverse
from calibration.robot.simulation.board import Board
from tests.robot.simulation.rendering.views import CHARUCO, CHESSBOARD

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
