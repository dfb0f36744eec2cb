"""LiDARs and depth cameras against each other."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from calibration.base import InputError
from calibration.engine.dataset.modalities import LIDAR2D
from calibration.engine.dataset.model import Dataset, PointLabels
from calibration.engine.evaluation import two_sensors
from calibration.engine.evaluation.two_sensors import depth_to_depth, lidar_to_depth, lidar_to_lidar, nearest
from calibration.engine.geometry.transforms import apply, retract
from tests.engine.evaluation.scene import CAMERA, range_pair, with_labels

METRES = ("RMS (m)", "X err (m)", "Y err (m)", "X StDev (m)", "Y StDev (m)")
PIXELS = ("RMS (pix)", "X err (pix)", "Y err (pix)", "X StDev (pix)", "Y StDev (pix)")


def shifted(dataset: Dataset, sensor: str, shift) -> Dataset:
    edge = dataset.sensors[sensor].edge
    return dataset.with_transforms(
        {edge: retract(dataset.transforms[edge], np.broadcast_to([*shift, 0, 0, 0], (len(dataset.keys), 6)))}
    )


def two_points(source, target, limits=True) -> Dataset:
    """A LiDAR and another sensor with these points of one collection, each in its own frame."""
    dataset, _ = range_pair(0, 1, ("lidar3d", "lidar3d"))
    for name, points in (("one", source), ("two", target)):
        points = np.array(points, float)
        dataset = with_labels(dataset, name, [PointLabels(points, np.arange(len(points) if limits else 0))])
    return dataset


def test_lidars_are_compared_point_by_point_in_the_targets_frame():
    target = np.array([[2.0, 0, 0], [2.0, 1, 0], [2.0, 1, 1]])
    offsets = np.array([[0.03, 0, 0.04], [0.01, -0.02, 0.02], [0, 0, 0]])
    base = two_points(target, target)
    source = apply(base.transform("one_scan", "two_scan")[0], target + offsets)
    table = lidar_to_lidar(with_labels(base, "one", [PointLabels(source, np.arange(0))]), "one", "two")
    assert (table.key, table.columns, table.labels) == ("Collection #", METRES, ("000",))
    x, y = np.abs(offsets[:, 0]), np.abs(offsets[:, 1])
    expected = [np.sqrt((0.05**2 + 0.03**2) / 3), x.mean(), y.mean(), x.std(), y.std()]
    np.testing.assert_allclose(table.values, [expected], atol=1e-12)


def test_every_target_point_counts_and_not_every_source_point():
    base = two_points([[0.0, 0, 0]], [[0.0, 0, 0]])
    T = base.transform("one_scan", "two_scan")[0]
    source = PointLabels(apply(T, np.array([[1.0, 0, 0], [9.0, 9, 9]])), np.arange(0))
    dataset = with_labels(base, "one", [source])
    dataset = with_labels(dataset, "two", [PointLabels(np.array([[1.0, 0, 0], [1.0, 0.1, 0]]), np.arange(0))])
    np.testing.assert_allclose(lidar_to_lidar(dataset, "one", "two").values[0, 0], np.sqrt(0.01 / 2))


@pytest.mark.parametrize("kinds", [("lidar3d", "depth"), ("depth", "depth")])
def test_depth_images_show_a_shift_in_pixels(kinds):
    dataset, _ = range_pair(1, 6, kinds)
    table = depth_to_depth if kinds[0] == "depth" else lidar_to_depth
    right = table(dataset, "one", "two")
    assert (right.key, right.columns, right.labels) == ("Collection #", PIXELS, dataset.keys)
    assert right.average("RMS (pix)") < 4  # every fourth pixel was taken
    wrong = table(shifted(dataset, "two", [0, 0.03, 0]), "one", "two")  # to the left, about 14 px
    assert wrong.average("RMS (pix)") > 2 * right.average("RMS (pix)")
    assert wrong.average("X err (pix)") > wrong.average("Y err (pix)")


def test_border_pixels_are_compared_with_the_nearest():
    dataset, _ = range_pair(0, 1, ("lidar3d", "depth"))
    border = np.array([[100.0, 100], [300.0, 200]])
    seen = np.array([[103.0, 104], [300.0, 199], [10.0, 240], [320.0, 470], [635.0, 100], [-50.0, 100]])
    depth = np.array([2.0, 3.0])
    target = np.column_stack([CAMERA.normalise(border), [1, 1]]) * depth[:, None]
    rays = np.column_stack([CAMERA.normalise(seen), np.ones(6)])
    source = apply(dataset.transform("one_scan", "two_optical")[0], np.concatenate([rays * 2, [[0, 0, -1.0]]]))
    dataset = with_labels(dataset, "one", [PointLabels(source, np.arange(7))])
    dataset = with_labels(dataset, "two", [PointLabels(target, np.arange(2))])
    # those nearer to the edge than 2.5 % of the image, and those beside or behind it, do not count
    expected = [np.sqrt((25 + 1) / 2), 1.5, 2.5, 1.5, 1.5]
    np.testing.assert_allclose(lidar_to_depth(dataset, "one", "two").values, [expected], atol=1e-9)


def test_collections_are_compared_through_the_link_of_the_pattern():
    dataset, _ = range_pair(2, 3, ("depth", "depth"), fixed=True)
    table = depth_to_depth(dataset, "one", "two", between=True)
    assert table.key == "Collection #"
    assert table.labels == tuple(f"{a}-{b}" for a in dataset.keys for b in dataset.keys)
    assert table.average("RMS (pix)") < 4
    same = depth_to_depth(dataset, "one", "two")
    np.testing.assert_allclose(table.values[::4], same.values, atol=1e-9)  # 000-000, 001-001, 002-002
    assert lidar_to_depth(range_pair(2, 3, fixed=True)[0], "one", "two", between=True).key == "Collection #"


def test_a_lidar_is_compared_with_itself_once_for_each_pair():
    dataset, _ = range_pair(3, 3, ("lidar3d", "lidar3d"), fixed=True)
    own = lidar_to_lidar(dataset, "one", "one", between=True)
    assert own.key == "Collection Pair"
    assert own.labels == ("000-001", "000-002", "001-002")
    assert own.average("RMS (m)") < 0.02  # other places on the same board
    flange = dataset.transforms["world", "flange"].copy()
    flange[1, 0, 3] += 0.1
    moved = lidar_to_lidar(dataset.with_transforms({("world", "flange"): flange}), "one", "one", between=True)
    assert moved.values[0, 0] > 0.05
    np.testing.assert_allclose(moved.values[1], own.values[1])
    with pytest.raises(InputError, match="'one' against itself tests nothing in one collection: use an inter-coll"):
        lidar_to_lidar(dataset, "one", "one")


def test_a_2d_lidar_is_compared_with_a_3d_one_and_not_the_other_way_round():
    """A cut lies near the points of a whole pattern; they do not lie near it."""
    dataset, _ = range_pair(2, 3, ("lidar3d", "lidar3d"))
    cut = [PointLabels(label.points[60:70], np.arange(2)) for _, label in dataset.detections("board", "two")]
    flat = replace(dataset.sensors["two"], modality=LIDAR2D)
    dataset = replace(with_labels(dataset, "two", cut), sensors={**dataset.sensors, "two": flat})
    assert lidar_to_lidar(dataset, "one", "two").average("RMS (m)") < 0.05
    with pytest.raises(InputError, match=r"sensor 'two' is lidar2d, not lidar3d \(lidar3d: one\)"):
        lidar_to_lidar(dataset, "two", "one")


def test_what_cannot_be_compared_is_told():
    dataset, _ = range_pair(4, 2)
    with pytest.raises(InputError, match="pattern 'board' is not fixed"):
        lidar_to_depth(dataset, "one", "two", between=True)
    with pytest.raises(InputError, match=r"sensor 'two' is depth, not lidar3d or lidar2d \(lidar3d or lidar2d: one\)"):
        lidar_to_lidar(dataset, "one", "two")
    with pytest.raises(InputError, match=r"sensor 'one' is lidar3d, not depth \(depth: two\)"):
        depth_to_depth(dataset, "two", "one")
    blind = replace(dataset, sensors={**dataset.sensors, "two": replace(dataset.sensors["two"], camera=None)})
    with pytest.raises(InputError, match="sensor 'two' has no intrinsics"):
        lidar_to_depth(blind, "one", "two")
    none = with_labels(dataset, "two", [None, None])
    with pytest.raises(InputError, match=r"nothing seen by both: 'one' has 2 views, 'two' has 0 views$"):
        lidar_to_depth(none, "one", "two")


def test_a_collection_without_border_points_is_left_out():
    dataset, _ = range_pair(5, 2)
    labels = [c.labels["board", "two"] for c in dataset.collections]
    labels[0] = replace(labels[0], limits=np.arange(0))
    left = with_labels(dataset, "two", labels)
    table = lidar_to_depth(left, "one", "two")
    assert table.labels == ("001",)
    assert table.left_out == ("000: no border point of one is on the image beside one of two",)
    with pytest.raises(InputError, match=r"nothing seen by both: .*; 000: no border point of one is on the image"):
        lidar_to_depth(left.with_collections([0]), "one", "two")


@given(st.integers(0, 2**32 - 1), st.integers(0, 40), st.integers(1, 40), st.integers(1, 3))
def test_no_other_point_lies_nearer(seed, count, among, dimensions):
    rng = np.random.default_rng(seed)
    points, others = rng.normal(size=(count, dimensions)), rng.normal(size=(among, dimensions)) + 100
    found = np.linalg.norm(points - others[nearest(points, others)], axis=-1)
    least = np.linalg.norm(points[:, None] - others, axis=-1).min(-1)
    np.testing.assert_allclose(found, least, rtol=1e-12)


@pytest.mark.parametrize("chunk", [1, 7000, 1 << 20])
def test_a_tree_finds_the_same_whatever_the_chunk(monkeypatch, chunk):
    monkeypatch.setattr(two_sensors, "_CHUNK", chunk)
    rng = np.random.default_rng(1)
    points, others = rng.normal(size=(300, 3)), rng.normal(size=(500, 3))
    np.testing.assert_array_equal(nearest(points, others), cKDTree(others).query(points)[1])
