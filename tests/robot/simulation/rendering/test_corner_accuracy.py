"""Detected corners in rendered images against the projected truth."""

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.model import CornerLabels
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import Distortion, DoubleSphere, Equidistant, PlumbBob
from calibration.engine.geometry.transforms import apply, transform
from calibration.robot.labelling.corner_detector import corner_detector
from calibration.robot.simulation.kinematics import stream
from calibration.robot.simulation.scene import Scene
from calibration.robot.simulation.sensors import SimulatedCamera
from tests.robot.simulation.rendering.views import (
    APRILGRID,
    CHARUCO,
    CHESSBOARD,
    DISTORTION,
    T_WORLD_CAMERA,
    board,
    camera,
    random_pose,
)

POSES = 3
EVEN_ROWS = replace(CHARUCO, dimension=(11, 7))
Found = tuple[np.ndarray, np.ndarray]
"""Corners (N, 2) and their ids (N,)."""


def by_us(image: np.ndarray, pattern: PatternConfiguration) -> Found:
    labels = corner_detector(pattern).detect(image)
    assert isinstance(labels, CornerLabels)
    return labels.pixels, labels.ids


def by_opencv(image: np.ndarray, pattern: PatternConfiguration) -> Found:
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    if pattern.kind == "chessboard":
        found, corners = cv2.findChessboardCorners(grey, pattern.dimension)
        assert found
        corners = cv2.cornerSubPix(grey, corners, (5, 5), (-1, -1), (cv2.TERM_CRITERIA_EPS, 0, 1e-4))
        return corners.reshape(-1, 2), np.arange(len(corners))
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    squares = (pattern.dimension[0] + 1, pattern.dimension[1] + 1)
    charuco = cv2.aruco.CharucoBoard(squares, pattern.size, pattern.inner_size or 0.0, dictionary)
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    corners, ids, _, _ = cv2.aruco.CharucoDetector(charuco, cv2.aruco.CharucoParameters(), parameters).detectBoard(grey)
    return corners.reshape(-1, 2), ids.ravel()


def errors(
    detect: Callable[[np.ndarray, PatternConfiguration], Found],
    of: Camera,
    pattern: PatternConfiguration,
    legacy: bool = False,
) -> np.ndarray:
    """(N, 2): what is detected minus what is true, px, over some poses."""
    random, found = np.random.default_rng(1), []
    for pose in range(POSES):
        T = random_pose(random, pattern, 1.0, 1.8)
        view = board(T, pattern, legacy_layout=legacy)
        image = SimulatedCamera(of).render(T_WORLD_CAMERA, Scene(ground=0.0), [view], stream(pose))
        corners, ids = detect(image, pattern)
        assert len(ids) > 0.9 * len(view.pattern.corners)
        found.append(corners - of.project(apply(T, view.pattern.corners))[ids])
    return np.concatenate(found)


def check(error: np.ndarray, limit: float) -> None:
    assert np.sqrt((error**2).sum(axis=1).mean()) <= limit
    assert np.abs(error.mean(axis=0)).max() < 0.01


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize(
    ("pattern", "legacy", "distortion", "limit"),
    [
        (CHARUCO, False, DISTORTION, 0.08),
        (APRILGRID, False, DISTORTION, 0.06),
        (EVEN_ROWS, False, PlumbBob(), 0.06),
        (EVEN_ROWS, True, PlumbBob(), 0.06),
    ],
)
def test_we_find_corners_where_they_are(
    pattern: PatternConfiguration, legacy: bool, distortion: PlumbBob, limit: float
) -> None:
    check(errors(by_us, camera(1280, 720, 900, distortion), pattern, legacy), limit)


@pytest.mark.thorough(but_first=1)
@pytest.mark.skipif(
    tuple(map(int, cv2.__version__.split(".")[:2])) < (4, 14),
    reason="OpenCV before 4.14 finds the corners of charuco boards half a pixel beside their place",
)
@pytest.mark.parametrize(("distortion", "limit"), [(PlumbBob(), 0.06), (DISTORTION, 0.08)])
def test_opencv_finds_corners_of_charuco_boards_where_they_are(distortion: PlumbBob, limit: float) -> None:
    check(errors(by_opencv, camera(1280, 720, 900, distortion), CHARUCO), limit)


@pytest.mark.parametrize(("distortion", "limit"), [(PlumbBob(), 0.06), (DISTORTION, 0.08)])
def test_opencv_finds_corners_of_chessboards_where_they_are(distortion: PlumbBob, limit: float) -> None:
    check(errors(by_opencv, camera(1280, 720, 900, distortion), CHESSBOARD), limit)


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize(("lens", "focal"), [(Equidistant(0.01, -0.002), 330.0), (DoubleSphere(-0.2, 0.59), 270.0)])
def test_corners_beside_the_camera_are_where_they_are(lens: Distortion, focal: float) -> None:
    """A board that stands square to the ray at 100 degrees from the axis of a wide lens, on ground and before sky."""
    of = Camera(focal, focal, 699.5, 699.5, 1400, 1400, lens)
    ray = np.array([[np.sin(np.radians(100)), 0.0, np.cos(np.radians(100))]])
    (R,) = rotations.towards(ray)
    T = transform(R, 1.5 * ray[0] - R @ CHESSBOARD.pattern().centre)
    view = board(T, CHESSBOARD)
    corners = apply(T, view.pattern.corners)
    assert (corners[:, 2] < 0).sum() > 20
    image = SimulatedCamera(of).render(T_WORLD_CAMERA, Scene(ground=0.0), [view], stream(1))
    pixels, ids = by_us(image, CHESSBOARD)
    assert len(ids) == len(corners)
    assert np.sqrt(((pixels - of.project(corners)[ids]) ** 2).sum(axis=1).mean()) < 0.08
