"""Boards as they are printed: the first id, inverted colours, mirrored backs, a spacing that the images do not show."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.__main__ import main
from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.dataset.configuration import APRILGRID_TAGS, PatternConfiguration
from calibration.engine.dataset.model import CornerLabels
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import Equidistant
from calibration.robot.importing.image_views import View, view_of_image
from calibration.robot.importing.near_miss import check_spacing, check_told_apart, never_seen
from calibration.robot.labelling.corner_detector import corner_detector
from calibration.robot.labelling.detection import Image
from calibration.robot.simulation.rendering.texture import texture
from tests.robot.importing.conftest import change
from tests.robot.labelling.pictures import VGA, Photograph, charuco, facing, true_corners

BOARD = charuco(8, 5)
GRID = PatternConfiguration(
    "grid", "aprilgrid", "grid", "world", False, (6, 6), 0.088, None, (0.03, 0.03), APRILGRID_TAGS, spacing=0.3
)
FISHEYE = Camera(300.0, 300.0, 421.0, 302.0, 848, 600, Equidistant(-0.012, 0.045, -0.036, 0.006))


def hint(pattern: PatternConfiguration, *images: Image) -> str:
    detectors = {pattern.name: corner_detector(pattern)}
    views = [view_of_image(image, f"{i}.png", detectors) for i, image in enumerate(images)]
    assert not any(view.labelled for view in views)
    return str(never_seen("camera", pattern, views, lambda i: images[i]))


def with_print(pattern: PatternConfiguration, T: Array) -> Image:
    """A camera's view of a pattern as the simulation prints it."""
    printed = texture(pattern)
    offset, scale = printed.place(pattern.pattern(), pattern.size, 2)
    T_texel_board = np.array([[scale, 0, offset[0]], [0, scale, offset[1]], [0, 0, 1]])
    K = np.array([[VGA.fx, 0, VGA.cx], [0, VGA.fy, VGA.cy], [0, 0, 1]])
    H = K @ T[:3, [0, 1, 3]] @ np.linalg.inv(T_texel_board)
    seen = cv2.warpPerspective(printed.levels[2], H, (640, 480), flags=cv2.INTER_LINEAR, borderValue=(120.0,))
    return np.asarray(seen, np.uint8)


@pytest.mark.parametrize(
    "pattern",
    [
        replace(BOARD, first_marker=27),
        replace(BOARD, inverted=True),
        replace(BOARD, first_marker=40, inverted=True),
        replace(GRID, first_marker=100),
    ],
)
def test_what_the_simulation_prints_the_detector_finds(pattern: PatternConfiguration) -> None:
    T = facing(pattern, 1.0, 0.3, 0.5, 0.2)
    found = corner_detector(pattern).detect(with_print(pattern, T))
    assert isinstance(found, CornerLabels), found
    off = found.pixels - true_corners(VGA, pattern, T)[found.ids]
    assert len(found.ids) > 0.8 * len(pattern.pattern().corners)
    assert np.linalg.norm(off, axis=-1).max() < 1.5
    usual = replace(pattern, first_marker=0, inverted=False)
    assert not isinstance(corner_detector(usual).detect(with_print(pattern, T)), CornerLabels)


def test_ids_that_begin_elsewhere_are_named() -> None:
    printed = replace(BOARD, first_marker=27)
    image = with_print(printed, facing(printed, 1.0, 0.2))
    assert "ids 27 to 53, expected 0 to 26: the ids begin at 27: add 'first: 27'" in hint(BOARD, image)


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        (np.bitwise_not, "the board's colours are inverted: add 'inverted: true'"),
        (np.fliplr, "it is seen from its back, mirrored"),
        (lambda i: np.fliplr(np.bitwise_not(i)), "colours are inverted, and it is seen from its back, mirrored"),
    ],
)
def test_inverted_and_mirrored_boards_are_named(changed: Callable[[Image], Image], named: str) -> None:
    image = Photograph(VGA).of(BOARD, facing(BOARD, 1.0, 0.2))
    assert named in hint(BOARD, np.ascontiguousarray(changed(image)))


def test_real_boards_with_inverted_colours(shared_data: Path) -> None:
    folder = shared_data / "door/real/19-inverted-and-mirrored-charuco"
    front, back = (np.asarray(cv2.imread(str(folder / f"sync00{n}.png")), np.uint8) for n in (120, 438))
    board = PatternConfiguration(
        "board", "charuco", "board", "world", False, (3, 4), 0.054, 0.0405, dictionary="DICT_4X4_50"
    )
    assert "colours are inverted: add" in hint(board, front)
    assert "colours are inverted, and it is seen from its back, mirrored" in hint(board, back)
    inverted = replace(board, inverted=True)
    assert isinstance(corner_detector(inverted).detect(front), CornerLabels)
    assert "from its back, mirrored" in hint(inverted, back)


def test_boards_that_share_ids_are_refused() -> None:
    boards = {"one": replace(BOARD, name="one"), "other": replace(BOARD, name="other", first_marker=26)}
    with pytest.raises(InputError, match=r"'one' and 'other' have markers .* with ids 0 to 26 and 26 to 52"):
        check_told_apart(boards)
    check_told_apart({**boards, "other": replace(BOARD, name="other", first_marker=27)})


def grid_views(images: Sequence[Image], described: PatternConfiguration) -> list[View]:
    detectors = {"grid": corner_detector(described)}
    return [view_of_image(image, f"{i}.png", detectors) for i, image in enumerate(images)]


@pytest.mark.parametrize("camera", [VGA, FISHEYE], ids=["pinhole", "fisheye"])
def test_a_spacing_that_the_images_do_not_show_is_refused_with_the_value(camera: Camera) -> None:
    images = [Photograph(camera).of(GRID, facing(GRID, 0.9, 0.12 * i, i)) for i in range(3)]
    check_spacing("camera", GRID, grid_views(images, GRID))
    for wrong in (0.25, 0.4):
        described = replace(GRID, spacing=wrong)
        with pytest.raises(InputError, match=rf"spacing of {wrong:g}, the images show 0\.(29|30)"):
            check_spacing("camera", described, grid_views(images, described))


def test_keys_of_the_print_reach_the_dataset(stereo: Path, tmp_path: Path) -> None:
    for file in stereo.glob("*/*.jpg"):
        cv2.imwrite(str(file), np.bitwise_not(np.asarray(cv2.imread(str(file)))))
    change(stereo, "patterns", "board", "inverted", to=True)
    arguments = ["--config", str(stereo / "import.yml"), "--output", str(tmp_path / "out"), "--jobs", "1"]
    assert main(["import-data", *arguments]) == 0
    document = (tmp_path / "out" / "dataset.json").read_text()
    assert '"inverted": true' in document
    assert read_dataset(tmp_path / "out").collections
