"""Each view by itself: least squares in pixels, the better of two minima."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.base.arrays import Array
from calibration.engine.dataset.model import CornerLabels
from calibration.engine.dataset.pattern import Pattern, grid, outline
from calibration.engine.estimation.least_squares.minimisation import Termination
from calibration.engine.estimation.residuals.corner_residuals import CornerTerm, side_by_side
from calibration.engine.estimation.residuals.planar_pose import mirrored_poses
from calibration.engine.estimation.start.single_views import corner_term, fitted_poses, refined_poses
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import PlumbBob
from calibration.engine.geometry.transforms import apply, distance, retract, transform
from calibration.engine.statistics import median

CAMERA = Camera(700.0, 740.0, 640.0, 480.0, 1280, 960, PlumbBob(-0.2, 0.05, 1e-3, -2e-3, 0.01))
SIZES = (10, 5, 0.06)
PATTERN = Pattern(
    "board", "charuco", "board", "world", False, grid(*SIZES, (0.06, 0.06)), outline(*SIZES, (0.0, 0.0), (0.06, 0.06))
)
CORNERS = PATTERN.corners - PATTERN.centre


def poses(seed: int, count: int, tilt: float = 0.4, depth: float = 1.5) -> Array:
    """``T_camera_centre`` of patterns about `depth` m away."""
    rng = np.random.default_rng(seed)
    R = rotations.exp(rng.normal(size=(count, 3)) * tilt)
    return transform(R, rng.uniform([-0.3, -0.2, 0.75], [0.3, 0.2, 1.25], (count, 3)) * [1, 1, depth])


def term(T: Array, noise: float = 0.0, seed: int = 0, seen: float = 1.0) -> CornerTerm:
    """Term of a camera's views, with noise in px and a share of the corners in each view."""
    rng = np.random.default_rng(seed)
    pixels = CAMERA.project(apply(T, CORNERS)).swapaxes(1, 2)
    pixels = pixels + rng.normal(size=pixels.shape) * noise
    mask = rng.random((len(T), len(CORNERS))) < seen
    return CornerTerm(CAMERA, CORNERS, pixels, None if seen == 1.0 else mask)


def rms_of(labels: CornerTerm, T: Array) -> Array:
    return np.sqrt(np.nanmean(labels.magnitudes(T) ** 2, -1))


def test_labels_are_at_the_index_of_their_ids() -> None:
    views = [CornerLabels(np.array([3, 1]), np.array([[30.0, 31.0], [10.0, 11.0]]))]

    labels = corner_term(CAMERA, PATTERN, views)

    assert labels.seen is not None
    assert np.flatnonzero(labels.seen[0]).tolist() == [1, 3]
    assert labels.pixels[0, :, 3].tolist() == [30.0, 31.0]
    assert labels.counts.tolist() == [2]
    assert np.abs(labels.corners.mean(0)).max() < 1e-12


def test_exact_labels_give_exact_poses_through_distortion() -> None:
    T = poses(1, 100)

    for share in (1.0, 0.5):
        labels = term(T, seen=share)
        np.testing.assert_allclose(labels.linear_poses, T, atol=1e-5)  # the rays are rounded
        refined, rms = refined_poses(labels, retract(T, np.full((100, 6), 0.01)))
        np.testing.assert_allclose(refined, T, atol=1e-8)
        np.testing.assert_allclose(rms, 0, atol=1e-5)


def test_a_skew_is_taken_off_the_labels() -> None:
    T, camera = poses(1, 40), replace(CAMERA, skew=2.0)
    pixels = camera.project(apply(T, CORNERS)).swapaxes(1, 2)
    skewed, straight = CornerTerm(camera, CORNERS, pixels, None), term(T)
    np.testing.assert_allclose(skewed.linear_poses, T, atol=1e-5)
    for labels in (skewed, side_by_side([skewed.take(slice(0, 20)), straight.take(slice(20, 40))])):
        refined, rms = refined_poses(labels, retract(T, np.full((40, 6), 0.01)))
        np.testing.assert_allclose(refined, T, atol=1e-8)
        np.testing.assert_allclose(rms, 0, atol=1e-5)
        assert labels.magnitudes(T).max() < 1e-9


def test_refinement_reaches_the_noise_floor() -> None:
    T = poses(2, 400)
    labels = term(T, 0.3, 2)

    refined, rms = refined_poses(labels, labels.linear_poses)

    # 2 K - 6 degrees of freedom in the squared norms of K corners
    assert np.mean(rms**2) == pytest.approx(0.3**2 * (2 * 50 - 6) / 50, rel=0.02)
    linear = distance(T, labels.linear_poses)
    assert all(median(after) < 0.7 * median(before) for before, after in zip(linear, distance(T, refined), strict=True))


@pytest.mark.parametrize("huber", [None, 0.8])
def test_the_refined_pose_is_a_minimum(huber: float | None) -> None:
    T = poses(3, 20)
    labels = term(T, 1.0, 3, seen=0.6)

    refined, rms = refined_poses(labels, T, huber)

    for twist in np.concatenate([np.eye(6), -np.eye(6)]) * 1e-4:
        nearby = retract(refined, np.broadcast_to(twist, (20, 6)))
        _, nearby_rms = refined_poses(labels, nearby, huber, Termination(iterations=0))
        assert (nearby_rms > rms).all()


def test_the_error_is_that_of_reprojection() -> None:
    labels = term(poses(4, 20), 0.5, 4)

    refined, rms = refined_poses(labels, labels.linear_poses)

    np.testing.assert_allclose(rms, rms_of(labels, refined))


def test_refinement_never_makes_a_view_worse() -> None:
    labels = term(poses(5, 200), 0.3, 5)
    start = poses(6, 200)  # unrelated poses
    before = rms_of(labels, start)
    for iterations in (1, 2, 5):
        _, after = refined_poses(labels, start, until=Termination(iterations=iterations))
        assert (after <= before * (1 + 1e-12)).all()
        before = after


def test_huber_takes_the_weight_off_an_outlier() -> None:
    T = poses(7, 40)
    labels = term(T, 0.3, 7)
    labels.pixels[:, 0, 23] += 40
    start = labels.linear_poses

    plain, robust = (refined_poses(labels, start, huber)[0] for huber in (None, 1.0))

    assert median(distance(T, robust)[1]) < 0.25 * median(distance(T, plain)[1])


def test_a_pattern_behind_the_camera_or_without_a_start_has_no_pose() -> None:
    behind = transform(np.eye(3), np.array([[0.0, 0.0, -1.0]]))

    for start in (behind, np.full((1, 4, 4), np.nan)):
        refined, rms = refined_poses(term(poses(8, 1)), start)
        assert np.isnan(refined).all()
        assert np.isnan(rms).all()


def test_a_view_does_not_depend_on_its_neighbours() -> None:
    T = poses(9, 30, depth=4.0)
    labels = term(T, 0.5, 9)
    alone = CornerTerm(CAMERA, CORNERS, labels.pixels[7:8], None)

    together, _ = fitted_poses(labels)

    np.testing.assert_allclose(fitted_poses(alone)[0], together[7:8], atol=1e-9)


def test_no_view_at_all() -> None:
    T, rms = fitted_poses(CornerTerm(CAMERA, CORNERS, np.empty((0, 2, 50)), None))

    assert T.shape == (0, 4, 4)
    assert rms.shape == (0,)


def test_the_better_of_both_minima_is_fitted() -> None:
    T = poses(10, 300, depth=10.0)
    labels = term(T, 0.3, 10)

    fitted, rms = fitted_poses(labels)
    one, one_rms = refined_poses(labels, labels.linear_poses)
    _, back_rms = refined_poses(labels, mirrored_poses(fitted))

    assert (rms <= one_rms).all()
    wrong = rms < one_rms - 1e-6
    assert wrong.any()  # the linear start led some views to the worse minimum
    assert (distance(fitted, one)[1][wrong] > 0.02).all()
    assert (back_rms >= rms - 1e-3).mean() > 0.99


def test_a_label_that_the_distortion_cannot_have_made_does_not_cost_the_view() -> None:
    T = poses(11, 5)
    labels = term(T)
    labels.pixels[2, :, 7] = -5e4

    linear = labels.linear_poses
    robust, _ = refined_poses(labels, linear, huber=1.0)

    np.testing.assert_allclose(linear, T, atol=1e-9)
    assert distance(T, robust)[0].max() < 1e-3


def test_labels_of_all_corners_may_be_in_any_order() -> None:
    K = len(PATTERN.corners)
    pixels = np.arange(2.0 * K).reshape(K, 2)
    views = [CornerLabels(np.arange(K), pixels), CornerLabels(np.arange(K)[::-1], pixels[::-1])]

    labels = corner_term(CAMERA, PATTERN, views)

    assert labels.seen is None
    np.testing.assert_array_equal(labels.pixels, np.stack([pixels.T, pixels.T]))
