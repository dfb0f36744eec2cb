"""Evaluations by their text."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.dataset.reading import read_dataset
from calibration.dataset.truth import Truth, find_truth, truth_of
from calibration.errors import InputError
from calibration.evaluation.annotation import annotation_for
from calibration.evaluation.lidar_to_rgb import lidar_to_rgb
from calibration.evaluation.rgb_to_rgb import inter_collection_rgb_to_rgb, rgb_to_rgb
from calibration.evaluation.specification import Evaluation, parse_evaluation
from calibration.geometry.transforms import retract
from tests.evaluation.scene import arm, lidar_and_camera, two_cameras


def test_the_text_names_kind_sensors_and_pattern():
    assert parse_evaluation("rgb-to-rgb:right_camera:left_camera") == Evaluation(
        "rgb-to-rgb", "right_camera", "left_camera"
    )
    assert parse_evaluation(" lidar-to-rgb : lidar : eye : board ") == Evaluation(
        "lidar-to-rgb", "lidar", "eye", "board"
    )


names = st.text(st.characters(categories=("L", "N"), include_characters="_-"), min_size=1)


@given(
    kind=st.sampled_from(["rgb-to-rgb", "inter-collection-rgb-to-rgb", "lidar-to-rgb"]),
    source=names,
    target=names,
    pattern=st.none() | names,
)
def test_what_is_printed_reads_back(kind, source, target, pattern):
    evaluation = Evaluation(kind, source, target, pattern)
    assert parse_evaluation(str(evaluation)) == evaluation


@pytest.mark.parametrize(
    "text",
    [
        "",
        "rgb-to-rgb",
        "rgb-to-rgb:a",
        "rgb-to-rgb:a:",
        "rgb-to-rgb::b",
        "rgb-to-rgb:a:b:c:d",
        "rgb:a:b",
        "rgb_to_rgb:a:b",
    ],
)
def test_another_text_is_told_the_forms(text):
    with pytest.raises(InputError, match=r"expected rgb-to-rgb:SOURCE:TARGET or inter-.* or lidar-to-rgb:LIDAR:CAMERA"):
        parse_evaluation(text)


def test_each_kind_runs_its_table():
    pair, hand = two_cameras(n=3, noise=0.3)[0], arm(n=4, noise=0.3)
    assert (
        parse_evaluation("rgb-to-rgb:left:right:board").run(pair).to_csv() == rgb_to_rgb(pair, "left", "right").to_csv()
    )
    assert (
        parse_evaluation("inter-collection-rgb-to-rgb:eye:eye").run(hand).to_csv()
        == inter_collection_rgb_to_rgb(hand, "eye", "eye").to_csv()
    )
    both, _ = lidar_and_camera(n=2)
    annotation = annotation_for(both, "eye", both.patterns["board"], None)
    assert (
        parse_evaluation("lidar-to-rgb:scan:eye").run(both).to_csv()
        == lidar_to_rgb(both, "scan", "eye", annotation).to_csv()
    )


# Where the annotation comes from


def test_without_truth_it_is_the_cameras_own():
    base, _ = lidar_and_camera(n=2)
    np.testing.assert_allclose(parse_evaluation("lidar-to-rgb:scan:eye").run(base).values, 0, atol=1e-3)


def with_pattern_poses(seed: int):
    base, T_world_pattern = lidar_and_camera(seed=seed, n=3)
    return base, truth_of(base.with_transforms({("world", "board_link"): T_world_pattern}))


def test_the_truth_comes_before_the_cameras_own():
    base, truth = with_pattern_poses(1)
    edge = ("eye_mount", "eye_link")
    wrong = base.with_transforms({edge: retract(base.transforms[edge], np.broadcast_to([0, 0.02, 0, 0, 0, 0], (3, 6)))})
    board = base.patterns["board"]
    right, of_wrong = (annotation_for(d, "eye", board, truth) for d in (base, wrong))
    for key, segments in right.items():
        np.testing.assert_allclose(of_wrong[key], segments, atol=1e-9)  # the image does not know the wrong transform
    assert parse_evaluation("lidar-to-rgb:scan:eye").run(base, truth).average("RMS (pix)") < 1e-4
    assert parse_evaluation("lidar-to-rgb:scan:eye").run(wrong, truth).average("RMS (pix)") > 2


def test_a_fixed_pattern_has_one_true_pose():
    base, truth = with_pattern_poses(2)
    edge = ("world", "board_link")
    fixed = Truth(truth.path, truth.sensors, {**truth.transforms, edge: truth.patterns["001"][edge]}, {})
    annotation = annotation_for(base, "eye", base.patterns["board"], fixed)
    assert list(annotation) == ["000", "001", "002"]
    np.testing.assert_array_equal(annotation["000"], annotation["002"])


def test_a_truth_without_pattern_poses_leaves_it_to_the_camera():
    base, truth = with_pattern_poses(3)
    bare = Truth(truth.path, truth.sensors, truth.transforms, {})
    np.testing.assert_allclose(parse_evaluation("lidar-to-rgb:scan:eye").run(base, bare).values, 0, atol=1e-3)


def test_a_file_beside_the_dataset_comes_first(tmp_path):
    base, truth = with_pattern_poses(4)
    side = {"ixs": [0, 1], "iys": [0, 0]}
    (tmp_path / "annotation_eye.json").write_text(
        json.dumps({"000": dict.fromkeys(("top", "right", "bottom", "left"), side)})
    )
    here = replace(base, path=tmp_path / "dataset.json")
    table = parse_evaluation("lidar-to-rgb:scan:eye").run(here, truth)
    assert table.labels == ("000",)
    assert table.average("RMS (pix)") > 100


def test_the_synthetic_truth_gives_the_annotation_that_came_with_it(shared_data, tmp_path):
    base = read_dataset(shared_data / "synthetic" / "rlbot")
    truth = find_truth(base)
    given, made = (
        parse_evaluation("lidar-to-rgb:lidar_right:rgb_left").run(d, truth)
        for d in (base, replace(base, path=tmp_path / "dataset.json"))
    )
    np.testing.assert_allclose(made.values, given.values, atol=1e-6)
