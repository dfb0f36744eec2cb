"""The README's description of its picture is what the picture shows."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_the_description_of_the_run_has_the_numbers_of_the_picture() -> None:
    description = (ROOT / "README.md").read_text().split("![Tables:")[1].split("](docs/run.svg)")[0]
    numbers = re.findall(r"\d+\.\d+", description)
    picture = (ROOT / "docs" / "run.svg").read_text()
    assert len(numbers) == 12
    assert [each for each in numbers if each not in picture] == []
