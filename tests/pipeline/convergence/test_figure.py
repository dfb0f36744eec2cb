"""The picture of the maps."""

import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import cv2
import numpy as np
import pytest

from calibration.base import InfrastructureError
from calibration.pipeline.convergence.convergence_map import ConvergenceResults
from calibration.pipeline.convergence.report import MAX_MAPS, figures, report
from calibration.pipeline.system import NoiseGrid

from .cells import one_map


def results(system: str = "arm", maps: int = 1, levels: tuple[float, ...] = (0.0, 0.5)) -> ConvergenceResults:
    found = one_map(levels, (0.0, 1.0), lambda t, *_: t == 0, system=system)
    return ConvergenceResults(NoiseGrid(levels, (0.0, 1.0)), (found,) * maps)


def pixels(png: bytes) -> Any:
    return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)


def test_png_and_svg_of_the_colours_of_the_shares() -> None:
    png, svg = figures(results())
    colours, counts = np.unique(pixels(png).reshape(-1, 3)[:, ::-1], axis=0, return_counts=True)
    often = {tuple(int(v) for v in colour) for colour, number in zip(colours, counts, strict=True) if number > 2000}
    assert (0, 34, 77) in often  # cividis at 0 and 1
    assert (253, 231, 55) in often
    assert ET.fromstring(svg).tag.endswith("svg")  # noqa: S314


def test_the_same_results_give_the_same_bytes_without_a_date() -> None:
    first, second = figures(results()), figures(results())
    assert first == second
    assert b"dc:date" not in first[1]
    assert b"Matplotlib" not in first[0]
    assert figures(results("leg")) != first


@pytest.mark.thorough(but_first=2)
@pytest.mark.parametrize("name", [r"$\frac$ & <b>", "腕 робот", "a\x1b[31m\nb", "x" * 300])
def test_any_name_is_drawn(name: str) -> None:
    png, svg = figures(results(name))
    assert pixels(png).shape == pixels(figures(results())[0]).shape
    ET.fromstring(svg)  # noqa: S314


def test_more_levels_and_maps_make_it_larger() -> None:
    small = pixels(figures(results())[0]).shape
    tall = pixels(figures(results(levels=(0.0, 0.5, 1.0, 1.5, 2.0)))[0]).shape
    wide = pixels(figures(results(maps=3))[0]).shape
    assert tall[0] > small[0]
    assert wide[0] > small[0]
    assert wide[1] > small[1]


def test_too_many_maps_are_a_note_not_a_failure(tmp_path: Path) -> None:
    found = report(results(maps=MAX_MAPS + 1), tmp_path)
    found.write(tmp_path)
    assert found.notes == (f"no figure: found {MAX_MAPS + 1} maps, at most {MAX_MAPS} can be drawn",)
    assert not (tmp_path / "convergence.png").exists()
    assert found.verdict == "pass"


def test_without_matplotlib_the_error_names_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(InfrastructureError, match=r"pip install matplotlib"):
        figures(results())
