"""Chessboards and grids of circles: where the truth projects them, numbered by a rule that holds when turned."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from calibration.base import InputError
from calibration.base.arrays import Array, BoolArray
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.model import CornerLabels
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import apply
from calibration.robot.labelling import unmarked_grids as chessboards
from calibration.robot.labelling.board_image import refine
from calibration.robot.labelling.corner_detector import corner_detector
from calibration.robot.labelling.detection import Image, NotDetected
from calibration.robot.labelling.unmarked_grids import ChessboardDetector
from calibration.robot.simulation.kinematics import stream
from calibration.robot.simulation.scene import Scene
from calibration.robot.simulation.sensors import SimulatedCamera
from tests.robot.labelling.pictures import HD, HD_DISTORTED, VGA, Photograph, charuco, chessboard, facing, true_corners
from tests.robot.simulation.rendering.views import T_WORLD_CAMERA, board

UNIQUE, TWOFOLD, SQUARE, SQUARE_FOURFOLD = chessboard(10, 7), chessboard(9, 7), chessboard(7, 7), chessboard(6, 6)


def detected(pattern, T, camera=VGA, **how) -> CornerLabels:
    found = corner_detector(pattern).detect(Photograph(camera, **how).of(pattern, T))
    assert isinstance(found, CornerLabels), found
    np.testing.assert_array_equal(found.ids, np.arange(len(found.ids)))
    return found


def test_corners_are_where_the_truth_projects_them() -> None:
    off = []
    for i in range(5):
        T = facing(UNIQUE, 1.0 + 0.2 * i, 0.15 * i, i, 0.3 * i, (0.05 * i - 0.1, 0.03))
        off.append(detected(UNIQUE, T, HD, supersampling=2).pixels - true_corners(HD, UNIQUE, T))
    off = np.concatenate(off)
    assert np.sqrt((off**2).sum(-1).mean()) < 0.05
    assert np.linalg.norm(off, axis=-1).max() < 0.2
    assert np.abs(off.mean(axis=0)).max() < 0.01


@pytest.mark.thorough(but_first=3)
@pytest.mark.parametrize("roll", np.linspace(-np.pi, np.pi, 9))
def test_a_board_without_symmetry_keeps_its_ids_at_any_angle(roll) -> None:
    """Ten by seven corners: eleven by eight squares, and only one of its ends begins with black."""
    T = facing(UNIQUE, 1.2, 0.3, 0.5, roll)
    assert np.linalg.norm(detected(UNIQUE, T).pixels - true_corners(VGA, UNIQUE, T), axis=-1).max() < 0.5


@pytest.mark.thorough(but_first=3)
@pytest.mark.parametrize("pattern", [TWOFOLD, SQUARE, SQUARE_FOURFOLD])
@pytest.mark.parametrize("roll", [-0.5, 0.0, 0.4])
def test_other_boards_are_numbered_from_the_most_upright_corner(pattern, roll) -> None:
    T = facing(pattern, 1.2, 0.3, 0.5, roll)
    assert np.linalg.norm(detected(pattern, T).pixels - true_corners(VGA, pattern, T), axis=-1).max() < 0.5


def test_upside_down_they_are_numbered_from_the_other_end() -> None:
    T = facing(TWOFOLD, 1.2, 0.3, 0.5, np.pi - 0.1)
    assert np.linalg.norm(detected(TWOFOLD, T).pixels - true_corners(VGA, TWOFOLD, T)[::-1], axis=-1).max() < 0.5


@pytest.mark.thorough(but_first=4)
@pytest.mark.parametrize("pattern", [UNIQUE, TWOFOLD, SQUARE, SQUARE_FOURFOLD])
@pytest.mark.parametrize("roll", [0.2, 1.5, 3.0, -2.0])
def test_never_mirrored(pattern, roll) -> None:
    grid = detected(pattern, facing(pattern, 1.3, 0.4, 1.0, roll)).pixels
    grid = grid.reshape(pattern.dimension[1], pattern.dimension[0], 2)
    x, y = np.diff(grid, axis=1).mean((0, 1)), np.diff(grid, axis=0).mean((0, 1))
    assert x[0] * y[1] - x[1] * y[0] > 0


def test_light_that_varies_over_the_board_is_no_colour() -> None:
    T = facing(UNIQUE, 1.2, 0.2, 0.0, 0.1)
    image = Photograph(VGA).of(UNIQUE, T) * np.linspace(0.15, 1.0, 640)
    found = ChessboardDetector(UNIQUE).detect(image.astype(np.uint8))
    assert isinstance(found, CornerLabels)
    assert np.linalg.norm(found.pixels - true_corners(VGA, UNIQUE, T), axis=-1).max() < 1


@pytest.mark.thorough(but_first=3)
@pytest.mark.parametrize("spot", [2, 5, 8])
@pytest.mark.parametrize("corners", [(34,), (0,), (0, 13, 27, 69)])
def test_corners_under_a_spot_are_left_out_and_cost_no_other(spot, corners) -> None:
    T = facing(UNIQUE, 1.2, 0.3, 0.5, 0.1)
    image, truth = Photograph(VGA).of(UNIQUE, T), true_corners(VGA, UNIQUE, T)
    for x, y in np.round(truth[list(corners)]).astype(int).tolist():
        cv2.circle(image, (x + 2, y), spot, 60, -1)
    found = ChessboardDetector(UNIQUE).detect(image)
    assert isinstance(found, CornerLabels), found
    assert found.ids.tolist() == [i for i in range(70) if i not in corners]
    assert np.linalg.norm(found.pixels - truth[found.ids], axis=-1).max() < 0.2


@pytest.mark.parametrize(("bad", "kept"), [(17, True), (18, False)])
def test_a_board_of_which_a_quarter_is_no_good_is_none(monkeypatch: pytest.MonkeyPatch, bad: int, kept: bool) -> None:
    def spoilt(*arguments: Any) -> tuple[Array, BoolArray]:
        refined, found = refine(*arguments)
        found[:bad] = False
        return refined, found

    monkeypatch.setattr(chessboards, "refine", spoilt)
    found = ChessboardDetector(UNIQUE).detect(Photograph(VGA).of(UNIQUE, facing(UNIQUE, 1.2, 0.3, 0.5, 0.1)))
    if kept:
        assert isinstance(found, CornerLabels)
    else:
        assert found == NotDetected(f"{bad} of 70 corners do not look like corners of a board")


def test_a_truncated_or_occluded_board_is_not_detected() -> None:
    assert isinstance(
        ChessboardDetector(UNIQUE).detect(Photograph(VGA).of(UNIQUE, facing(UNIQUE, 0.6, at=(0.4, 0)))), NotDetected
    )
    hidden = Photograph(VGA).of(UNIQUE, facing(UNIQUE, 1.0), hidden=((300, 200, 380, 280), 128))
    assert isinstance(ChessboardDetector(UNIQUE).detect(hidden), NotDetected)


@pytest.mark.parametrize("shape", [(0, 0), (1, 1), (1, 1000), (30, 30), (480, 5), (0, 4, 3)])
def test_images_too_small_for_anything(shape) -> None:
    assert isinstance(ChessboardDetector(UNIQUE).detect(np.zeros(shape, np.uint8)), NotDetected)


def test_noise_and_nothing_are_no_boards() -> None:
    noise = np.random.default_rng(0).integers(0, 256, (240, 320), dtype=np.uint8)
    for image in (noise, np.zeros_like(noise), np.full((240, 320, 3), 255, np.uint8)):
        found = ChessboardDetector(UNIQUE).detect(image)
        assert isinstance(found, NotDetected)
        assert found.reason == "not all corners of the chessboard are found"


def test_what_is_no_image_and_no_board() -> None:
    with pytest.raises(InputError, match="8 bits a channel"):
        ChessboardDetector(UNIQUE).detect(np.zeros((480, 640)))
    with pytest.raises(InputError, match="2 x 7 corners, expected at least 3 each way"):
        corner_detector(chessboard(2, 7))


def nothing_found(*_: Any, **__: Any) -> tuple[bool, None]:
    return False, None


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("camera", [VGA, HD_DISTORTED])
def test_the_older_detector_finds_what_the_newer_one_misses_as_accurately(
    monkeypatch: pytest.MonkeyPatch, camera: Camera
) -> None:
    monkeypatch.setattr(cv2, "findChessboardCornersSB", nothing_found)
    off = [
        detected(UNIQUE, T, camera).pixels - true_corners(camera, UNIQUE, T)
        for T in (facing(UNIQUE, 1.0 + 0.2 * i, 0.15 * i, i, 0.3 * i) for i in range(2))
    ]
    assert np.sqrt((np.concatenate(off) ** 2).sum(-1).mean()) < 0.06


@pytest.mark.parametrize("larger", [(11, 7), (10, 8), (12, 9)])
def test_a_part_of_a_larger_board_is_none(monkeypatch: pytest.MonkeyPatch, larger: tuple[int, int]) -> None:
    """OpenCV's older detector may leave rows and columns out until the size is right."""
    monkeypatch.setattr(cv2, "findChessboardCornersSB", nothing_found)
    for pattern, is_whole in ((chessboard(*larger), False), (UNIQUE, True)):
        T = facing(pattern, 1.2, 0.3, 0.5)
        (columns, rows), truth = pattern.dimension, true_corners(VGA, pattern, T)
        part = truth.reshape(rows, columns, 2)[:7, :10].reshape(-1, 1, 2).astype(np.float32)
        monkeypatch.setattr(cv2, "findChessboardCorners", lambda *_, part=part, **__: (True, part))
        found = ChessboardDetector(UNIQUE).detect(Photograph(VGA).of(pattern, T))
        assert isinstance(found, CornerLabels) == is_whole


def test_every_second_column_of_a_larger_board_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """OpenCV's newer detector found a board of 8 x 5 corners in photographs of one of 11 x 8."""
    monkeypatch.setattr(cv2, "findChessboardCorners", nothing_found)
    pattern, part = chessboard(11, 8), chessboard(8, 5)
    T = facing(pattern, 1.2, 0.3, 0.5)
    every_second = true_corners(VGA, pattern, T).reshape(8, 11, 2)[:, 1::2].swapaxes(0, 1)
    corners = every_second.reshape(-1, 1, 2).astype(np.float32)
    monkeypatch.setattr(cv2, "findChessboardCornersSB", lambda *_, **__: (True, corners))
    assert isinstance(ChessboardDetector(part).detect(Photograph(VGA).of(pattern, T)), NotDetected)


def test_a_charuco_board_is_no_chessboard(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cv2, "findChessboardCornersSB", nothing_found)
    board = charuco(10, 7)
    for i in range(3):
        image = Photograph(VGA).of(board, facing(board, 0.9, 0.1 * i, i))
        assert isinstance(ChessboardDetector(chessboard(10, 7)).detect(image), NotDetected)


BOARDS = {"img_target": (7, 5), "left-00": (8, 6), "img15": (8, 6), "left20": (9, 6), "Right": (7, 10)}
"""Corners of the boards of `door/real/14-detector-misses`, by the beginnings of the files' names."""


def test_public_images_in_which_the_newer_detector_finds_nothing(shared_data: Path) -> None:
    files = sorted((shared_data / "door/real/14-detector-misses").iterdir())
    assert len(files) == 7
    for file in files:
        columns, rows = next(size for begin, size in BOARDS.items() if file.name.startswith(begin))
        found = ChessboardDetector(chessboard(columns, rows)).detect(cv2.imread(str(file)))
        assert isinstance(found, CornerLabels), file.name
        assert len(found.ids) >= 0.9 * columns * rows


def circles(columns: int, rows: int, spacing: float, diameter: float, asymmetric: bool = False) -> PatternConfiguration:
    kind = "asymmetric-circles" if asymmetric else "circles"
    size = (columns, rows)
    return PatternConfiguration("grid", kind, "grid", "world", False, size, spacing, diameter, (0.02, 0.02))


SYMMETRIC, ASYMMETRIC = (
    circles(9, 6, 0.05, 0.035),
    circles(4, 11, 0.03, 0.025, True),
)


def rendered(pattern: PatternConfiguration, T: Array, camera: Camera = VGA, seed: int = 0) -> Image:
    view = board(T, pattern)
    return SimulatedCamera(camera).render(T_WORLD_CAMERA, Scene(ground=0.0), [view], stream(seed))


def off(pattern: PatternConfiguration, T: Array, camera: Camera = VGA, image: Image | None = None) -> Array:
    found = corner_detector(pattern).detect(rendered(pattern, T, camera) if image is None else image)
    assert isinstance(found, CornerLabels), found
    assert len(found.ids) == len(pattern.pattern().corners)
    return found.pixels - camera.project(apply(T, pattern.pattern().corners))[found.ids]


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("pattern", [SYMMETRIC, ASYMMETRIC], ids=lambda each: each.kind)
@pytest.mark.parametrize("camera", [VGA, HD_DISTORTED], ids=["pinhole", "distorted"])
def test_centres_of_large_circles_have_no_bias_at_45_degrees(pattern: PatternConfiguration, camera: Camera) -> None:
    """The centres of the dark areas are 0.2 px off there: towards the camera, and so each of a view to one side."""
    for towards in (0.0, 1.2, 2.5):
        T = facing(pattern, 0.75 if camera is VGA else 0.95, np.pi / 4, towards, 0.2)
        error = off(pattern, T, camera)
        assert np.sqrt((error**2).sum(-1).mean()) < 0.03
        assert np.abs(error.mean(0)).max() < 0.02


@pytest.mark.parametrize("roll", np.linspace(-np.pi, np.pi, 7))
def test_an_asymmetric_grid_of_odd_rows_keeps_its_ids_at_any_angle(roll: float) -> None:
    assert np.abs(off(ASYMMETRIC, facing(ASYMMETRIC, 0.75, 0.3, 0.5, roll))).max() < 0.1


def test_a_symmetric_grid_is_numbered_from_the_more_upright_end() -> None:
    pattern = SYMMETRIC
    assert np.abs(off(pattern, facing(pattern, 0.9, 0.3, 0.5, 1.2))).max() < 0.1
    T = facing(pattern, 0.9, 0.3, 0.5, np.pi - 0.2)
    found = corner_detector(pattern).detect(rendered(pattern, T))
    assert isinstance(found, CornerLabels), found
    assert np.abs(found.pixels - VGA.project(apply(T, pattern.pattern().corners))[::-1]).max() < 0.1


def test_uneven_light_and_inverted_colours_move_no_centre() -> None:
    T = facing(SYMMETRIC, 0.9, 0.4, 1.0, 0.1)
    light = np.linspace(0.4, 1.0, VGA.width)[:, None]
    assert np.abs(off(SYMMETRIC, T, image=(rendered(SYMMETRIC, T) * light).astype(np.uint8))).max() < 0.1
    inverted = replace(SYMMETRIC, inverted=True)
    assert np.abs(off(inverted, T)).max() < 0.1


def test_a_covered_circle_is_left_out_and_moves_no_other() -> None:
    T = facing(SYMMETRIC, 0.9, 0.4, 1.0, 0.1)
    image, truth = rendered(SYMMETRIC, T), VGA.project(apply(T, SYMMETRIC.pattern().corners))
    x, y = np.round(truth[20]).astype(int).tolist()
    image[y - 12 : y - 4, x - 12 : x + 12] = 200
    found = corner_detector(SYMMETRIC).detect(image)
    assert isinstance(found, CornerLabels), found
    assert found.ids.tolist() == [i for i in range(54) if i != 20]
    assert np.abs(found.pixels - truth[found.ids]).max() < 0.1


def test_another_diameter_than_described_is_said() -> None:
    image = rendered(SYMMETRIC, facing(SYMMETRIC, 0.9, 0.3))
    found = corner_detector(replace(SYMMETRIC, inner_size=0.0175)).detect(image)
    assert isinstance(found, NotDetected)
    assert "times as large as described" in found.reason


@pytest.mark.parametrize("shape", [(0, 0), (1, 1), (3, 40), (40, 3), (100, 100)])
def test_images_without_a_grid(shape: tuple[int, int]) -> None:
    for image in (np.zeros(shape, np.uint8), np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)):
        assert isinstance(corner_detector(SYMMETRIC).detect(image), NotDetected)


def test_what_cannot_be_found_is_refused() -> None:
    with pytest.raises(InputError, match="2 x 6 circles"):
        corner_detector(circles(2, 6, 0.05, 0.03))
    with pytest.raises(InputError, match=r"10 rows, expected an odd number"):
        corner_detector(circles(4, 10, 0.03, 0.02, True))
    with pytest.raises(InputError, match="diameter"):
        corner_detector(replace(SYMMETRIC, inner_size=None))
