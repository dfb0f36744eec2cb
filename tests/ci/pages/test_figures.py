"""Labels, units and values that a reader can make out."""

import re
from itertools import pairwise

import numpy as np
import pytest

from calibration.ci.pages.charts import ellipses, trend
from calibration.ci.pages.figures import LETTER_HEIGHT, LETTER_WIDTH, Kind, Line, scene
from calibration.ci.pages.html import table

TEXT = re.compile(r'<text x="([-\d.]+)" y="([-\d.]+)" class="small label">(\w+)</text>')
PATH = re.compile(r'<path d="M([^"]*)"')


def lines_of(drawing: str) -> np.ndarray:
    """Points (N, 2) along all lines of a scene, px."""
    found = []
    for text in PATH.findall(drawing):
        corners = np.array([[float(v) for v in point.split()] for point in text.split("L")])
        found += [np.linspace(a, b, 200) for a, b in pairwise(corners)]
    return np.concatenate(found)


def test_labels_of_a_scene_lie_neither_over_the_drawing_nor_over_each_other() -> None:
    square = np.array([(0, 0, 0), (0.1, 0, 0), (0.1, 0, 0.1), (0, 0, 0.1), (0, 0, 0)])
    names = ("front_left_camera", "front_right_camera", "lidar")
    lines = [Line(square + np.array((0.15 * i, 0, 0.05 * i)), "camera", name) for i, name in enumerate(names)]
    lines.append(Line(np.array([(0, 0, 0), (0.05, 0, -0.4), (0.6, 0.5, -0.4)]), "robot"))
    drawing = scene(lines, "a robot", {"camera": Kind("blue", "cameras"), "robot": Kind("green", "links")})
    points = lines_of(drawing)
    boxes = []
    for x, y, name in TEXT.findall(drawing):
        low = np.array((float(x), float(y) + 3 - LETTER_HEIGHT))
        high = low + np.array((LETTER_WIDTH * len(name), LETTER_HEIGHT))
        assert not ((points > low) & (points < high)).all(axis=1).any(), name
        boxes.append((low, high))
    assert len(boxes) == len(names)
    for i, (low, high) in enumerate(boxes):
        assert not any((low < b).all() and (a < high).all() for a, b in boxes[:i])


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("0.12 mm, 0.5 deg, FAIL", "0.12_mm, 0.5_deg, FAIL"),
        ("0.00, -45.00, -0.02 ± 0.046", "0.00,_-45.00,_-0.02_±_0.046"),
        ("0.1 ± 0.03 mm (0.1, 0.0), 0.5 ± 0.02 deg", "0.1_±_0.03_mm_(0.1,_0.0), 0.5_±_0.02_deg"),
        ("the board of 11 x 8 corners was printed anew in May", "the board of 11 x 8 corners was printed anew in May"),
    ],
)
def test_a_table_breaks_lines_between_values_only(text: str, shown: str) -> None:
    made = table(("0 m, 0 rad", text), ((text, text),)).replace("\u00a0", "_")
    mark = ' class="fail"' if "FAIL" in text else ""
    assert f'<th scope="row">{shown}</th><td{mark}>{shown}</td>' in made


def test_axes_have_units_and_several_marks() -> None:
    drawing = trend("right", ["a", "b"], [0.0, 0.0], [0.39, 0.39], "mm")
    assert ">mm</text>" in drawing
    assert len(re.findall(r">(-?\d[\d.]*)</text>", drawing)) >= 3


def test_error_ellipses_say_how_large_they_and_the_limit_are() -> None:
    assert ">at most 4 mm; the circle is the limit, 5 mm</text>" in ellipses("right", np.diag([4.0, 1.0, 1.0]), 5.0)
    assert ">at most 4 mm</text>" in ellipses("right", np.diag([4.0, 1.0, 1.0]), None)
