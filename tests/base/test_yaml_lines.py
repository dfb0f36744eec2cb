"""Line numbers of keys in YAML files, for annotations."""

from pathlib import Path

import pytest

from calibration.base import line_of

TEXT = """\
noise: {translation: [0]}
systems:
  robot: &robot
    dataset: data
    rules:
      - {column: RMS (pix), row: Averages, max: 1}
      - column: Trans (mm)
        max: 2
  second: *robot
  itself: &loop [*loop]
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "calibration.yml"
    path.write_text(TEXT)
    return path


@pytest.mark.parametrize(
    ("keys", "value", "line"),
    [
        (("systems", "robot"), None, 3),
        (("systems", "robot", "rules"), None, 5),
        (("systems", "robot", "rules"), "RMS (pix)", 6),
        (("systems", "robot", "rules"), "Trans (mm)", 7),
        (("systems", "robot", "rules"), "Rot (deg)", 5),
        (("systems", "robot", "limits"), None, 3),
        (("systems", "second", "dataset"), None, 4),
        (("systems", "itself"), "none", 10),
        (("nothing", "robot"), None, None),
    ],
)
def test_the_line_of_a_key(file: Path, keys: tuple[str, ...], value: str | None, line: int | None) -> None:
    assert line_of(file, keys, value) == line


@pytest.mark.parametrize("text", ["a: [", "", "- a", "\0"])
def test_an_empty_file_has_no_line(file: Path, text: str) -> None:
    file.write_text(text)
    assert line_of(file, ("a",)) is None
    assert line_of(file.with_name("none.yml"), ("a",)) is None
