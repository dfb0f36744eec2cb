from dataclasses import replace

import cv2
import numpy as np
import pytest

from calibration.base import InputError
from calibration.robot.simulation.rendering.texture import (
    INK_REFLECTANCE,
    MAX_TEXELS,
    PAPER_REFLECTANCE,
    TEXELS_PER_UNIT,
    texture,
)
from tests.robot.simulation.rendering.views import APRILGRID, CHARUCO, CHESSBOARD, SMALL

SIDES = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize("rows", [7, 8])
def test_a_charuco_board_is_the_one_of_opencv(rows: int, legacy: bool) -> None:
    pattern = replace(CHARUCO, dimension=(11, rows))
    print_ = texture(pattern, legacy).levels[0][1:-1, 1:-1]
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    board = cv2.aruco.CharucoBoard((12, rows + 1), pattern.size, 0.045, dictionary)
    board.setLegacyPattern(legacy)
    theirs = board.generateImage((12 * TEXELS_PER_UNIT, (rows + 1) * TEXELS_PER_UNIT), marginSize=0, borderBits=1)
    ours = print_ > (INK_REFLECTANCE + PAPER_REFLECTANCE) / 2
    differ = ours != (theirs > 0)
    assert differ.mean() < 0.01  # theirs has the edges of modules on whole texels
    assert not cv2.erode(differ.astype(np.uint8), np.ones((3, 3))).any()


def test_the_layouts_differ_where_the_rows_of_squares_are_even() -> None:
    even, odd = replace(CHARUCO, dimension=(11, 7)), CHARUCO
    assert texture(odd, True).levels[0].tobytes() == texture(odd, False).levels[0].tobytes()
    assert texture(even, False).levels[0][1, 1] == INK_REFLECTANCE
    assert texture(even, True).levels[0][1, 1] == PAPER_REFLECTANCE


def test_a_chessboard() -> None:
    image = texture(CHESSBOARD).levels[0][1:-1, 1:-1]
    assert image.shape == (7 * TEXELS_PER_UNIT, 10 * TEXELS_PER_UNIT)
    assert (image[:TEXELS_PER_UNIT, :TEXELS_PER_UNIT] == INK_REFLECTANCE).all()
    assert (image[:TEXELS_PER_UNIT, TEXELS_PER_UNIT : 2 * TEXELS_PER_UNIT] == PAPER_REFLECTANCE).all()
    assert (image[-TEXELS_PER_UNIT:, -TEXELS_PER_UNIT:] == PAPER_REFLECTANCE).all()


def test_an_aprilgrid_has_tags_that_are_upside_down_for_opencv() -> None:
    """From the bottom left on; black squares where gaps cross, of which there is one more than tags each way."""
    print_ = texture(replace(APRILGRID, dimension=(3, 2)))
    image = print_.levels[0][1:-1, 1:-1]
    assert print_.size == pytest.approx((4.2, 2.9))
    assert image.shape == (3 * TEXELS_PER_UNIT, 5 * TEXELS_PER_UNIT)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    for tag in range(6):
        left, bottom = (0.3 + 1.3 * n for n in (tag % 3, tag // 3))
        theirs = cv2.aruco.generateImageMarker(dictionary, tag, 10, borderBits=2)[::-1, ::-1]
        middles = TEXELS_PER_UNIT * (np.arange(10) + 0.5) / 10
        x, y = (
            (TEXELS_PER_UNIT * left + middles).astype(int),
            (TEXELS_PER_UNIT * (2.9 - bottom - 1) + middles).astype(int),
        )
        np.testing.assert_array_equal(image[y[:, None], x] == PAPER_REFLECTANCE, theirs == 255)
    at = TEXELS_PER_UNIT * (0.15 + 1.3 * np.arange(4))
    assert (image[at[:3, None].astype(int), at.astype(int)] == INK_REFLECTANCE).all()
    assert (image[at[:3, None].astype(int), (at[:3] + 0.6 * TEXELS_PER_UNIT).astype(int)] == PAPER_REFLECTANCE).all()
    assert (image[int(2.9 * TEXELS_PER_UNIT) + 1 :] == PAPER_REFLECTANCE).all()


def test_the_corners_of_tags_lie_where_black_and_white_meet_crosswise() -> None:
    print_, pattern = texture(APRILGRID), APRILGRID.pattern()
    for k in (0, 2):
        offset, scale = print_.place(pattern, APRILGRID.size, k)
        texel = offset + scale * pattern.corners[:, :2]
        x, y = np.round(texel + (6 >> k) * SIDES[:, None]).astype(int).T
        a, b, c, d = print_.levels[k][y, x].T.astype(int)
        np.testing.assert_array_equal(a, c)
        np.testing.assert_array_equal(b, d)
        np.testing.assert_array_equal(np.abs(a - b), PAPER_REFLECTANCE - INK_REFLECTANCE)


def test_halving_keeps_the_mean() -> None:
    levels = [level[1:-1, 1:-1] for level in texture(CHARUCO).levels]
    assert [level.shape[1] for level in levels] == [12 * TEXELS_PER_UNIT >> k for k in range(9)]
    for level in levels:
        assert level.mean() == pytest.approx(levels[0].mean(), abs=0.5)
    black_and_white = levels[-1].astype(float)
    assert np.ptp(black_and_white[::2, ::2]) == 0


def test_corners_lie_on_the_corners_of_squares() -> None:
    for pattern in (CHARUCO, CHESSBOARD, SMALL):
        print_ = texture(pattern)
        for k in (0, 3, 8):
            offset, scale = print_.place(pattern.pattern(), pattern.size, k)
            texel = offset + scale * pattern.pattern().corners[:, :2]
            np.testing.assert_allclose((texel + 0.5 - print_.margin) / (TEXELS_PER_UNIT >> k) % 1, 0, atol=1e-9)
            np.testing.assert_allclose(texel[0] + 0.5 - print_.margin, TEXELS_PER_UNIT >> k)


def test_without_a_border_the_squares_go_on() -> None:
    bare = texture(replace(CHESSBOARD, border_size=(0.0, 0.0)))
    assert bare.levels[0].shape == (7 * TEXELS_PER_UNIT, 10 * TEXELS_PER_UNIT)


def test_a_board_of_very_many_squares_has_smaller_ones() -> None:
    many = texture(replace(CHESSBOARD, dimension=(1000, 200)))
    assert many.texels == 8
    assert many.levels[0].shape[1] <= MAX_TEXELS + 2
    assert len(many.levels) == 4


@pytest.mark.parametrize(("density", "level"), [(0.0, 0), (0.3, 0), (1.0, 0), (1.4, 0), (1.5, 1), (4.1, 2), (1e9, 8)])
def test_a_level_of_about_one_texel_a_sample(density: float, level: int) -> None:
    assert texture(CHARUCO).level(density) == level


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"dictionary": "DICT_4X4_50"},
            "54 markers are needed for 12 x 9 squares, but DICT_4X4_50 has 50; take a larger",
        ),
        ({"dictionary": "DICT_9X9_50"}, "dictionary: found 'DICT_9X9_50', expected one of OpenCV's, such as"),
        ({"dictionary": "CharucoBoard"}, "dictionary: found 'CharucoBoard', expected one of"),
        ({"dictionary": None}, "dictionary: found '', expected one of"),
        ({"inner_size": None}, "found no inner_size"),
    ],
)
def test_what_cannot_be_printed_is_refused(change: dict[str, str | None], message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        texture(replace(CHARUCO, **change))
    assert str(error.value).startswith("pattern 'pattern_1': ")
    assert "\n" not in str(error.value)
