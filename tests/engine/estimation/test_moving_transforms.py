"""Additional transforms that each collection has its own of: a mobile base whose odometry is only a guess."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.base import UndeterminedError
from calibration.engine.dataset.model import Labels, PointLabels
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.least_squares.minimisation import optimise
from calibration.engine.estimation.least_squares.noise_levels import NoiseLevels
from calibration.engine.estimation.start.build import build
from calibration.engine.estimation.start.guesses import StartingNoise, perturb, with_starting_noise
from calibration.engine.estimation.start.linear_start import linear_start
from calibration.engine.geometry.transforms import distance, inverse, local
from tests.engine.estimation.scenes import board, looks, pose, relabelled, sigmas_apart, true_values
from tests.engine.estimation.systems import mobile_base

BASE = ("world", "base")
NOISY = {"pixel_noise": 0.3, "range_noise": 0.01}


def worst(dataset, result) -> tuple[float, float]:
    """The largest error (m, rad) of what each sensor sees of the pattern: all that labels can tell."""
    found, true = (
        np.concatenate([d.transform(s.frame, "board_link") for s in d.sensors.values()])
        for d in (result.dataset, dataset)
    )
    t, r = distance(true, found)
    return float(t.max()), float(r.max())


@pytest.mark.parametrize("noise", [(0.0, 0.0), (0.1, 0.1), (0.5, 0.5), (2.0, 3.0)])
@pytest.mark.parametrize("loss", ["linear", "huber"])
def test_exact_labels_give_the_truth_for_any_odometry(noise, loss):
    dataset = mobile_base(border=False, partial=0.3).dataset()
    result = calibrate(dataset, Options(loss=loss), StartingNoise(*noise, 2))
    assert result.converged, result.reason
    assert max(worst(dataset, result)) < 1e-6
    assert result.gauge == "cam"
    assert BASE not in result.transforms


def test_fixed_transforms_are_reported():
    dataset = mobile_base(**NOISY).dataset()
    setup = build(dataset)
    assert (setup.gauge, setup.gauge_patterns) == ("cam", ("board",))
    result = calibrate(dataset, noise=StartingNoise(0.1, 0.1))
    assert "pattern 'board' is held where the guess puts it: only poses relative to it can be known" in result.notes
    assert result.sigma_mm(("world", "board_link")) == 0


def test_an_anchored_sensor_leaves_the_place_of_the_pattern_open():
    setup = build(mobile_base(anchored="second").dataset())
    assert (setup.gauge, setup.gauge_patterns) == (None, ("board",))


def test_a_pattern_with_a_given_pose_fixes_the_gauge():
    dataset = mobile_base().dataset()
    setup = build(dataset, ("board",))
    assert (setup.gauge, setup.gauge_patterns) == ("cam", ())
    result = calibrate(dataset, Options(hold=("board", "cam")), StartingNoise(0.5, 0.5))
    assert result.gauge is None
    np.testing.assert_allclose(
        result.dataset.transforms["world", "board_link"], dataset.transforms["world", "board_link"], atol=1e-15
    )


def test_every_start_gives_the_same():
    dataset = mobile_base(**NOISY).dataset(1)
    options = Options(hold=("board", "cam"), noise_levels=calibrate(dataset).noise_levels)
    first = calibrate(dataset, options)
    for noise in (StartingNoise(0.5, 0.5, 3), StartingNoise(2, 3, 4)):
        moved = with_starting_noise(dataset, noise).with_transforms({BASE: dataset.transforms[BASE] @ pose(1, 2, 0)})
        again = calibrate(moved.with_transforms({("base", "cam"): dataset.transforms["base", "cam"]}), options)
        assert again.converged
        assert sigmas_apart(first, again) < 1e-5


@pytest.mark.many_scenes
def test_errors_match_the_covariance():
    scores = []
    for seed in range(16):
        dataset = mobile_base(8, seed=seed, border=False, **NOISY).dataset(seed)
        result = calibrate(dataset, Options(hold=("board", "cam")))
        for edge, covariance in result.label_covariances.items():
            d = local(result.transforms[edge], dataset.transforms[edge][0])
            scores.append(d @ np.linalg.solve(covariance, d) / 6)
    assert 0.75 < np.mean(scores) < 1.3  # 32 blocks of 6: a standard deviation of 0.1


@pytest.mark.parametrize("seed", [1, 21, 22, 24, 32])
def test_a_base_is_not_left_where_a_small_pattern_is_mirrored(seed):
    """Both poses of it fit each image alone; both images together tell, by less than any threshold of a bad fit."""
    scene = mobile_base(seed=seed, pixel_noise=0.5)
    small = replace(scene, sensors=scene.sensors[:2], patterns=[board(fixed=True, square=0.03)])
    dataset = small.dataset(seed)
    hold, levels = ("board", "cam"), NoiseLevels(pixel=0.5)
    result = calibrate(dataset, Options(hold=hold, noise_levels=levels))
    setup = build(dataset, hold)
    best = optimise(setup.problem, true_values(setup), levels, robust=True).optimum
    assert result.converged
    assert result.cost <= best.cost + 1e-3
    _, turned = distance(result.dataset.transforms[BASE], dataset.transforms[BASE])
    assert turned.max() < 0.3


def test_without_a_camera_view_the_given_guess_is_taken_and_reported():
    def blind(i: int, _: str, label: Labels) -> Labels | None:
        return label if i != 3 or isinstance(label, PointLabels) else None

    dataset = relabelled(mobile_base().dataset(), blind)
    setup = build(dataset)
    truth = true_values(setup)
    start = linear_start(setup, truth)
    assert start.guessed == ("world-base",)
    at = setup.block(BASE)
    np.testing.assert_allclose(start.values[at], truth[at], atol=1e-6)
    assert any("'world-base' a linear start" in warning for warning in calibrate(dataset).notes)


def test_the_noise_of_a_starting_guess_is_another_in_each_collection():
    dataset = mobile_base().dataset()
    noise = StartingNoise(0.3, 0.2, 5)
    setup = build(dataset)
    guess = perturb(setup, true_values(setup), noise)[setup.block(BASE)]
    moved = guess[:, :3, 3] - dataset.transforms[BASE][:, :3, 3]
    np.testing.assert_allclose(np.linalg.norm(moved, axis=-1), 0.3)
    assert len(np.unique(moved.round(6), axis=0)) == len(moved)
    np.testing.assert_array_equal(with_starting_noise(dataset, noise).transforms[BASE], guess)


def test_the_noise_stays_with_its_collections_where_some_do_not_count():
    dataset = relabelled(mobile_base().dataset(), lambda i, _, label: None if i == 2 else label)
    noisy = with_starting_noise(dataset, StartingNoise(0.3, 0.2, 5)).transforms[BASE]
    distances = np.linalg.norm(noisy[:, :3, 3] - dataset.transforms[BASE][:, :3, 3], axis=-1)
    np.testing.assert_allclose(distances, [0.0 if i == 2 else 0.3 for i in range(12)], atol=1e-12)
    result = calibrate(dataset, noise=StartingNoise(0.1, 0.1))
    np.testing.assert_array_equal(result.dataset.transforms[BASE][2], dataset.transforms[BASE][2])


def test_an_unknown_motion_and_an_unknown_pattern_in_each_collection_make_up_for_each_other():
    scene = mobile_base(anchored="cam")
    moving = scene.transforms[BASE] @ scene.transforms["base", "cam"] @ looks(12, pattern=scene.patterns[0])
    loose = replace(
        scene, patterns=[board(square=0.12)], transforms={**scene.transforms, ("world", "board_link"): moving}
    )
    with pytest.raises(UndeterminedError, match=r"'world-base' and 'board' make up for each other"):
        calibrate(loose.dataset())


def test_cameras_that_share_no_view_are_linked_by_the_base_that_carries_both():
    scene = mobile_base(border=False)
    T_world_far = scene.transforms[BASE] @ scene.transforms["base", "second"] @ looks(12, 5)[0]
    T_base = np.array(scene.transforms[BASE])
    transforms = {**scene.transforms, ("world", "far_link"): T_world_far[0]}
    # the second camera looks at a pattern of its own, wherever the base stands
    transforms["base", "second"] = inverse(T_base[0]) @ T_world_far[0] @ inverse(looks(1, 5)[0])
    sensors = scene.sensors[:2]
    own = {"cam": "board", "second": "far"}
    far = board("far", fixed=True)
    seen = replace(
        scene, sensors=sensors, patterns=[*scene.patterns, far], transforms=transforms, sees=lambda s, p, _: own[s] == p
    )
    setup = build(seen.dataset())
    assert (setup.gauge, setup.gauge_patterns) == ("cam", ("board",))
