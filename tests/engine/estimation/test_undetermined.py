"""Data that cannot determine what is asked: an error in one line that names what is missing, from either start."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calibration.base import ExitCode, InputError, UndeterminedError
from calibration.engine.dataset.model import CornerLabels, Dataset, Labels, PointLabels
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.diagnosis.diagnose import diagnose
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.engine.evaluation.truth import Truth, read_truth, truth_error
from calibration.engine.geometry.transforms import retract, transform
from tests.engine.estimation.scenes import Scene, board, errors, pose, relabelled
from tests.engine.estimation.systems import camera_and_lidar, eye_in_hand, eye_to_hand, rotating, stereo, two_bodies
from tests.pipeline.conftest import DATASETS

TURNS = np.linspace(-0.5, 0.5, 12)[:, None]
ALTERNATING = {"sees": lambda sensor, _, i: (i % 2 == 0) == (sensor in ("left", "a"))}


def refusal(scene: Scene, kind: type[InputError] = UndeterminedError) -> str:
    """Message of the refusal; the same with and without noise on the labels, from both starts."""
    messages = set()
    for noise in (0.0, 0.3):
        dataset = replace(scene, pixel_noise=noise, range_noise=noise / 30).dataset()
        for start in ("linear", "given"):
            with pytest.raises(kind) as error:
                calibrate(dataset, Options(start=start))
            assert error.value.exit_code == ExitCode.BAD_INPUT
            messages.add(str(error.value))
    assert len(messages) == 1
    message = messages.pop()
    assert "\n" not in message
    assert message.startswith("scene/dataset.json: ")
    return message


@pytest.mark.parametrize(
    ("scene", "mount", "frame"),
    # the arm holds the pattern, or, seen from the camera in its hand, the world
    [(eye_to_hand, "world-cam", "flange"), (eye_in_hand, "flange-mount", "world")],
)
def test_an_arm_that_turns_about_one_axis(scene: Callable[[int], Scene], mount, frame):
    axis = np.array([0.0, 0.6, 0.8])  # of the flange
    turning = rotating(scene(12), TURNS * axis)
    message = refusal(turning)
    if frame == "world":
        axis = turning.transforms["world", "flange"][0][:3, :3] @ axis
    x, y, z = np.round(axis * np.sign(axis[np.abs(axis).argmax()]), 2)
    assert f"'{mount}' and 'board' cannot be told apart" in message
    assert f"about a single axis only, ({x:g}, {y:g}, {z:g}) in frame '{frame}'" in message


def base_that_turns_about_one_axis(collections: int) -> tuple[Dataset, Truth]:
    """Two cameras and a LiDAR on a base that drives over a floor, its poses known, before a pattern in the world."""
    folder = DATASETS / "softbot"
    dataset, truth = read_dataset(folder), read_truth(folder / "ground_truth.json")
    moving = dataset.moving_transforms
    poses = {edge: np.stack([truth.patterns[key][edge] for key in dataset.keys]) for edge in moving}
    dataset = replace(dataset, anchored=None, additional_transforms=(), moving_transforms=frozenset())
    return dataset.with_transforms(poses).with_collections(range(collections)), truth


@pytest.mark.parametrize("start", ["linear", "given"])
def test_a_base_that_turns_about_one_axis_determines_relative_poses(start):
    dataset, truth = base_that_turns_about_one_axis(5)
    result = calibrate(dataset, Options(start), StartingNoise(0.1, 0.05, 2))
    assert result.converged
    assert result.gauge == "front_left_camera"
    held = dataset.sensors[result.gauge].edge
    np.testing.assert_array_equal(result.transforms[held], dataset.transforms[held][0])
    assert ("world", "pattern_link") not in result.transforms
    found = truth_error(result.dataset, truth)
    assert found.translation_mm < 0.6
    assert found.rotation_deg < 0.04
    assert "'pattern_1' cannot be told apart: the robot rotates about a single axis only" in result.not_determined
    (said,) = (each for each in diagnose(result, dataset, Options(), Limits()) if each.kind == "not-determined")
    assert said.severity == "warning"
    assert "'front_left_camera' is held where the robot's description puts it" in said.text
    assert "add collections with rotations about another axis, or hold 'pattern_1'" in said.text


def test_with_a_known_pose_of_the_base_all_is_determined():
    dataset, _ = base_that_turns_about_one_axis(5)
    result = calibrate(dataset, Options(hold=("pattern_1",)))
    assert result.converged
    assert not result.not_determined
    assert result.gauge is None


def test_one_camera_on_such_a_base_is_refused():
    dataset, _ = base_that_turns_about_one_axis(5)
    one = replace(dataset, sensors={"front_left_camera": dataset.sensors["front_left_camera"]})
    collections = tuple(
        replace(c, labels={key: label for key, label in c.labels.items() if key[1] in one.sensors})
        for c in one.collections
    )
    with pytest.raises(UndeterminedError, match=r"a single axis only, .*, or hold 'pattern_1' if its place"):
        calibrate(replace(one, collections=collections))


@pytest.mark.parametrize("wobble", [0.005, 0.015])
def test_a_small_tilt_about_the_other_axes_is_enough_with_large_standard_deviations(wobble):
    rng = np.random.default_rng(0)
    turns = np.concatenate([rng.normal(size=(12, 2)) * wobble, TURNS], 1)
    scene = replace(rotating(eye_to_hand(12), turns), pixel_noise=0.3)
    result = calibrate(scene.dataset(1))
    well = calibrate(eye_to_hand(12, pixel_noise=0.3).dataset(1))
    assert result.converged
    for edge in result.covariances:
        assert result.sigma_mm(edge) > 2 * well.sigma_mm(edge)
        assert 1e3 * errors(scene.dataset(1), {edge: result.transforms[edge]})[0] < 3 * result.sigma_mm(edge)


@pytest.mark.parametrize("scene", [eye_to_hand, eye_in_hand])
def test_an_arm_that_never_turns(scene):
    assert "the robot never rotates" in refusal(rotating(scene(12), 0 * TURNS * [1.0, 1.0, 1.0]))


@pytest.mark.parametrize("scene", [eye_to_hand, eye_in_hand])
def test_poses_of_an_arm_that_is_not_the_one_that_moves(scene):
    dataset = scene(12, pixel_noise=0.3).dataset()
    edge = next(edge for edge in dataset.transforms if edge[1] == "flange")
    trembling = np.random.default_rng(0).normal(scale=1e-6, size=(12, 6))
    still = retract(np.repeat(dataset.transforms[edge][:1], 12, 0), trembling)
    with pytest.raises(UndeterminedError, match="cannot be told apart: the robot never moves"):
        calibrate(replace(dataset, transforms={**dataset.transforms, edge: still}))


@pytest.mark.parametrize("scene", [eye_to_hand, eye_in_hand, two_bodies])
def test_two_poses_of_an_arm(scene):
    assert "2 views, at least 3 with different rotations are needed" in refusal(scene(2))


@pytest.mark.parametrize("scene", [stereo, eye_to_hand, eye_in_hand, camera_and_lidar])
def test_one_collection(scene):
    assert "1 collection has labels; at least 2 are needed" in refusal(scene(1))


@pytest.mark.parametrize("anchored", [None, "left", "right"])
def test_static_cameras_that_share_no_collection(anchored):
    message = refusal(stereo(8, anchored=anchored, **ALTERNATING))
    assert "the sensors {left} and {right} share no collection of a pattern" in message


def test_cameras_on_two_bodies_that_share_no_collection():
    assert "{a} and {b} share no collection" in refusal(two_bodies(8, **ALTERNATING))


@pytest.mark.parametrize("anchored", [None, "left"])
def test_a_single_static_camera(anchored):
    scene = stereo(8)
    message = refusal(replace(scene, sensors=scene.sensors[:1], anchored=anchored))
    assert "nothing to calibrate" in message
    assert "world-left" in message


@pytest.mark.parametrize("static", [True, False])
def test_a_transform_that_no_label_depends_on(static):
    scene = stereo(8) if static else eye_to_hand(8)
    transforms = {**scene.transforms, ("world", "unused"): np.eye(4)}
    message = refusal(replace(scene, transforms=transforms, additional=(("world", "unused"),)))
    assert "'world-unused' does not lie between any sensor and a pattern that it sees" in message


def test_two_transforms_in_a_row_with_nothing_that_moves_between():
    """The base of the arm and the camera, both in the world: they can move together."""
    message = refusal_named(replace(eye_to_hand(12), additional=(("world", "base"),)))
    assert "'world-cam'" in message
    assert "'world-base'" in message


def refusal_named(scene: Scene) -> str:
    """The refusal without the numbers that noise changes."""
    with pytest.raises(UndeterminedError) as error:
        calibrate(replace(scene, pixel_noise=0.3, range_noise=0.005).dataset())
    message = str(error.value)
    assert "\n" not in message
    assert "the labels do not determine" in message
    return message


def test_a_lidar_that_sees_the_pattern_from_one_side_only_as_it_slides():
    """Parallel planes leave a LiDAR free to slide along them and to turn about their normal, in any mixture."""
    scene = camera_and_lidar(8, border=False)
    edge = ("world", "board_link")
    shifts = transform(np.eye(3), np.random.default_rng(0).uniform(-0.2, 0.2, (8, 3)))
    message = refusal_named(replace(scene, transforms={**scene.transforms, edge: shifts @ scene.transforms[edge][0]}))
    assert "'world-lidar' moving along" in message
    assert message.count("'world-lidar'") >= 2


@pytest.mark.parametrize("sensor", ["left", "right"])
def test_a_sensor_without_labels(sensor):
    message = refusal(stereo(6, sees=lambda s, _, __: s != sensor), InputError)
    assert message.endswith(f"sensor '{sensor}': no collection has enough labels of it")


@pytest.mark.parametrize("fixed", [True, False])
def test_an_undetected_pattern_is_left_out(fixed):
    scene = stereo(6, pixel_noise=0.3, sees=lambda _, pattern, __: pattern == "board")
    transforms = {**scene.transforms, ("world", "extra_link"): pose(1, 2, 3)}
    dataset = replace(scene, patterns=[*scene.patterns, board("extra", fixed=fixed)], transforms=transforms).dataset()
    result = calibrate(dataset)
    assert result.converged
    assert "pattern 'extra': no collection has enough labels of it" in result.notes
    edge = ("world", "extra_link")
    np.testing.assert_array_equal(result.dataset.transforms[edge], dataset.transforms[edge])


@pytest.mark.parametrize("size", [1e154, 1e300])
@pytest.mark.parametrize("options", [Options(), Options(start="given", loss="linear")], ids=["robust", "plain"])
def test_numbers_that_linear_algebra_cannot_solve_are_an_error_of_the_data(size, options):
    def far(i: int, _: str, label: Labels) -> Labels:
        if i != 2 or not isinstance(label, PointLabels):
            return label
        return PointLabels(label.points * np.where(np.arange(len(label.points)) == 3, size, 1.0)[:, None], label.limits)

    dataset = relabelled(camera_and_lidar(6).dataset(), far)
    with (
        np.errstate(all="ignore"),
        pytest.raises(UndeterminedError, match=r"^scene/dataset\.json: found numbers that cannot be solved"),
    ):
        calibrate(dataset, options)


def test_a_corner_far_off_does_not_put_the_pattern_behind_its_camera():
    def far(i: int, _: str, label: Labels) -> Labels:
        scale = np.where((i == 2) & (np.arange(len(label.ids)) == 3), 1e300, 1.0)
        return CornerLabels(label.ids, label.pixels * scale[:, None])

    with np.errstate(all="ignore"):
        result = calibrate(relabelled(eye_to_hand(12, pixel_noise=0.3).dataset(), far))
    assert not result.converged
    assert result.reason.endswith("labels lie too far off to be compared with the pattern in collection 002")


def test_the_reason_is_that_of_the_whole_system_if_relative_poses_are_not_determined_either():
    dataset, _ = base_that_turns_about_one_axis(6)
    two = ("front_left_camera", "front_right_camera")
    collections = tuple(  # which the cameras see in turn
        replace(c, labels={key: label for key, label in c.labels.items() if key[1] == two[i % 2]})
        for i, c in enumerate(dataset.collections)
    )
    apart = replace(dataset, sensors={name: dataset.sensors[name] for name in two}, collections=collections)
    with pytest.raises(UndeterminedError, match="about a single axis only"):
        calibrate(apart)


def test_a_refusal_without_views_that_contradict_the_others_names_them():
    """Only where its reported poses are wrong does the arm turn about a second axis."""
    turns = np.concatenate([TURNS * [0.0, 0.6, 0.8], [[0.3, 0.0, 0.0], [-0.3, 0.1, 0.0]]])
    dataset = replace(rotating(eye_to_hand(14), turns), pixel_noise=0.1).dataset()
    moved = dataset.transforms["base", "flange"].copy()
    moved[12:, :2, 3] += [[0.3, 0.0], [0.0, -0.4]]
    with pytest.raises(
        UndeterminedError, match=r"single axis only.*\(left out, as .* contradict the others: 012, 013\)"
    ):
        calibrate(dataset.with_transforms({("base", "flange"): moved}))
