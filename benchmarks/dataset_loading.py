"""Reading a dataset, checked whole, against json.load of the same file."""

import json
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from benchmarks.rows import Bar, Row
from benchmarks.shared_data import FOLDER, ROOT
from benchmarks.timing import in_units_of
from calibration.engine.dataset.reading import FILE_NAME, read_dataset

FILES = {
    "datasets/t2rgb": ROOT / "datasets" / "t2rgb" / FILE_NAME,
    "datasets/rlbot": ROOT / "datasets" / "rlbot" / FILE_NAME,
    "t2rgb-paper": FOLDER / "t2rgb-paper" / FILE_NAME,
    "synthetic/rlbot": FOLDER / "synthetic" / "rlbot" / FILE_NAME,
}


def measure(quick: bool) -> Iterator[Row]:
    """Cameras alone, and with a LiDAR's points."""
    for name, path in FILES.items():
        row = f"dataset_loading/{name}"
        if not path.exists():
            yield Row(row, skipped=f"no {name}/{FILE_NAME} here")
            continue
        unit, ratios = in_units_of(
            partial(_load_json, path), {"read": partial(read_dataset, path)}, rounds=15 if quick else 31
        )
        note = f"json.load takes {1e3 * unit:.1f} ms for {path.stat().st_size / 1e6:.1f} MB"
        yield Row(row, ratios["read"], "x json.load", Bar(high=2), note)


def _load_json(path: Path) -> object:
    with path.open() as file:
        return json.load(file)
