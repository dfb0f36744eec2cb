"""A dataset's folder as it would be recorded after one of its cameras had been knocked."""

import json
from pathlib import Path

import numpy as np

from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.geometry.transforms import apply, retract


def displace(folder: Path, name: str, twist: tuple[float, ...], since: int = 0) -> None:
    """Rewrite dataset.json: a camera has moved by a twist (m, rad) in its frame, and its corners in the images.

    Args:
        folder: of the dataset.
        name: the camera.
        twist: (6,).
        since: the number of the first collection after it.
    """
    path = folder / "dataset.json"
    dataset = calibrate(read_dataset(folder)).dataset
    sensor = dataset.sensors[name]
    assert sensor.camera is not None
    moved = dataset.with_transforms({sensor.edge: retract(dataset.transforms[sensor.edge], np.array(twist))})
    document = json.loads(path.read_text())
    for pattern in dataset.patterns.values():
        before, after = (each.transform(sensor.frame, pattern.link) for each in (dataset, moved))
        for i, collection in enumerate(dataset.collections):
            label = document["collections"][collection.key]["labels"].get(pattern.name, {}).get(name)
            if i < since or not label or not label["detected"]:
                continue
            drawn, redrawn = (sensor.camera.project(apply(T[i], pattern.corners)) for T in (before, after))
            for corner in label["idxs"]:
                corner["x"] += float((redrawn - drawn)[int(corner["id"]), 0])
                corner["y"] += float((redrawn - drawn)[int(corner["id"]), 1])
    path.write_text(json.dumps(document))
