"""Border points of LiDARs and depth cameras against the pattern's border in the image."""

import json
from dataclasses import replace

import numpy as np
import pytest

from calibration.base import InputError
from calibration.engine.dataset.modalities import DEPTH, LIDAR2D, RGB
from calibration.engine.dataset.model import Dataset, PointLabels
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.evaluation.two_sensors import (
    Annotation,
    annotate,
    annotate_detections,
    depth_to_rgb,
    lidar_to_rgb,
    read_annotation,
)
from calibration.engine.geometry.transforms import apply, retract
from tests.engine.evaluation.scene import (
    CAMERA,
    WIDE,
    corner_labels,
    lidar_and_camera,
    range_pair,
    two_cameras,
    with_labels,
)


def true_annotation(dataset: Dataset, T_world_pattern: np.ndarray) -> Annotation:
    T = dataset.transform("eye_optical", "world") @ T_world_pattern
    return annotate(dataset, "eye", dataset.patterns["board"], dict(enumerate(T)))


@pytest.mark.parametrize("camera", [CAMERA, WIDE])
def test_exact_points_lie_on_the_border(camera):
    dataset, T_world_pattern = lidar_and_camera(camera=camera)
    table = lidar_to_rgb(dataset, "scan", "eye", true_annotation(dataset, T_world_pattern))
    assert table.key == "Collection #"
    assert table.columns == ("RMS (pix)", "X err (pix)", "Y err (pix)")
    assert table.labels == dataset.keys
    # with distortion a side is 32 straight pieces
    np.testing.assert_allclose(table.values, 0, atol=1e-9 if camera is CAMERA else 0.02)


def test_the_cameras_own_corners_give_the_same_annotation():
    dataset, T_world_pattern = lidar_and_camera(seed=1)
    true = true_annotation(dataset, T_world_pattern)
    detected = annotate_detections(dataset, "eye", dataset.patterns["board"])
    assert list(true) == list(detected)
    for key, segments in true.items():
        np.testing.assert_allclose(detected[key], segments, atol=1e-3)


def test_a_shifted_lidar_shows_in_pixels():
    dataset, T_world_pattern = lidar_and_camera(seed=2)
    edge = ("scan_mount", "scan_base")
    wrong = retract(dataset.transforms[edge], np.broadcast_to([0, 0.02, 0, 0, 0, 0], (4, 6)))
    table = lidar_to_rgb(
        dataset.with_transforms({edge: wrong}), "scan", "eye", true_annotation(dataset, T_world_pattern)
    )
    assert table.average("RMS (pix)") > 2


def test_the_distance_is_to_the_nearest_line():
    dataset, _ = lidar_and_camera(n=1)
    square = np.array([[300.0, 220], [340, 220], [340, 260], [300, 260]])
    segments = np.stack([square, np.roll(square, -1, 0)], 1)
    pixels = np.array([[320.0, 223], [345, 240], [290, 210]])  # 3 px inside, 5 px outside, at a corner
    rays = np.column_stack([CAMERA.normalise(pixels), np.ones(3)])
    points = apply(dataset.transform("scan_scan", "eye_optical")[0], 2 * rays)
    one = with_labels(dataset, "scan", [PointLabels(points, np.arange(3))])
    table = lidar_to_rgb(one, "scan", "eye", {"000": segments})
    np.testing.assert_allclose(table.values, [[np.sqrt((9 + 25 + 200) / 3), (5 + 10) / 3, (3 + 10) / 3]])


def test_points_beyond_the_image_do_not_count():
    dataset, T_world_pattern = lidar_and_camera(seed=3, n=2)
    annotation = true_annotation(dataset, T_world_pattern)
    labels = []
    for i, collection in enumerate(dataset.collections):
        label = collection.labels["board", "scan"]
        assert isinstance(label, PointLabels)
        T = dataset.transform("scan_scan", "eye_optical")[i]
        away = apply(T, np.array([[5.0, 0, 1], [0, 0, -1], [0, 0, 0]]))  # beside, behind, in the camera
        labels.append(PointLabels(np.concatenate([label.points, away]), np.append(label.limits, [42, 43, 44])))
    table = lidar_to_rgb(with_labels(dataset, "scan", labels), "scan", "eye", annotation)
    np.testing.assert_allclose(table.values, 0, atol=1e-9)


def test_points_that_distortion_folds_into_the_image_do_not_count():
    dataset, T_world_pattern = lidar_and_camera(seed=7, n=1, camera=WIDE)
    label = dataset.collections[0].labels["board", "scan"]
    assert isinstance(label, PointLabels)
    beside = np.array([[2.45, 0, 1]])  # 68 degrees off the axis
    assert WIDE.contains(WIDE.project(beside)).all()
    points = np.concatenate([label.points, apply(dataset.transform("scan_scan", "eye_optical")[0], beside)])
    more = with_labels(dataset, "scan", [PointLabels(points, np.append(label.limits, 42))])
    table = lidar_to_rgb(more, "scan", "eye", true_annotation(dataset, T_world_pattern))
    np.testing.assert_allclose(table.values, 0, atol=0.02)


def test_what_cannot_be_compared_is_left_out_and_said():
    dataset, T_world_pattern = lidar_and_camera(seed=4)
    annotation = dict(true_annotation(dataset, T_world_pattern))
    del annotation["001"]
    labels = [c.labels["board", "scan"] for c in dataset.collections]
    labels[2] = PointLabels(np.array([[-5.0, 0, 0]] * 12), np.array([0, 3]))
    labels[3] = None
    table = lidar_to_rgb(with_labels(dataset, "scan", labels), "scan", "eye", annotation)
    assert table.labels == ("000",)
    assert table.left_out == (
        "001: the pattern's border is not annotated",
        "002: none of the 2 border points of scan is on the image",
    )


def test_no_row_is_an_error_that_says_why():
    dataset, _ = lidar_and_camera(seed=5, n=1)
    with pytest.raises(InputError, match=r"border points of 'scan' in an annotated image of 'eye'; 000: the pattern's"):
        lidar_to_rgb(dataset, "scan", "eye", {})
    with pytest.raises(InputError, match="no collection shows border points of 'scan'"):
        lidar_to_rgb(with_labels(dataset, "scan", [None]), "scan", "eye", {})


def test_the_ends_of_a_2d_lidars_cuts_are_seen_in_the_image():
    dataset, T_world_pattern = lidar_and_camera(seed=2)
    ends = [PointLabels(label.points, label.limits[:2]) for _, label in dataset.detections("board", "scan")]
    scanner = replace(dataset.sensors["scan"], modality=LIDAR2D)
    flat = replace(with_labels(dataset, "scan", ends), sensors={**dataset.sensors, "scan": scanner})
    table = lidar_to_rgb(flat, "scan", "eye", true_annotation(dataset, T_world_pattern))
    np.testing.assert_allclose(table.values, 0, atol=1e-9)


def test_sensors_of_the_wrong_kind_are_told():
    dataset, T_world_pattern = lidar_and_camera(seed=6, n=1)
    annotation = true_annotation(dataset, T_world_pattern)
    with pytest.raises(InputError, match=r"sensor 'eye' is rgb, not lidar3d or lidar2d \(lidar3d or lidar2d: scan\)"):
        lidar_to_rgb(dataset, "eye", "scan", annotation)
    with pytest.raises(InputError, match=r"sensor 'scan' is lidar3d, not rgb \(rgb: eye\)"):
        lidar_to_rgb(dataset, "scan", "scan", annotation)
    depth = replace(dataset, sensors={**dataset.sensors, "eye": replace(dataset.sensors["eye"], modality=DEPTH)})
    with pytest.raises(InputError, match=r"sensor 'eye' is depth, not rgb \(rgb: none\)"):
        lidar_to_rgb(depth, "scan", "eye", annotation)
    with pytest.raises(InputError, match=r"sensor 'left' is rgb, not lidar3d or lidar2d \(lidar3d or lidar2d: none\)"):
        lidar_to_rgb(two_cameras(n=2)[0], "left", "right", annotation)


def test_a_pattern_partly_behind_the_camera_is_annotated_as_far_as_it_is_seen():
    dataset, _ = lidar_and_camera(n=1)
    T = np.eye(4)
    T[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]  # the pattern reaches from before the camera to behind it
    T[:3, 3] = [0.05, -0.1, 0.1]
    segments = annotate(dataset, "eye", dataset.patterns["board"], {0: T})["000"]
    assert 0 < len(segments) < 4 * 32
    assert np.isfinite(segments).all()


def test_what_distortion_folds_over_is_not_seen():
    z = np.ones(3)
    points = np.column_stack([[0.0, 0.5, 3.0], 0 * z, z])  # this model turns back at about 1.2
    pixels, seen = WIDE.project_visible(points)
    assert seen.tolist() == [True, True, False]
    assert np.isfinite(pixels[:2]).all()


def write(path, sides):
    path.write_text(json.dumps({"003": sides}))
    return path


SIDES = {
    side: {"xs": [0, 9], "ys": [0, 9], "ixs": [1, 2, 3], "iys": [4, 5, 6]}
    for side in ("top", "right", "bottom", "left")
}


def test_atoms_annotation_is_read(tmp_path):
    annotation = read_annotation(write(tmp_path / "a.json", SIDES))
    np.testing.assert_array_equal(annotation["003"][:2], [[[1, 4], [2, 5]], [[2, 5], [3, 6]]])
    assert annotation["003"].shape == (8, 2, 2)
    drawn = {side: {"xs": [0, 9], "ys": [0, 9]} for side in SIDES}
    np.testing.assert_array_equal(read_annotation(write(tmp_path / "b.json", drawn))["003"][0], [[0, 0], [9, 9]])


def test_a_side_without_points_has_no_line(tmp_path):
    empty = {**SIDES, "left": {"xs": [], "ys": [], "ixs": [], "iys": []}}
    assert read_annotation(write(tmp_path / "a.json", empty))["003"].shape == (6, 2, 2)


@pytest.mark.parametrize(
    ("left", "message"),
    [
        (None, r"a.json: 003: missing key 'left'"),
        ({"ixs": [1, 2], "iys": [1]}, r"a.json: 003/left/iys: found a list of 1, expected a list of 2 numbers"),
        ({"ixs": [1, "x"], "iys": [1, 2]}, r"a.json: 003/left/ixs/1: found 'x', expected a"),
        ({"ixs": [1, 2]}, r"a.json: 003/left: missing key 'iys'"),
        ({}, r"a.json: 003/left: missing key 'xs'"),
    ],
)
def test_an_annotation_of_another_form_is_told(tmp_path, left, message):
    sides = {key: value for key, value in {**SIDES, "left": left}.items() if value is not None}
    with pytest.raises(InputError, match=message):
        read_annotation(write(tmp_path / "a.json", sides))


def test_the_synthetic_dataset_agrees_with_the_annotation_that_came_with_it(shared_data):
    dataset = read_dataset(shared_data / "synthetic" / "rlbot")
    given = read_annotation(shared_data / "synthetic" / "rlbot" / "annotation_rgb_left.json")
    made = annotate_detections(dataset, "rgb_left", dataset.patterns["pattern_1"])
    by_given, by_made = (lidar_to_rgb(dataset, "lidar_right", "rgb_left", a) for a in (given, made))
    assert len(by_given.labels) == 18
    assert by_given.average("RMS (pix)") == pytest.approx(1.9113, abs=1e-4)
    np.testing.assert_allclose(by_made.averages, by_given.averages, atol=0.05)


# Depth cameras, and between collections


def depth_and_camera(seed=0, n=3):
    """A depth camera "one", and a camera "two" in the place of the other sensor, before a pattern on an arm."""
    dataset, T_world_pattern = range_pair(seed, n, ("depth", "depth"), fixed=True)
    as_camera = replace(dataset.sensors["two"], modality=RGB)
    dataset = replace(dataset, sensors={**dataset.sensors, "two": as_camera})
    board, T = dataset.patterns["board"], dataset.transform("two_optical", "world") @ T_world_pattern
    seen = [corner_labels(CAMERA, board, t, np.zeros((30, 2))) for t in T]
    return with_labels(dataset, "two", seen), annotate(dataset, "two", board, dict(enumerate(T)))


def test_a_depth_cameras_border_pixels_lie_inside_the_border():
    dataset, annotation = depth_and_camera()
    table = depth_to_rgb(dataset, "one", "two", annotation)
    assert (table.key, table.columns, table.labels) == (
        "Collection #",
        ("RMS (pix)", "X err (pix)", "Y err (pix)"),
        dataset.keys,
    )
    assert 0.5 < table.average("RMS (pix)") < 4  # every fourth pixel was taken
    edge = dataset.sensors["one"].edge
    wrong = retract(dataset.transforms[edge], np.broadcast_to([0, 0.03, 0, 0, 0, 0], (3, 6)))
    assert depth_to_rgb(dataset.with_transforms({edge: wrong}), "one", "two", annotation).average("RMS (pix)") > 5


def test_every_image_shows_the_border_points_of_every_collection():
    dataset, annotation = depth_and_camera(1)
    table = depth_to_rgb(dataset, "one", "two", annotation, between=True)
    assert table.key == "Collection #"
    assert table.labels == tuple(f"{a}-{b}" for a in dataset.keys for b in dataset.keys)
    np.testing.assert_allclose(table.values[::4], depth_to_rgb(dataset, "one", "two", annotation).values, atol=1e-9)
    assert table.average("RMS (pix)") < 4


def test_with_a_lidar_the_cameras_collection_stands_first():
    dataset, T_world_pattern = lidar_and_camera(seed=8, n=3)
    annotation = dict(true_annotation(dataset, T_world_pattern))
    fixed = replace(dataset.patterns["board"], fixed=True, parent_link="flange")
    arm = replace(dataset, patterns={"board": fixed}).with_transforms({("world", "flange"): T_world_pattern})
    table = lidar_to_rgb(arm, "scan", "eye", annotation, between=True)
    assert table.key == "Collection Pair"
    assert table.labels == tuple(f"{a}-{b}" for a in arm.keys for b in arm.keys)
    np.testing.assert_allclose(table.values, 0, atol=1e-9)
    flange = T_world_pattern.copy()
    flange[1, 0, 3] += 0.2  # the arm lies about collection 001: of its own, image and cloud are wrong alike
    wrong = lidar_to_rgb(arm.with_transforms({("world", "flange"): flange}), "scan", "eye", annotation, between=True)
    bad = {label for label, row in zip(wrong.labels, wrong.values, strict=True) if row[0] > 0.1}
    assert bad == {"000-001", "001-000", "001-002", "002-001"}
    # a collection whose cloud alone is wrong spoils the rows in which it stands second
    labels = [c.labels["board", "scan"] for c in arm.collections]
    labels[0] = replace(labels[0], points=labels[0].points + np.array([0, 0.1, 0]))
    wrong = lidar_to_rgb(with_labels(arm, "scan", labels), "scan", "eye", annotation, between=True)
    assert {label for label, row in zip(wrong.labels, wrong.values, strict=True) if row[0] > 0.1} == {
        f"{key}-000" for key in arm.keys
    }
    with pytest.raises(InputError, match="pattern 'board' is not fixed"):
        lidar_to_rgb(dataset, "scan", "eye", annotation, between=True)
    with pytest.raises(
        InputError, match=r"no collection shows border points of 'scan' in an annotated image of 'eye'$"
    ):
        lidar_to_rgb(arm, "scan", "eye", {}, between=True)


def test_a_camera_without_intrinsics_is_told():
    dataset, T_world_pattern = lidar_and_camera(n=1)
    annotation = true_annotation(dataset, T_world_pattern)
    blind = replace(dataset, sensors={**dataset.sensors, "eye": replace(dataset.sensors["eye"], camera=None)})
    with pytest.raises(InputError, match="sensor 'eye' has no intrinsics"):
        lidar_to_rgb(blind, "scan", "eye", annotation)
