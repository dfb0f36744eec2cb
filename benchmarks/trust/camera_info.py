"""Error bars of robots whose camera_info is what OpenCV finds from 20 or 30 views of a board.

Each camera is calibrated with ``cv2.calibrateCamera`` (k1, k2, p1, p2, k3) from random views of a chessboard that is
nearly flat, and the robot with that camera_info and every default of calibration.yml. ``e^T C^-1 e / 6`` of each
calibrated sensor is 1 on average where the stated covariance in all is what the errors are.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.rows import Bar, Row
from benchmarks.verdict.strata import entries, generator, recording
from benchmarks.workers import on_all_cores
from calibration.base.arrays import Array
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.options import Assumptions
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import local

NEES_BAR = Bar(0.5, 1.5)
SQUARE_SIDES = (0.025, 0.04)
"""Sides of the chessboard's squares, m; it has 9 x 6 corners."""
CALIBRATION_QUALITIES = ((20, 0.1, 0.0001), (30, 0.1, 0.0001), (20, 0.15, 0.0002), (30, 0.15, 0.0002))
"""Views, noise of their corners (px), and how flat the board is (most of its bow about each axis, m)."""


def rows(quick: bool) -> Iterator[Row]:
    """The normalised squared error of each system that ships, over the four qualities of camera_info."""
    seeds = 2 if quick else 8
    for system in entries():
        found = on_all_cores(
            _nees_of_recording, [(system, quality, seed) for quality in CALIBRATION_QUALITIES for seed in range(seeds)]
        )
        exact = on_all_cores(_nees_of_recording, [(system, None, seed) for seed in range(seeds)])
        each = [np.mean(part) for part in np.split(np.array(found), len(CALIBRATION_QUALITIES))]
        note = f"with 20 and 30 views at 0.1 px, flat to 0.1 mm: {each[0]:.2f}, {each[1]:.2f}; at 0.15 px, 0.2 mm: "
        note += f"{each[2]:.2f}, {each[3]:.2f}; with the true camera_info {np.mean(exact):.2f}; {len(found)} recordings"
        yield Row(f"trust/NEES/6 with camera_info of OpenCV, {system}", float(np.mean(found)), "", NEES_BAR, note)


def _nees_of_recording(of: tuple[str, tuple[int, float, float] | None, int]) -> float:
    """Return the mean ``e^T C^-1 e / 6`` of the calibrated sensors of one recording."""
    system, quality, seed = of
    scene = recording(system, seed, seed)
    cameras = {}
    for name in scene.cameras:
        true = scene.world.sensors[name].camera
        assert true
        cameras[name] = true if quality is None else _by_opencv(true, *quality, generator(*of, name))
    options = replace(scene.system.options, assume=Assumptions())
    found = calibrate(scene.told.with_cameras(cameras), options)
    assert found.converged, found.reason
    true = found.dataset.with_transforms(scene.truth().transforms)
    fixed = found.dataset.sensors.get(found.gauge or "")
    scores = []
    for sensor in found.dataset.sensors.values():
        if (C := found.covariances.get(sensor.edge)) is not None:
            frames = (fixed or sensor).calibration_parent if fixed is None else fixed.calibration_child
            T, T_true = (each.transform(frames, sensor.calibration_child)[0] for each in (found.dataset, true))
            error = local(T_true, T)
            scores.append(error @ np.linalg.solve(C, error) / 6)
    return float(np.mean(scores))


def _by_opencv(true: Camera, views: int, noise: float, flat: float, rng: np.random.Generator) -> Camera:
    """Calibrate a camera as OpenCV's users do."""
    import cv2  # only here: slow to import

    places = np.stack([*np.divmod(np.arange(54), 9)[::-1], np.zeros(54)], -1) * rng.uniform(*SQUARE_SIDES)
    half = places.max(0)[:2] / 2
    a, b = ((places[:, :2] - half) / half).T
    bow = rng.uniform(-flat, flat, 2)
    bent = places + np.stack([0 * a, 0 * a, bow[0] * (1 - a**2) + bow[1] * (1 - b**2)], -1)
    seen: list[Array] = []
    while len(seen) < views:
        pixels = _detected_corners(true, bent, rng)
        if pixels is not None:
            seen.append((pixels + noise * rng.normal(size=pixels.shape)).astype(np.float32))
    objects = [places.astype(np.float32)] * views
    _, K, D, _, _ = cv2.calibrateCamera(objects, seen, (true.width, true.height), None, None)  # type: ignore[call-overload]
    return true.with_intrinsics(np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *D.ravel()[:5]]))


def _detected_corners(camera: Camera, corners: Array, rng: np.random.Generator) -> Array | None:
    """Return the pixels (K, 2) of a board in a random view; None if it is not whole in the image."""
    middle, size = corners.mean(0), corners.max(0)[0]
    place = rng.uniform(0.15, 0.85, (1, 2)) * (camera.width, camera.height)
    ((x, y),) = camera.normalise(place)
    distance = size * camera.fx / (rng.uniform(0.35, 0.75) * camera.width)
    tilt, direction = np.radians(rng.uniform(0, 40)), rng.uniform(0, 2 * np.pi)
    R = rotations.exp(tilt * np.array([np.cos(direction), np.sin(direction), 0.0]))
    R = R @ rotations.exp(np.array([0.0, 0.0, rng.choice([0.0, np.pi / 2]) + rng.normal(0, 0.1)]))
    pixels, visible = camera.project_visible((corners - middle) @ R.T + distance * np.array([x, y, 1.0]))
    return pixels if visible.all() and camera.contains(pixels).all() else None
