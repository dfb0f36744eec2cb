"""The team's own tests of its robot, which run in the image."""

import numpy as np
import pytest
from example_robot.board import Board
from example_robot.camera import Camera

INFO = {"K": [500, 0, 330, 0, 510, 240, 0, 0, 1], "D": [0, 0, 0, 0, 0]}
BOARD = {"dimension": {"x": 8, "y": 5}, "size": 0.06, "inner_size": 0.045, "dictionary": "DICT_5X5_100"}


def test_what_is_straight_ahead_is_at_the_principal_point():
    assert Camera(INFO).project(np.eye(4), np.array([[0.0, 0.0, 2.0]])) == pytest.approx(np.array([[330, 240]]))


def test_the_pose_of_a_board_is_found_from_its_corners():
    camera, corners = Camera(INFO), Board(BOARD).corners
    there = np.array([[1, 0, 0, -0.2], [0, 0, -1, 0.1], [0, 1, 0, 1.5], [0, 0, 0, 1.0]])
    assert camera.board_pose(corners, camera.project(there, corners)) == pytest.approx(there, abs=1e-4)
