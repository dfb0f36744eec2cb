"""Synthetic scenes of any size: a rig of cameras that sees moving boards, as a dataset."""

from pathlib import Path

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.modalities import RGB
from calibration.engine.dataset.model import Collection, CornerLabels, Dataset, Sensor
from calibration.engine.dataset.pattern import Pattern, grid, outline
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import PlumbBob
from calibration.engine.geometry.rotations import exp
from calibration.engine.geometry.transforms import apply, inverse, transform

CAMERA = Camera(800.0, 800.0, 640.0, 480.0, 1280, 960, PlumbBob(-0.10, 0.05, 0.001, -0.0005, 0.01))
COLUMNS, ROWS, SQUARE = 10, 5, 0.06
DISTANCE = 1.5


def rig(collections: int, cameras: int = 2, seed: int = 0, noise: float = 0.3) -> tuple[Dataset, Array]:
    """Cameras on an arc, looking at boards 1.1 to 1.9 m away that every one of them sees in full.

    The first camera is anchored; 50 corners a board, `noise` px on each axis.

    Returns:
        The dataset, whose transforms are the truth, and ``T_world_camera`` (C, 4, 4).
    """
    rng = np.random.default_rng(seed)
    pattern = board()
    angle = 0.12 * np.arange(cameras)
    T_world_camera = transform(
        exp(np.stack([0 * angle, -angle, 0.05 * angle], -1)),
        DISTANCE * np.stack([np.sin(angle), 0.02 / DISTANCE * angle, 1 - np.cos(angle)], -1),
    )
    T_world_board = boards(rng, collections, angle[-1] / 2, pattern)
    pixels = np.empty((cameras, collections, len(pattern.corners), 2))
    for c in range(cameras):
        T = inverse(T_world_camera[c]) @ T_world_board
        pixels[c] = CAMERA.project(apply(T, np.broadcast_to(pattern.corners, (collections, *pattern.corners.shape))))
    pixels += rng.normal(0.0, noise, pixels.shape)
    ids = np.arange(len(pattern.corners))
    names = [f"camera_{c}" for c in range(cameras)]
    transforms = {
        ("world", f"{name}_link"): np.repeat(T[None], collections, 0)
        for name, T in zip(names, T_world_camera, strict=True)
    }
    dataset = Dataset(
        path=Path("rig/dataset.json"),
        version="3.0",
        world="world",
        sensors={n: Sensor(n, RGB, f"{n}_link", "world", f"{n}_link", CAMERA) for n in names},
        patterns={pattern.name: pattern},
        anchored=names[0],
        additional_transforms=(),
        collections=tuple(
            Collection(f"{i:05}", {(pattern.name, n): CornerLabels(ids, pixels[c, i]) for c, n in enumerate(names)})
            for i in range(collections)
        ),
        transforms=transforms,
        document={},
    )
    return dataset, T_world_camera


def board() -> Pattern:
    """10 x 5 corners, 60 mm apart."""
    corners = grid(COLUMNS, ROWS, SQUARE, (0.0, 0.0))
    border = outline(COLUMNS, ROWS, SQUARE, (0.0, 0.0), (0.0, 0.0))
    return Pattern("board", "chessboard", "board_link", "world", fixed=False, corners=corners, outline=border)


def boards(rng: np.random.Generator, count: int, direction: float, pattern: Pattern) -> Array:
    """``T_world_board`` (count, 4, 4), tilted 6 to 40 degrees, about a point that all cameras look at."""
    centre = np.array([0.0, 0.0, DISTANCE]) + rng.uniform(-1.0, 1.0, (count, 3)) * [0.25, 0.2, 0.35]
    axis = rng.normal(size=(count, 3))
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    R = exp(np.array([0.0, -direction, 0.0])) @ exp(axis * rng.uniform(0.1, 0.7, (count, 1)))
    return transform(R, centre - R @ pattern.centre)
