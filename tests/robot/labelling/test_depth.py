"""The pixels of a depth image on a board, against what each pixel truly sees."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.engine.dataset.sensor_data import NO_RETURN
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import PlumbBob
from calibration.engine.geometry.transforms import transform
from calibration.robot.labelling.depth import label_depth
from calibration.robot.labelling.detection import NotDetected
from calibration.robot.labelling.points import PatternPoints
from tests.properties import at_most
from tests.robot.labelling.worlds import BOARD, Measured, Rectangle, board, displaced, measure

CAMERA = Camera(280.0, 280.0, 159.5, 119.5, 320, 240)
BENT = Camera(280.0, 280.0, 159.5, 119.5, 320, 240, PlumbBob(-0.2, 0.05))
WALL = Rectangle(transform(np.eye(3), [0, 0, 4.0]), 20.0, 20.0)


def rays(camera: Camera) -> np.ndarray:
    v, u = np.mgrid[: camera.height, : camera.width].astype(float)
    return np.concatenate([camera.normalise(np.stack([u, v], -1)), np.ones((*u.shape, 1))], -1)


def facing(distance: float, turn=(0.0, 0.0, 0.0), at=(0.0, 0.0)) -> np.ndarray:
    R = rotations.exp(turn)
    return transform(R, distance * np.array([*at, 1.0]) - R @ np.array([*BOARD.outline.mean(0), 0.0]))


def picture(T, others=(WALL,), camera=CAMERA, noise=0.003) -> tuple[np.ndarray, Measured]:
    measured = measure(rays(camera), board(T), list(others), noise)
    counts = np.rint(measured.distances / 1e-4)
    return np.where(counts < NO_RETURN, counts, NO_RETURN).astype(np.uint16), measured


def found(depth, T, camera=CAMERA, most=None) -> PatternPoints:
    labels = label_depth(depth, camera, BOARD, T, most=most)
    assert isinstance(labels, PatternPoints), labels
    assert (np.diff(labels.on_pattern) > 0).all()
    assert set(labels.on_border) <= set(labels.on_pattern)
    return labels


def mask(index, shape) -> np.ndarray:
    hit = np.zeros(shape, bool)
    hit.ravel()[index] = True
    return hit


def from_border(index, T, camera=CAMERA) -> np.ndarray:
    """Distance of the intersections of these pixels' rays inside of the board's border, m."""
    rectangle = board(T)
    directions = rays(camera).reshape(-1, 3)[index]
    points = directions * rectangle.cast(directions)[:, None]
    R, t = rectangle.T_sensor_rectangle[:3, :3], rectangle.T_sensor_rectangle[:3, 3]
    at = (points - t) @ R
    return (np.array([rectangle.width, rectangle.height]) / 2 - np.abs(at[:, :2])).min(-1)


@at_most(25)
@given(
    st.floats(1.0, 2.5),
    st.tuples(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6), st.floats(-3, 3)),
    st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1)),
    st.sampled_from([CAMERA, BENT]),
    st.sampled_from([0.0, 0.003, 0.008]),
    st.integers(0, 1000),
)
def test_any_pose_any_guess_within_the_tolerance(distance, turn, at, camera, noise, seed) -> None:
    T = facing(distance, turn, at)
    depth, measured = picture(T, camera=camera, noise=noise)
    random = np.random.default_rng(seed)
    shift, angle = (v / np.linalg.norm(v) for v in random.normal(size=(2, 3)))
    labels = found(depth, displaced(T, 0.05 * shift, 0.05 * angle), camera)
    region = mask(labels.on_pattern, depth.shape)
    assert not (region & ~measured.on_board).any()
    assert (measured.on_board & ~region).sum() <= 5 + 0.01 * measured.on_board.sum()
    pixel = distance / camera.fx / np.cos(min(np.hypot(*turn[:2]), 1.2))
    assert from_border(labels.on_border, T, camera).max() < 3 * pixel
    assert len(labels.on_border) > 50


def test_with_a_perfect_sensor_the_region_is_the_board() -> None:
    T = facing(1.5, (0.3, -0.2, 0.4))
    depth, measured = picture(T, noise=0.0)
    np.testing.assert_array_equal(mask(found(depth, T).on_pattern, depth.shape), measured.on_board)


def test_where_something_nearer_hides_the_rest_there_is_no_border() -> None:
    T = facing(1.5, (0.1, 0.2, 0.3))
    front = Rectangle(transform(np.eye(3), [0.25, 0.0, 1.0]), 0.4, 3.0)
    depth, measured = picture(T, (WALL, front))
    labels = found(depth, T)
    region = mask(labels.on_pattern, depth.shape)
    assert not (region & ~measured.on_board).any()
    assert from_border(labels.on_border, T).max() < 0.02
    beside_it = [i for i in labels.on_border if depth.ravel()[i + 1] < 11_000]
    assert len(beside_it) <= 2  # where its edge meets that of the board


def test_what_parts_the_board_leaves_its_larger_part() -> None:
    T = facing(1.5)
    front = Rectangle(transform(np.eye(3), [0.1, 0.0, 1.0]), 0.05, 3.0)
    depth, _ = picture(T, (WALL, front))
    region = mask(found(depth, T).on_pattern, depth.shape)
    columns = np.flatnonzero(region.any(0))
    assert columns.max() - columns.min() < 0.75 * 0.8 / 1.5 * 280


def test_near_the_edge_of_the_image_nothing_is_on_a_border() -> None:
    T = facing(0.9, at=(0.4, 0.0))
    depth, _ = picture(T)
    labels = found(depth, T)
    v, u = np.divmod(labels.on_border, 320)
    assert u.max() < 320 * 0.975
    assert ((v >= 240 * 0.025) & (v < 240 * 0.975)).all()
    assert (labels.on_pattern % 320).max() == 319


def test_missing_pixels_in_the_board_are_no_border() -> None:
    T = facing(1.5)
    depth, _ = picture(T)
    depth[110:130, 150:170] = NO_RETURN
    depth[100, 140] = 0
    assert from_border(found(depth, T).on_border, T).max() < 0.02


@pytest.mark.parametrize("most", [50, 1000])
def test_thinned_evenly(most) -> None:
    T = facing(1.2)
    depth, _ = picture(T)
    everything, some = found(depth, T), found(depth, T, most=most)
    assert set(some.on_pattern) <= set(everything.on_pattern)
    assert set(some.on_border) <= set(everything.on_border)
    assert most / 2 < len(some.on_pattern) <= 2 * most
    assert most / 2 < len(some.on_border) <= most or len(everything.on_border) < most
    assert np.ptp(some.on_pattern) > 0.95 * np.ptp(everything.on_pattern)


def test_no_board() -> None:
    T = facing(1.5)
    empty = np.full((240, 320), NO_RETURN, np.uint16)
    for depth in (empty, np.zeros_like(empty), np.full_like(empty, 40_000)):
        labels = label_depth(depth, CAMERA, BOARD, T)
        assert isinstance(labels, NotDetected)
        assert "at least 10 are needed" in labels.reason
    behind = label_depth(picture(T)[0], CAMERA, BOARD, facing(-1.5))
    assert isinstance(behind, NotDetected)
    wall = Rectangle(transform(np.eye(3), [0, 0, 1.5]), 20.0, 20.0)
    small = label_depth(picture(facing(9.0), (wall,))[0], CAMERA, BOARD, T)
    assert isinstance(small, PatternPoints | NotDetected)
