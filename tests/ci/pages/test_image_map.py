"""Map over an image: a cell for each number, in its place, stronger where it is larger."""

import re

import numpy as np

from calibration.ci.pages.image_figures import COLOUR_STEPS, image_map


def test_each_number_is_a_cell_at_its_place_and_none_where_there_is_none() -> None:
    values = np.array([[0.01, 0.3], [np.nan, 30.0]])
    drawn = str(image_map("Map", (640, 480), values))
    titles = re.findall(r"<title>\((\d+), (\d+)\): ([^<]*) px</title>", drawn)
    assert titles == [("160", "120", "0.01"), ("480", "120", "0.3"), ("480", "360", "30")]
    assert "Map: at most 30 px" in drawn
    assert "nan" not in drawn.lower()


def test_larger_numbers_are_stronger_and_the_scale_has_every_step() -> None:
    values = np.array([[edge * 1.01 for edge in COLOUR_STEPS]])
    opacities = [
        float(each) for each in re.findall(r'fill-opacity="([\d.]+)"', str(image_map("Map", (640, 480), values)))
    ]
    cells, scale = opacities[: len(COLOUR_STEPS)], opacities[len(COLOUR_STEPS) :]
    assert cells == sorted(set(cells))
    assert scale == sorted(set(scale))
    assert cells == scale[1:]


def test_a_map_without_numbers_is_a_frame() -> None:
    drawn = str(image_map("Map", (640, 480), np.full((2, 2), np.nan)))
    assert "at most" not in drawn
