"""Boards to print: true to size as SVG and PDF, found by the detector, described by the printed lines."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from defusedxml import ElementTree

from calibration.__main__ import main
from calibration.base.arrays import Array
from calibration.base.records import read
from calibration.engine.dataset.model import CornerLabels
from calibration.robot.importing.description import ImportDescription
from calibration.robot.importing.files.target_files import pattern_configuration
from calibration.robot.labelling.corner_detector import corner_detector

BOARDS = {
    "charuco": ["charuco", "--columns", "8", "--rows", "5", "--square", "20"],
    "legacy-free-first": [
        "charuco",
        "--columns",
        "6",
        "--rows",
        "6",
        "--square",
        "24",
        "--marker",
        "17",
        "--first",
        "40",
    ],
    "chessboard": ["chessboard", "--columns", "9", "--rows", "6", "--square", "20"],
    "inverted": ["charuco", "--columns", "8", "--rows", "5", "--square", "20", "--inverted"],
    "aprilgrid": ["aprilgrid", "--columns", "5", "--rows", "4", "--tag", "30", "--spacing", "0.3"],
    "circles": ["circles", "--columns", "8", "--rows", "5", "--spacing", "20", "--diameter", "12"],
    "asymmetric-circles": ["asymmetric-circles", "--columns", "4", "--rows", "11", "--spacing", "16"],
    "tags": ["tags", "--tag", "100", "--first", "7", "--dictionary", "DICT_APRILTAG_36h11"],
}
DOTS = 8
"""Pixels of a drawing per mm."""


def rectangles(svg: Path, group: str) -> Array:
    """(N, 4): left, top, width, height of a group's rectangles, mm."""
    (found,) = [each for each in ElementTree.parse(svg).getroot() if each.get("id") == group]
    return np.array([[float(rect.attrib[key]) for key in ("x", "y", "width", "height")] for rect in found]).reshape(
        -1, 4
    )


def circles(svg: Path) -> Array:
    """(N, 3): centres and radii, mm."""
    found = [each for each in ElementTree.parse(svg).getroot() if each.tag.endswith("circle")]
    return np.array([[float(each.attrib[key]) for key in ("cx", "cy", "r")] for each in found]).reshape(-1, 3)


def of_pdf(pdf: Path) -> tuple[Array, float, float]:
    """All rectangles (N, 4) of a page like those of an SVG, and the page's width and height, mm."""
    text = pdf.read_bytes().decode("ascii")
    width, height = (float(n) * 25.4 / 72 for n in re.search(r"MediaBox \[0 0 (\S+) (\S+)\]", text).groups())  # type: ignore[union-attr]
    left, bottom, w, h = np.array(re.findall(r"(\S+) (\S+) (\S+) (\S+) re", text), float).T * 25.4 / 72
    return np.stack([left, height - bottom - h, w, h], -1), width, height


def drawn(svg: Path, inverted: bool) -> Array:
    root = ElementTree.parse(svg).getroot()
    width, height = (float(root.attrib[key].removesuffix("mm")) for key in ("width", "height"))
    image = np.full((round(height * DOTS), round(width * DOTS)), 255, np.uint8)
    for group, grey in (("board", 0 if inverted else 255), ("print", 255 if inverted else 0), ("ruler", 0)):
        for x, y, w, h in rectangles(svg, group) * DOTS:
            image[round(y) : round(y + h), round(x) : round(x + w)] = grey
    for x, y, radius in 256 * DOTS * circles(svg) - [128, 128, 0]:
        cv2.circle(image, (round(x), round(y)), round(radius), 255 if inverted else 0, -1, cv2.LINE_AA, 8)
    return image


@pytest.mark.thorough(but_first=3)
@pytest.mark.parametrize("name", BOARDS)
def test_a_board_is_true_to_size_and_found(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["pattern", *BOARDS[name], "--output", str(tmp_path / "board")]) == 0
    lines = yaml.safe_load(capsys.readouterr().out)
    described = read(ImportDescription, {"sensors": {"a": {"images": "a"}}, **lines}, "printed lines").patterns[0]
    pattern = pattern_configuration(described, "world")
    svg = tmp_path / "board.svg"
    found = corner_detector(pattern).detect(cv2.GaussianBlur(drawn(svg, pattern.inverted), (0, 0), 1.0))
    assert isinstance(found, CornerLabels), found
    corners = pattern.pattern().corners
    assert len(found.ids) == len(corners)
    mm = (found.pixels + 0.5) / DOTS
    expected = 1000 * corners[found.ids, :2]
    np.testing.assert_allclose(mm - mm[0], expected - expected[0], atol=0.1)
    in_pdf, width, height = of_pdf(tmp_path / "board.pdf")
    in_svg = np.concatenate([rectangles(svg, group) for group in ("board", "print", "ruler")])
    np.testing.assert_allclose(in_pdf, in_svg, atol=1e-3)
    right = np.array(re.findall(r"(\S+) (\S+) m ", (tmp_path / "board.pdf").read_text("ascii")), float) * 25.4 / 72
    right = right.reshape(-1, 2)
    x, y, radius = circles(svg).T
    np.testing.assert_allclose(right, np.stack([x + radius, height - y], -1).reshape(-1, 2), atol=1e-3)
    assert (round(width, 3), round(height, 3)) in ((210, 297), (297, 210))
    assert rectangles(svg, "ruler")[0, 2] == 100


@pytest.mark.parametrize("name", BOARDS)
def test_sides_are_exact(name: str, tmp_path: Path) -> None:
    """The extent of a print is its squares, or its tags, gaps and corner squares."""
    main(["pattern", *BOARDS[name], "--output", str(tmp_path / "board")])
    expected = {
        "charuco": (180, 120),
        "inverted": (180, 120),
        "legacy-free-first": (168, 168),
        "chessboard": (200, 140),
        "aprilgrid": (5 * 30 + 6 * 9, 4 * 30 + 5 * 9),
        "circles": (9 * 20, 6 * 20),
        "asymmetric-circles": (9 * 16, 12 * 16),
        "tags": (100, 100),
    }
    _, _, across, down = rectangles(tmp_path / "board.svg", "board")[0] - (8 if name == "inverted" else 0)
    assert (across, down) == pytest.approx(expected[name], abs=1e-6)


def test_a_pdf_finds_its_objects(tmp_path: Path) -> None:
    main(["pattern", *BOARDS["charuco"], "--output", str(tmp_path / "board")])
    data = (tmp_path / "board.pdf").read_bytes()
    table = int(re.search(rb"startxref\n(\d+)", data).group(1))  # type: ignore[union-attr]
    assert data[table:].startswith(b"xref")
    for number, place in enumerate(re.findall(rb"(\d{10}) 00000 n", data[table:]), 1):
        assert data[int(place) :].startswith(b"%d 0 obj" % number)
    length, content = re.search(rb"/Length (\d+) >>\nstream\n(.*)\nendstream", data, re.DOTALL).groups()  # type: ignore[union-attr]
    assert int(length) == len(content)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["charuco", "--columns", "8", "--rows", "5"], "missing key 'square'"),
        (
            ["charuco", "--columns", "30", "--rows", "20", "--square", "20"],
            "the board is 620 x 420 mm, too large for A4",
        ),
        (["charuco", "--columns", "8", "--rows", "5", "--square", "20", "--marker", "20"], "less than the square"),
        (
            ["charuco", "--columns", "8", "--rows", "5", "--square", "20", "--dictionary", "DICT_4X4"],
            "found dictionary",
        ),
        (["chessboard", "--columns", "8", "--rows", "5", "--square", "20", "--tag", "3"], "found 'tag'"),
        (["aprilgrid", "--columns", "8", "--rows", "5", "--tag", "-3"], "found -0.003"),
        (["circles", "--columns", "8", "--rows", "5", "--spacing", "20", "--diameter", "20"], "less than the spacing"),
        (["asymmetric-circles", "--columns", "4", "--rows", "10", "--spacing", "16"], "expected an odd number"),
        (["tags", "--first", "3"], "missing key 'size'"),
        (["tags", "--tag", "100", "--columns", "3"], "found 'columns'"),
        (["aprilgrid", "--columns", "30", "--rows", "30", "--tag", "1"], "587 at most"),
    ],
)
def test_bad_boards_are_one_line_and_leave_nothing(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["pattern", *arguments, "--output", str(tmp_path / "board")]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())
