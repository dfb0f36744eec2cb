"""Half of a surrogate pair, which JSON can hold and UTF-8 cannot, is refused where it is a name."""

import json
from pathlib import Path

import pytest

from calibration.base import InputError
from calibration.engine.dataset.reading import read_dataset

DATASET = Path(__file__).parents[3] / "datasets" / "t2rgb" / "dataset.json"


@pytest.mark.parametrize("name", ["left_camera", "world", "pattern_1", "000"])
def test_a_name_with_half_of_a_pair_is_refused(name: str, tmp_path: Path) -> None:
    text = DATASET.read_text()
    assert f'"{name}"' in text
    (tmp_path / "dataset.json").write_text(text.replace(f'"{name}"', '"a\\ud800"'))
    with pytest.raises(InputError, match=r"dataset\.json: .*a\\ud800.*surrogate pair"):
        read_dataset(tmp_path)


def test_a_pair_is_a_character(tmp_path: Path) -> None:
    text = json.dumps(json.loads(DATASET.read_text())).replace("left_camera", "left_\\ud83d\\ude00")
    (tmp_path / "dataset.json").write_text(text)
    assert "left_\N{GRINNING FACE}" in read_dataset(tmp_path).sensors
