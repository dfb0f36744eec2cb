"""Error bars of cameras that see more than 180 degrees, with intrinsics that are known and that are calibrated.

Two cameras side by side see a board all around them, at up to 97 degrees from the optical axis. ``e^T C^-1 e / 6`` of
the second one's pose is 1 on average where the covariance is what the errors are.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.rows import Bar, Row
from benchmarks.workers import on_all_cores
from calibration.base.arrays import Array
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.options import ALL_EXACT, Options
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import DoubleSphere, Equidistant, Eucm, Omni
from calibration.engine.geometry.transforms import local, transform
from tests.engine.estimation.scenes import Scene, board, camera, pose

NEES_BAR = Bar(0.7, 1.3)
WITHIN_BAR = Bar(0.95, 1.0)
"""Part of all errors within two standard deviations; of exact error bars 95.4 %, in the mean of many."""
FEW_BAR = Bar(0.9, 1.0)
"""The same of few recordings, by chance."""
VIEWS = 40
NOISE = 0.2
"""Of the corners, px."""
MAX_ANGLE = np.radians(97.5)
"""Of the board's centre from the optical axis."""
SIZE = {"width": 1280, "height": 960}
CAMERAS = {
    "equidistant": Camera(290.0, 291.0, 640.0, 478.0, **SIZE, distortion=Equidistant(-0.02, 0.01, -0.003, 0.0005)),
    "double_sphere": Camera(250.0, 251.0, 640.0, 478.0, **SIZE, distortion=DoubleSphere(-0.2, 0.59)),
    "eucm": Camera(290.0, 291.0, 640.0, 478.0, **SIZE, distortion=Eucm(0.6, 1.1)),
    "omni": Camera(700.0, 702.0, 640.0, 478.0, **SIZE, distortion=Omni(1.5, -0.05, 0.005, 0.001, -0.002)),
}


def rows(quick: bool) -> Iterator[Row]:
    """The normalised squared error, and how many errors are within two standard deviations, of each lens."""
    seeds = 10 if quick else 100
    for name in CAMERAS:
        for calibrated in (False, True):
            found = on_all_cores(_errors, [(name, calibrated, seed) for seed in range(seeds)])
            nees, within = (np.concatenate([np.atleast_1d(each[k]) for each in found]) for k in (0, 1))
            what = f"{name} of 195 degrees, intrinsics {'calibrated' if calibrated else 'known'}"
            yield Row(f"trust/NEES/6, {what}", float(nees.mean()), "", NEES_BAR, f"{seeds} recordings")
            yield Row(
                f"trust/errors within 2 sigma, {what}", float(within.mean()), "", FEW_BAR if quick else WITHIN_BAR, ""
            )


def _errors(of: tuple[str, bool, int]) -> tuple[float, Array]:
    """Return ``e^T C^-1 e / 6`` of the second camera's pose, and which errors are within 2 sigma, intrinsics too."""
    name, calibrated, seed = of
    model = CAMERAS[name]
    scene = _scene(model, seed)
    found = calibrate(scene.dataset(seed), Options(intrinsics=("all",) if calibrated else (), assume=ALL_EXACT))
    assert found.converged, found.reason
    (edge,) = (each.edge for each in found.dataset.sensors.values() if each.edge in found.covariances)
    error, C = local(scene.transforms[edge], found.dataset.transforms[edge][0]).ravel(), found.covariances[edge]
    ratios = [error / np.sqrt(np.diagonal(C))]
    for each in found.intrinsics.values():
        true = model.intrinsics[[model.parameters.index(parameter) for parameter in each.parameters]]
        ratios.append((each.values - true) / each.sigmas)
    return float(error @ np.linalg.solve(C, error)) / 6, np.abs(np.concatenate(ratios)) < 2


def _scene(model: Camera, seed: int) -> Scene:
    random = np.random.default_rng(seed)
    pixels = random.uniform((0.05, 0.05), (0.95, 0.95), (8 * VIEWS, 2)) * (model.width, model.height)
    rays = model.rays(pixels)
    rays = rays[np.isfinite(rays[:, 0]) & (rays[:, 2] > np.cos(MAX_ANGLE))][:VIEWS]
    R = rotations.towards(rays) @ rotations.exp(random.uniform(-0.5, 0.5, (len(rays), 3)))
    pattern = board()
    T = transform(R, rays * random.uniform(0.5, 1.0, (len(rays), 1)) - R @ pattern.centre)
    transforms = {("world", f"c{k}"): pose(0.04 * k, 0.01 * k, 0.02 * k, 0.02 * k, -0.03 * k, 0.02) for k in range(2)}
    transforms["world", "board_link"] = transforms["world", "c0"] @ T
    return replace(Scene(transforms, [camera(f"c{k}", model=model) for k in range(2)], [pattern]), pixel_noise=NOISE)
