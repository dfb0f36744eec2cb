"""Corners carried from camera to camera: known values on real data, exact scenes, and what they must notice."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.dataset.model import CornerLabels, Dataset
from calibration.engine.dataset.pattern import grid
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.evaluation.two_sensors import inter_collection_rgb_to_rgb, rgb_to_rgb
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.rotations import exp
from calibration.engine.geometry.transforms import apply, from_xyz_rpy, inverse, retract, transform, translation
from tests.engine.evaluation.scene import WIDE, arm, corner_labels, cut, two_cameras, with_labels


def moved(dataset: Dataset, edge: tuple[str, str], twist: list[float]) -> Dataset:
    return dataset.with_transforms(
        {edge: retract(dataset.transforms[edge], np.broadcast_to(twist, (len(dataset.keys), 6)))}
    )


def test_the_papers_dataset_gives_the_known_table(shared_data):
    dataset = read_dataset(shared_data / "t2rgb-paper")
    table = rgb_to_rgb(dataset, "right_camera", "left_camera")
    text = table.to_csv()
    lines = text.splitlines()
    assert lines[0] == "Collection #,RMS (pix),X err (pix),Y err (pix),Trans (mm),Rot (deg)"
    assert lines[1].startswith("000,0.6447,0.3653,0.2773,")
    assert lines[-1] == "Averages,0.6078,0.2936,0.2500,1.8313,0.2996"
    assert len(table.labels) == 16
    assert table.left_out == ()


# Two cameras of a robot as ATOM calibrated it (`softbot_example`, nig_0.1_run001, collection 000) and what each
# sees of its board: translation (m), rotation vector (rad).
T_RIGHT_LEFT = [-0.0453795, 0.0395623, -0.1541482, -0.0020974, -0.3743601, 0.1693397]
T_LEFT_BOARD = [0.1860703, 0.1267512, 2.1952337, -0.5731355, 0.0995774, -0.5055248]
T_RIGHT_BOARD = [-0.7880252, 0.1226591, 2.0404742, -0.4714069, -0.3159323, -0.4704677]


@pytest.mark.parametrize("origin", [0.06, 0.0])
def test_millimetres_are_those_of_atoms_published_table(origin):
    """ATOM's board begins at its first corner: the published row ends in 129.0287 mm, 1.8683 deg."""
    camera = Camera(1108.509382382374, 1108.509382382374, 640.5, 360.5, 1280, 720)
    T_right_left, T_left_board, T_right_board = (
        transform(exp(np.array(each[3:])), each[:3]) for each in (T_RIGHT_LEFT, T_LEFT_BOARD, T_RIGHT_BOARD)
    )
    base, _ = two_cameras(n=1)
    board = replace(base.patterns["board"], corners=grid(11, 8, 0.06, (origin, origin)))
    identity = dict.fromkeys(base.transforms, np.eye(4))
    dataset = replace(base, patterns={"board": board}).with_cameras({"left": camera, "right": camera})
    dataset = dataset.with_transforms({**identity, ("world", "right_mount"): inverse(T_right_left)})
    to_origin = translation([0.06 - origin, 0.06 - origin, 0])
    for sensor, T in (("left", T_left_board), ("right", T_right_board)):
        label = corner_labels(camera, board, T @ to_origin, np.zeros((88, 2)))
        dataset = with_labels(dataset, sensor, [label])
    row = rgb_to_rgb(dataset, "left", "right").values[0]
    np.testing.assert_allclose(row[3:], [129.0287, 1.8683], atol=1e-4)


def test_true_transforms_without_noise_leave_no_error():
    for right in (WIDE, None):
        dataset, _ = two_cameras(noise=0.0, **({"right": right} if right else {}))
        table = rgb_to_rgb(dataset, "left", "right")
        assert len(table.labels) == len(dataset.keys)
        np.testing.assert_allclose(table.values, 0, atol=1e-4)
        assert (table.averages == 0).all()


def test_it_is_the_homography_that_the_plane_induces():
    """ATOM's own formula: H = K_t [r1 r2 t]_tTp inv(K_s [r1 r2 t]_sTp), labels mapped by H."""
    dataset, T_world_pattern = two_cameras(seed=1)
    dataset = moved(dataset, ("right_mount", "right_link"), [0.01, 0.02, -0.01, 0.01, 0.005, -0.02])
    table = rgb_to_rgb(dataset, "left", "right")
    left, right = (dataset.sensors[name] for name in ("left", "right"))
    truth, _ = two_cameras(seed=1)
    for row, i in zip(table.values, range(len(dataset.keys)), strict=True):
        a, b = (dataset.collections[i].labels["board", name] for name in ("left", "right"))
        assert isinstance(a, CornerLabels)
        assert isinstance(b, CornerLabels)
        T_sp = truth.transform("left_optical", "world")[i] @ T_world_pattern[i]  # what the exact labels give
        T_tp = dataset.transform("right_optical", "left_optical")[i] @ T_sp
        H = right.camera.K @ T_tp[:3, [0, 1, 3]] @ np.linalg.inv(left.camera.K @ T_sp[:3, [0, 1, 3]])
        common, in_a, in_b = np.intersect1d(a.ids, b.ids, return_indices=True)
        mapped = np.column_stack([a.pixels[in_a], np.ones(len(common))]) @ H.T
        error = mapped[:, :2] / mapped[:, 2:] - b.pixels[in_b]
        np.testing.assert_allclose(row[0], np.sqrt((error**2).sum(1).mean()), rtol=1e-5)
        np.testing.assert_allclose(row[1:3], np.abs(error).mean(0), rtol=1e-5)


def test_a_wrong_transform_shows_in_pixels_and_in_millimetres():
    dataset, _ = two_cameras(seed=2)
    table = rgb_to_rgb(moved(dataset, ("right_mount", "right_link"), [0, 0.01, 0, 0, 0, 0]), "left", "right")
    np.testing.assert_allclose(table.values[:, 3], 10, atol=1e-3)  # 10 mm across
    np.testing.assert_allclose(table.values[:, 4], 0, atol=1e-4)
    assert table.average("X err (pix)") > 3
    turned = rgb_to_rgb(moved(dataset, ("right_link", "right_optical"), [0, 0, 0, 0, 0, 0.01]), "left", "right")
    np.testing.assert_allclose(turned.values[:, 4], np.degrees(0.01), atol=1e-4)


def test_the_gauge_does_not_matter():
    dataset, _ = two_cameras(seed=3, noise=0.3)
    G = from_xyz_rpy([0.5, -1, 2], [1, 2, 3])
    mounts = {("world", f"{s}_mount"): G @ dataset.transforms["world", f"{s}_mount"] for s in ("left", "right")}
    np.testing.assert_allclose(
        rgb_to_rgb(dataset.with_transforms(mounts), "left", "right").values,
        rgb_to_rgb(dataset, "left", "right").values,
        atol=1e-8,
    )


def test_only_corners_of_equal_id_are_compared():
    dataset, _ = two_cameras(seed=4, noise=0.3)
    whole = rgb_to_rgb(dataset, "left", "right")
    rng = np.random.default_rng(4)
    labels = []
    for collection in dataset.collections:
        label = collection.labels["board", "right"]
        assert isinstance(label, CornerLabels)
        order = rng.permutation(len(label.ids))
        labels.append(CornerLabels(label.ids[order], label.pixels[order]))
    np.testing.assert_allclose(rgb_to_rgb(with_labels(dataset, "right", labels), "left", "right").values, whole.values)
    partial = [CornerLabels(label.ids[:12], label.pixels[:12]) for label in labels]
    table = rgb_to_rgb(with_labels(dataset, "right", partial), "left", "right")
    assert not np.allclose(table.values[:, 0], whole.values[:, 0])
    assert (table.values[:, 0] < 1.5).all()


def test_rows_are_the_collections_that_both_saw():
    dataset, _ = two_cameras(seed=5)
    labels = [c.labels["board", "left"] if i in (1, 4, 6) else None for i, c in enumerate(dataset.collections)]
    assert rgb_to_rgb(with_labels(dataset, "left", labels), "left", "right").labels == ("001", "004", "006")


def test_a_view_that_gives_no_pose_is_left_out_and_said():
    dataset, _ = two_cameras(seed=6, n=3)
    table = rgb_to_rgb(cut(dataset, "right", [30, 3, 6]), "left", "right")  # six corners are one row of the pattern
    assert table.labels == ("000",)
    assert table.left_out == (
        "001: the 3 corners that right sees do not give a pose",
        "002: the 6 corners that right sees do not give a pose",
    )


def test_no_row_is_an_error_that_says_why():
    dataset, _ = two_cameras(seed=7, n=2)
    with pytest.raises(
        InputError, match=r"nothing seen by both: 'left' has 2 views, 'right' has 0 views; 000: the 2 corners"
    ):
        rgb_to_rgb(cut(dataset, "right", [2, 2]), "left", "right")
    first = dataset.collections[0].labels["board", "left"]
    apart = with_labels(
        with_labels(dataset, "left", [first, None]), "right", [None, dataset.collections[1].labels["board", "right"]]
    )
    with pytest.raises(InputError, match="nothing seen by both: 'left' has 1 views, 'right' has 1 views"):
        rgb_to_rgb(apart, "left", "right")


def test_views_without_a_common_corner_are_an_error():
    dataset, _ = two_cameras(seed=8, n=1)
    left, right = (dataset.collections[0].labels["board", s] for s in ("left", "right"))
    split = with_labels(dataset, "left", [CornerLabels(left.ids[:12], left.pixels[:12])])
    split = with_labels(split, "right", [CornerLabels(right.ids[12:], right.pixels[12:])])
    with pytest.raises(InputError, match="'left' and 'right' see no corner in common"):
        rgb_to_rgb(split, "left", "right")


def test_a_camera_against_itself_in_one_collection_is_refused():
    dataset, _ = two_cameras(seed=9, n=2)
    with pytest.raises(InputError, match="'left' against itself tests nothing"):
        rgb_to_rgb(dataset, "left", "left")


def test_names_that_do_not_exist_are_told_with_those_that_do():
    dataset, _ = two_cameras(seed=10, n=2)
    with pytest.raises(InputError, match=r"dataset.json: no sensor 'middle' \(sensors: left, right\)"):
        rgb_to_rgb(dataset, "left", "middle")
    with pytest.raises(InputError, match=r"no pattern 'card' \(patterns: board\)"):
        rgb_to_rgb(dataset, "left", "right", "card")


def test_a_missing_transform_is_an_error_only_where_it_is_needed():
    dataset, _ = two_cameras(seed=11, n=3)
    broken = dataset.transforms["world", "left_mount"].copy()
    broken[1] = np.nan
    dataset = dataset.with_transforms({("world", "left_mount"): broken})
    with pytest.raises(InputError, match="collections/001/transforms: no 'world-left_mount'"):
        rgb_to_rgb(dataset, "left", "right")
    assert rgb_to_rgb(dataset.with_collections([0, 2]), "left", "right").labels == ("000", "002")


# Between collections


def test_a_camera_against_itself_has_a_row_for_each_unordered_pair():
    table = inter_collection_rgb_to_rgb(arm(seed=12, n=5), "eye", "eye")
    pairs = itertools.combinations(("000", "001", "002", "003", "004"), 2)
    assert table.labels == tuple("-".join(pair) for pair in pairs)
    np.testing.assert_allclose(table.values, 0, atol=1e-4)
    assert table.to_csv().splitlines()[0] == "Collection #,RMS (pix),X err (pix),Y err (pix),Trans (mm),Rot (deg)"


@pytest.mark.parametrize("eye_in_hand", [False, True])
def test_a_wrong_mount_shows_between_collections(eye_in_hand):
    dataset = arm(seed=13, n=6, noise=0.2, eye_in_hand=eye_in_hand)
    true = inter_collection_rgb_to_rgb(dataset, "eye", "eye").average("RMS (pix)")
    assert 0.2 < true < 1
    wrong = moved(dataset, ("eye_mount", "eye_link"), [0.01, 0, 0, 0, 0.02, 0])
    assert inter_collection_rgb_to_rgb(wrong, "eye", "eye").average("RMS (pix)") > 3 * true


def test_a_wrong_pattern_pose_does_not_show():
    dataset = arm(seed=14, n=4)
    wrong = moved(dataset, ("flange", "board_link"), [0.1, 0, 0, 0, 0, 0])
    np.testing.assert_allclose(inter_collection_rgb_to_rgb(wrong, "eye", "eye").values, 0, atol=1e-4)


def two_eyes() -> Dataset:
    """The second camera of the rig has a pattern that stands still in the world: it moves against nothing."""
    dataset, T_world_pattern = two_cameras(seed=15, n=3)
    board = replace(dataset.patterns["board"], fixed=True, parent_link="carrier")
    return replace(dataset, patterns={"board": board}).with_transforms({("world", "carrier"): T_world_pattern})


def test_two_cameras_have_a_row_for_each_ordered_pair():
    dataset = two_eyes()
    table = inter_collection_rgb_to_rgb(dataset, "left", "right")
    assert table.labels == tuple(f"{a}-{b}" for a in dataset.keys for b in dataset.keys)
    np.testing.assert_allclose(table.values, 0, atol=1e-4)


def test_the_pose_between_collections_goes_through_the_patterns_parent():
    dataset = two_eyes()
    left = dataset.collections[0].labels["board", "left"]
    right = dataset.collections[2].labels["board", "right"]
    table = inter_collection_rgb_to_rgb(
        moved(dataset, ("right_mount", "right_link"), [0.01, 0, 0, 0, 0, 0]), "left", "right"
    )
    row = table.values[table.labels.index("000-002")]
    assert isinstance(left, CornerLabels)
    assert isinstance(right, CornerLabels)
    wrong = moved(dataset, ("right_mount", "right_link"), [0.01, 0, 0, 0, 0, 0])
    board = dataset.patterns["board"]
    T: Array = inverse(wrong.transform("carrier", "right_optical")[2])
    expected = dataset.sensors["right"].camera.project(apply(T, board.corners[right.ids])) - right.pixels
    np.testing.assert_allclose(row[0], np.sqrt((expected**2).sum(1).mean()), rtol=1e-4)


def test_a_pattern_that_moves_freely_cannot_be_compared_between_collections():
    dataset, _ = two_cameras(seed=16, n=2)
    with pytest.raises(InputError, match="pattern 'board' is not fixed"):
        inter_collection_rgb_to_rgb(dataset, "left", "left")


def test_one_collection_has_no_pair():
    with pytest.raises(InputError, match="nothing seen by both: 'eye' has 1 views, 'eye' has 1 views"):
        inter_collection_rgb_to_rgb(arm(seed=17, n=1), "eye", "eye")


def test_many_pairs_are_done_in_parts(monkeypatch):
    dataset = arm(seed=18, n=6, noise=0.3)
    whole = inter_collection_rgb_to_rgb(dataset, "eye", "eye").to_csv()
    monkeypatch.setattr("calibration.engine.evaluation.two_sensors._PAIRS_PER_CHUNK", 4)
    assert inter_collection_rgb_to_rgb(dataset, "eye", "eye").to_csv() == whole
