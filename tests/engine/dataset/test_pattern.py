import numpy as np
import pytest

from calibration.engine.dataset.pattern import Pattern, corner_origin, grid, outline


@pytest.mark.parametrize(
    ("kind", "version", "origin"),
    [("charuco", "3.0", 0.06), ("charuco", "2.0", 0), ("chessboard", "3.0", 0), ("chessboard", "2.0", 0)],
)
def test_where_corner_0_lies(kind, version, origin):
    assert corner_origin(kind, version, 0.06) == (origin, origin)


def test_the_papers_board_is_80_by_60_cm_with_either_origin():
    for origin in ((0.0, 0.0), (0.06, 0.06)):
        corners, border = grid(11, 8, 0.06, origin), outline(11, 8, 0.06, (0.04, 0.03), origin)
        np.testing.assert_allclose(border[2] - border[0], [0.8, 0.6])
        np.testing.assert_allclose(corners[12, :2] - corners[0, :2], [0.06, 0.06])  # along a row first
        np.testing.assert_allclose(corners.mean(0)[:2], border.mean(0))  # the corners in the middle of the board
        assert not corners[:, 2].any()


def test_centre_and_size():
    corners = grid(3, 2, 2.0, (1.0, 1.0))
    pattern = Pattern("p", "charuco", "link", "world", False, corners, outline(3, 2, 2.0, (0, 0), (1, 1)))
    np.testing.assert_allclose(pattern.centre, [3, 2, 0])
    assert pattern.size == pytest.approx(np.sqrt((4 * 5 + 2 * 1) / 6))
