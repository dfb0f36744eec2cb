"""Whether the stated covariance is what the errors are: the normalised estimation error squared (NEES).

Over many scenes with Gaussian noise the mean of ``e^T C^-1 e`` is the number of degrees of freedom, 6, with
a standard deviation of 0.35 for 100 scenes. Below: the errors are smaller than stated; above: greater.
"""

from collections.abc import Iterator

import numpy as np

from benchmarks.rows import Bar, Row
from benchmarks.scenes import rig
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.geometry.transforms import local

SCENES, COLLECTIONS = 100, 20
EDGE = ("world", "camera_1_link")


def measure(_: bool) -> Iterator[Row]:
    """100 rigs of 2 cameras and 20 collections, 0.3 px."""
    for loss in ("linear", "huber"):
        nees, translations, sigmas = [], [], []
        for seed in range(SCENES):
            dataset, T_world_camera = rig(COLLECTIONS, seed=seed)
            result = calibrate(dataset, Options(loss=loss))
            error = local(result.transforms[EDGE], T_world_camera[1])
            nees.append(error @ np.linalg.solve(result.label_covariances[EDGE], error))
            translations.append(1e3 * np.linalg.norm(error[:3]))
            sigmas.append(result.label_sigma_mm(EDGE))
        rms = [float(np.sqrt(np.mean(np.square(values)))) for values in (translations, sigmas)]
        note = f"6 expected, {len(nees)} scenes; translation {rms[0]:.3f} mm rms, {rms[1]:.3f} mm stated"
        bar = Bar(5, 7) if loss == "linear" else None
        name = "plain" if loss == "linear" else "robust"
        yield Row(f"consistency/NEES, {name}", float(np.mean(nees)), "", bar, note)
