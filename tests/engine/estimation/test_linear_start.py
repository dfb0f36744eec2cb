"""The linear start: exact labels give it exactly, whatever the structure and the guess; bad views don't spoil it."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.base import InputError
from calibration.engine.dataset.model import CornerLabels, Labels
from calibration.engine.estimation.least_squares.normal_equations import Weighting, assemble
from calibration.engine.estimation.start.build import Setup, build
from calibration.engine.estimation.start.guesses import StartingNoise, guess_of_dataset, perturb
from calibration.engine.estimation.start.linear_start import LinearStart, linear_start, pattern_poses
from calibration.engine.estimation.start.single_views import robust_poses
from calibration.engine.geometry.transforms import distance, transform
from tests.engine.estimation.scenes import AHEAD, Scene, board, errors, lidar2d, pose, relabelled, shaken, true_values
from tests.engine.estimation.systems import (
    ALL,
    camera_and_lidar2d,
    eye_in_hand,
    eye_to_hand,
    hand_and_world,
    ring,
    rotating,
    stereo,
    two_bodies,
)

EXACT = Weighting({"pixel": 1.0, "range": 0.01, "border": 0.01, "lidar2d_range": 0.01}, None)


def start_of(setup: Setup, noise: StartingNoise | None = None) -> LinearStart:
    """With uninformative guesses of the patterns."""
    nothing = tuple(
        np.broadcast_to(np.eye(4), v.shape).copy() if block.edge[1].endswith("_link") else v
        for v, block in zip(true_values(setup), setup.problem.blocks, strict=True)
    )
    return linear_start(setup, perturb(setup, nothing, noise or StartingNoise()))


def shared_errors(setup: Setup, start: LinearStart) -> tuple[float, float]:
    """Of all but the patterns."""
    edges = [block.edge for block in setup.problem.blocks]
    found = {e: T for e, T in zip(edges, start.values, strict=True) if T.ndim == 2 and not e[1].endswith("_link")}
    return errors(setup.dataset, found, setup.gauge)


@pytest.mark.parametrize("scene", ALL)
@pytest.mark.parametrize("noise", [(0, 0), (0.5, 0.5), (2, 3)], ids=str)
def test_exact_labels_give_an_exact_start_from_any_guess(scene, noise):
    setup = build(ALL[scene](border=False, partial=0.3).dataset())
    start = start_of(setup, StartingNoise(*noise, seed=5))
    assert start.guessed == ()
    assert max(shared_errors(setup, start)) < 1e-9
    assert assemble(setup.problem, start.values, EXACT).cost.max() < 1e-12


@pytest.mark.parametrize("scene", ["camera and lidar", "lidar behind"])
@pytest.mark.parametrize("seed", range(8))
def test_a_lidar_on_either_side_of_the_pattern_is_found_from_noisy_guesses(scene, seed):
    setup = build(ALL[scene](seed=seed, border=False, pixel_noise=0.3, range_noise=0.01).dataset(seed))
    start = start_of(setup, StartingNoise(0.5, 0.5, seed))
    moved, turned = shared_errors(setup, start)
    assert moved < 0.05
    assert turned < 0.03


@pytest.mark.parametrize("scene", ["camera and 2D lidar", "tripod", "linked by a lidar", "linked by a 2D lidar"])
@pytest.mark.parametrize("seed", range(4))
def test_noisy_scan_lines_and_planes_give_a_start_without_a_guess(scene, seed):
    setup = build(ALL[scene](seed=seed, border=False, pixel_noise=0.3, range_noise=0.01).dataset(seed))
    start = start_of(setup, StartingNoise(3, 1.5, seed))
    assert start.guessed == ()
    moved, turned = shared_errors(setup, start)
    assert moved < 0.15
    assert turned < 0.08


def test_a_2d_lidar_whose_planes_are_too_few_starts_from_its_guess():
    setup = build(camera_and_lidar2d(4).dataset())
    guess = perturb(setup, true_values(setup), StartingNoise(0.1, 0.1))
    start = linear_start(setup, guess)
    assert start.guessed == ("world-scan",)
    scan = setup.block(("world", "scan"))
    np.testing.assert_array_equal(start.values[scan], guess[scan])


def test_the_views_of_several_patterns_count_together_for_a_2d_lidar():
    """Four planes of each of two patterns: eight are enough, four are not."""
    scene = camera_and_lidar2d(8)
    other = replace(board("other", square=0.12))
    transforms = {**scene.transforms, ("world", "other_link"): scene.transforms["world", "board_link"]}
    both = replace(scene, patterns=[*scene.patterns, other], transforms=transforms)
    setup = build(replace(both, border=False, sees=lambda _, p, i: (i < 4) == (p == "board")).dataset())
    start = start_of(setup, StartingNoise(3, 1.5))
    assert start.guessed == ()
    assert max(shared_errors(setup, start)) < 1e-9


def test_a_2d_lidar_in_the_hand_of_an_arm():
    """A camera and a 2D LiDAR on the flange, and a fixed pattern."""
    scene = eye_in_hand(14, border=False)
    big = board(fixed=True, square=0.2)
    beside = scene.transforms["flange", "mount"] @ scene.transforms["mount", "cam"] @ transform(AHEAD, (0.05, 0.0, 0.0))
    sensors = [*scene.sensors, lidar2d("scan", "flange")]
    scene = replace(scene, sensors=sensors, patterns=[big], transforms={**scene.transforms, ("flange", "scan"): beside})
    setup = build(scene.dataset())
    start = start_of(setup, StartingNoise(3, 1.5))
    assert start.guessed == ()
    assert max(shared_errors(setup, start)) < 1e-8


def test_five_cameras_whose_neighbours_only_share_collections():
    setup = build(ring(24, pixel_noise=0.3).dataset())
    together = [{g.sensor for g in setup.problem.groups if i in g.collections} for i in range(24)]
    assert all(len(sensors) == 2 for sensors in together)
    assert shared_errors(setup, start_of(setup))[0] < 0.05


def test_blocks_without_an_equation_take_the_guess_and_are_named():
    """Three unknowns in a row: the base of the arm, the camera's mount and the pattern."""
    scene = eye_in_hand()
    T_world_base = pose(0.2, 0.1, 0.0, 0.1, 0.2, 0.3)
    transforms = dict(scene.transforms)
    transforms["base", "flange"] = np.linalg.inv(T_world_base) @ transforms.pop(("world", "flange"))
    transforms["world", "base"] = T_world_base
    setup = build(replace(scene, transforms=transforms, additional=(("world", "base"),)).dataset())
    guess = perturb(setup, true_values(setup), StartingNoise(0.1, 0.1))
    start = linear_start(setup, guess)
    assert start.guessed == ("world-base",)
    base = setup.block(("world", "base"))
    np.testing.assert_array_equal(start.values[base], guess[base])
    assert assemble(setup.problem, start.values, EXACT).cost.max() < 1e-12


def test_the_guess_of_a_fixed_sensor_is_kept():
    setup = build(stereo().dataset())
    guess = shaken(setup, true_values(setup), 0.3)
    held = setup.block(setup.dataset.sensors[setup.gauge].edge)
    np.testing.assert_array_equal(linear_start(setup, guess).values[held], guess[held])


@pytest.mark.parametrize("scene", [stereo, eye_to_hand, eye_in_hand, two_bodies], ids=lambda s: s.__name__)
@pytest.mark.parametrize("how", ["turned by half a revolution", "nonsense"])
def test_a_view_that_is_wrong_does_not_spoil_it(scene: type[Scene], how):
    rng = np.random.default_rng(0)

    def spoil(i: int, sensor: str, label: Labels) -> Labels:
        if i != 4 or sensor not in ("left", "cam", "a"):
            return label
        wrong = label.pixels[::-1] if how != "nonsense" else rng.uniform(0, 900, label.pixels.shape)
        return CornerLabels(label.ids, wrong)

    setup = build(relabelled(scene(pixel_noise=0.1).dataset(), spoil))
    moved, turned = shared_errors(setup, start_of(setup))
    assert moved < 0.05
    assert turned < 0.03


@pytest.mark.parametrize(("share", "size"), [(0.05, 200.0), (0.2, 30.0), (0.2, 100.0)])
def test_outliers_in_every_view_do_not_spoil_it(share, size):
    rng = np.random.default_rng(0)

    def spoil(_: int, __: str, label: Labels) -> Labels:
        bad = rng.random(len(label.ids)) < share
        return CornerLabels(label.ids, label.pixels + bad[:, None] * rng.uniform(-size, size, label.pixels.shape))

    setup = build(relabelled(stereo(20, pixel_noise=0.3).dataset(), spoil))
    assert shared_errors(setup, start_of(setup))[0] < 0.1


def test_flipped_views_from_afar_do_not_spoil_it():
    scene = stereo(40)
    far = scene.transforms["world", "board_link"].copy()
    left = scene.transforms["world", "left"]
    far[:, :3, 3] += 5 * left[:3, 2]
    setup = build(
        replace(scene, transforms={**scene.transforms, ("world", "board_link"): far}, pixel_noise=0.5).dataset()
    )
    start = start_of(setup)
    pattern = setup.block(("world", "board_link"))
    moving = left @ np.linalg.inv(start.values[setup.block(("world", "left"))]) @ start.values[pattern]
    flipped = distance(true_values(setup)[pattern], moving)[1] > 0.3
    assert flipped.sum() > 2
    assert shared_errors(setup, start)[1] < 0.05


def test_a_motion_that_is_too_poor_is_passed_over_for_one_that_is_not():
    """Ten views of one pattern turn about one axis, six of another about all."""
    scene = eye_to_hand(16)
    about_one = rotating(scene, np.linspace(-0.5, 0.5, 10)[:, None] * [0, 0.6, 0.8]).transforms["base", "flange"]
    motion = np.concatenate([about_one, scene.transforms["base", "flange"][10:]])
    transforms = {
        **scene.transforms,
        ("base", "flange"): motion,
        ("flange", "other_link"): pose(0.0, -0.2, 0.2, 0.4, -0.2, 1.2),
    }
    patterns = [*scene.patterns, board("other", "flange", fixed=True)]
    both = replace(scene, transforms=transforms, patterns=patterns)
    setup = build(replace(both, sees=lambda _, pattern, i: (i < 10) == (pattern == "board")).dataset())
    assert max(shared_errors(setup, start_of(setup))) < 1e-9


def test_patterns_are_put_where_the_cameras_see_them():
    setup = build(hand_and_world(pixel_noise=0.1).dataset())
    truth = true_values(setup)
    nothing = tuple(np.eye(4) if setup.problem.blocks[i].edge[1] == "board_link" else T for i, T in enumerate(truth))
    found = pattern_poses(setup, nothing)
    pattern = setup.block(("world", "board_link"))
    assert distance(found[pattern], truth[pattern])[0] < 0.01
    for i, value in enumerate(nothing):
        if i != pattern:
            np.testing.assert_array_equal(found[i], value)


@pytest.mark.parametrize("fuller", ["left", "right"])
def test_the_view_with_most_labels_gives_the_pose_of_a_moving_pattern(fuller):
    def few(_: int, sensor: str, label: Labels) -> Labels:
        return label if sensor == fuller else CornerLabels(label.ids[:8], label.pixels[:8])

    setup = build(relabelled(stereo(8, pixel_noise=0.3).dataset(), few))
    found = pattern_poses(setup, true_values(setup))
    group = next(g for g in setup.problem.groups if g.sensor == fuller)
    np.testing.assert_allclose(setup.problem.poses(group, found), robust_poses([group.terms[0]])[0], atol=1e-9)


def test_a_collection_in_which_no_view_gives_a_pose_is_named():
    def collapse(i: int, _: str, label: Labels) -> Labels:
        return CornerLabels(label.ids, np.full_like(label.pixels, 500.0)) if i == 3 else label

    setup = build(relabelled(stereo(8).dataset(), collapse))
    with pytest.raises(InputError, match="collection 003: no camera view tells the pose of 'board'"):
        start_of(setup)


def test_what_no_equation_gives_starts_from_the_noisy_guess():
    setup = build(camera_and_lidar2d(4).dataset())
    guess, scan = guess_of_dataset(setup), setup.block(("world", "scan"))
    for seed in (1, 2):
        noisy = perturb(setup, guess, StartingNoise(0.1, 0.1, seed))
        start = linear_start(setup, noisy)
        assert (start.guessed, start.depends_on_guess) == (("world-scan",), True)
        np.testing.assert_array_equal(start.values[scan], noisy[scan])
        assert distance(start.values[scan], true_values(setup)[scan])[0] == pytest.approx(0.1)


@pytest.mark.parametrize("scene", sorted(ALL.keys() - {"lidar behind"}))
def test_a_start_that_depends_on_no_guess_is_the_same_from_any_to_the_last_bit(scene):
    setup = build(ALL[scene](pixel_noise=0.3, range_noise=0.01).dataset())
    starts = [start_of(setup, StartingNoise(size, size, seed=5)) for size in (0.0, 0.1, 0.5)]
    assert [each.depends_on_guess for each in starts] == [False] * 3
    assert len({b"".join(value.tobytes() for value in each.values) for each in starts}) == 1


def test_which_side_of_the_board_a_lidar_sees_is_decided_by_the_guess():
    start = start_of(build(ALL["lidar behind"](8, pixel_noise=0.3, range_noise=0.01).dataset()))
    assert (start.guessed, start.depends_on_guess) == ((), True)
