"""Effect of wrong corners on the result: plain least squares against the robust default."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.rows import Row
from benchmarks.scenes import rig
from calibration.engine.dataset.model import CornerLabels, Dataset
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.geometry.transforms import distance

SCENES, COLLECTIONS = 40, 30
EDGE = ("world", "camera_1_link")
SHARES = ((0.0, 0.0), (0.05, 30.0), (0.20, 30.0), (0.05, 200.0))
"""Share of wrong corners, and how far they may be off (px) along each axis."""


def measure(quick: bool) -> Iterator[Row]:
    """40 rigs of 2 cameras and 30 collections: the error of the second camera, mm."""
    for share, size in SHARES:
        for loss in ("linear", "huber"):
            errors, lost = [], 0
            for seed in range(10 if quick else SCENES):
                dataset, T_world_camera = rig(COLLECTIONS, seed=100 + seed)
                result = calibrate(spoilt(dataset, share, size, seed), Options(loss=loss))
                lost += not result.converged
                errors.append(1e3 * float(distance(result.transforms[EDGE], T_world_camera[1])[0]))
            name = "plain" if loss == "linear" else "robust"
            where = f"{share:.0%} within {size:.0f} px" if share else "none"
            note = f"median of {len(errors)} scenes; the worst {max(errors):.3g} mm; {lost} not converged"
            yield Row(f"outliers/{where}, {name}", float(np.median(errors)), "mm", note=note)


def spoilt(dataset: Dataset, share: float, size: float, seed: int) -> Dataset:
    """The dataset with a share of its corners moved."""
    rng = np.random.default_rng(seed)

    def moved(label: CornerLabels) -> CornerLabels:
        wrong = rng.random(len(label.ids)) < share
        return replace(label, pixels=label.pixels + wrong[:, None] * rng.uniform(-size, size, label.pixels.shape))

    collections = tuple(
        replace(c, labels={key: moved(label) for key, label in c.labels.items() if isinstance(label, CornerLabels)})
        for c in dataset.collections
    )
    return replace(dataset, collections=collections)
