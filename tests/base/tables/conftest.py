"""Tables as ATOM writes them."""

from pathlib import Path

import pytest

from calibration.base.tables import Table
from calibration.base.tables.table import parse_table

ATOM = """Collection #,RMS (pix),X err (pix),Y err (pix),Trans (mm),Rot (deg)
000,0.5,0.3,0.4,1.5,0.02
001,0.9,0.6,0.5,2.5,0.04
002,0.7,0.3,0.6,2.0,0.03
Averages,0.7,0.4,0.5,2.0,0.03
"""
"""Three collections and the row that sums them up."""


@pytest.fixture
def atom() -> Table:
    return parse_table(ATOM, "results.csv")


@pytest.fixture
def atom_file(tmp_path: Path) -> Path:
    path = tmp_path / "results.csv"
    path.write_text(ATOM)
    return path
