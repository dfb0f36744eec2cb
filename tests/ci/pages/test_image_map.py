"""Map over an image: a cell for each number, in its place, stronger where it is larger."""

import re

import numpy as np

from calibration.ci.pages.figures import COLOUR_STEPS, CORNER_STEPS, image_map


def test_each_number_is_a_cell_at_its_place_and_none_where_there_is_none() -> None:
    drawn = str(image_map("Map", (560, 420), np.array([[0.01, 0.3], [np.nan, 30.0], [0.012, 0.31]])))
    paths = re.findall(r'<path d="(.*?)"', drawn)
    assert paths == ["M0 0h1v1h-1zM0 2h1v1h-1z", "M1 0h1v1h-1zM1 2h1v1h-1z", "M1 1h1v1h-1z"]
    assert drawn.count('transform="scale(280 140)"') == 3
    assert "Map: at most 30 px" in drawn
    assert "nan" not in drawn.lower()


def test_larger_numbers_are_stronger_and_the_scale_has_every_step() -> None:
    for steps in (COLOUR_STEPS, CORNER_STEPS):
        drawn = str(image_map("Map", (640, 480), np.array([[edge * 1.01 for edge in steps]]), "corners", steps))
        opacities = [float(each) for each in re.findall(r'fill-opacity="([\d.]+)"', drawn)]
        cells, scale = opacities[: len(steps)], opacities[len(steps) :]
        assert cells == sorted(set(cells))
        assert scale == sorted(set(scale))
        assert cells == scale[1:]
        assert f"{steps[-1]:g} corners" in drawn


def test_a_map_without_numbers_is_a_frame() -> None:
    drawn = str(image_map("Map", (640, 480), np.full((2, 2), np.nan)))
    assert "at most" not in drawn
