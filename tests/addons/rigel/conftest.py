from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from calibration.addons.rigel.conversion import Conversion, convert
from calibration.addons.rigel.document import read_rigelfile


@pytest.fixture
def converted(tmp_path: Path) -> Callable[[str], Conversion]:
    """Convert the text of a Rigelfile."""

    def conversion(text: str) -> Conversion:
        (tmp_path / "Rigelfile").write_text(text)
        return convert(read_rigelfile(tmp_path / "Rigelfile"))

    return conversion


def noted(conversion: Conversion) -> dict[str, str]:
    """The notes' texts by where they are."""
    return {note.where: note.text for note in conversion.notes}


def software(conversion: Conversion, index: int = 0) -> dict[str, Any]:
    """The software of a system."""
    found: dict[str, Any] = conversion.systems[index].entry["software"]
    return found
