"""What a camera saw, all collections at once."""

import numpy as np
import pytest

from calibration.engine.dataset.model import CornerLabels
from calibration.engine.evaluation.views import corner_views
from calibration.engine.geometry.transforms import distance
from tests.engine.evaluation.scene import WIDE, two_cameras, with_labels


def test_each_view_gives_the_pose_of_the_pattern():
    dataset, T_world_pattern = two_cameras(n=6, right=WIDE)
    views = corner_views(dataset, "right", dataset.patterns["board"])
    expected = dataset.transform("right_optical", "world") @ T_world_pattern
    np.testing.assert_array_equal(views.collections, np.arange(6))
    assert max(values.max() for values in distance(expected, views.T_camera_pattern)) < 1e-6


def test_labels_stand_at_their_ids():
    dataset, _ = two_cameras(n=2)
    label = dataset.collections[1].labels["board", "left"]
    assert isinstance(label, CornerLabels)
    some = CornerLabels(label.ids[[20, 3, 7, 15, 29]], label.pixels[[20, 3, 7, 15, 29]])
    views = corner_views(with_labels(dataset, "left", [None, some]), "left", dataset.patterns["board"])
    assert views.collections.tolist() == [1]
    assert np.flatnonzero(views.seen[0]).tolist() == sorted(some.ids)
    np.testing.assert_array_equal(views.pixels[0][:, label.ids[7]], label.pixels[7])
    assert (views.rays[0][:, ~views.seen[0]] == 0).all()


def test_a_camera_that_saw_nothing_has_no_views():
    dataset, _ = two_cameras(n=2)
    blind = with_labels(dataset, "left", [None, None])
    assert corner_views(blind, "left", dataset.patterns["board"]).T_camera_pattern.shape == (0, 4, 4)


def test_they_are_computed_once_whatever_the_transforms():
    dataset, _ = two_cameras(seed=3, n=3)
    board = dataset.patterns["board"]
    first = corner_views(dataset, "left", board)
    assert corner_views(dataset.with_transforms({("left_mount", "left_link"): np.eye(4)}), "left", board) is first
    assert corner_views(dataset, "right", board) is not first
    other = with_labels(dataset, "left", [None, None, None])
    assert len(corner_views(other, "left", board).collections) == 0
    with pytest.raises(ValueError, match="read-only"):
        first.pixels[0, 0, 0] = 0
