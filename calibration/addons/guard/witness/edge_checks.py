"""A camera and a LiDAR against each other, by the edges that both see."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from calibration.addons.guard.outcome import MAX_FALSE_ALARM, SensorCheck
from calibration.addons.guard.witness.checks import MIN_IMAGES, RIGID_NOISE, WitnessAnswer
from calibration.addons.guard.witness.depth_edges import BEAM_SIGMA, EdgeEvidence, edge_candidates, edge_evidence
from calibration.addons.guard.witness.displacement import Displacement, displacement_of
from calibration.base.arrays import Array
from calibration.engine.geometry.cameras import Camera
from calibration.robot.labelling.detection import Image

MIN_EDGES = 150
"""Edges that fit, in all images."""
MIN_AGREEMENT = 3.0
"""By how much more edges must fit than they do by chance: 2 to 2.6 where both see different places, as each edge of the
depth looks for the nearest one of the image."""
BANDS_OF_PART = 12
"""Columns or rows that are a part of the image: without the edges of any one, the others must say the same, as a thing
whose edges are taken for others misleads."""
MAX_CORNERS, MIN_CORNERS = 200, 20
"""Corners that are followed from an image to the next, to see whether it stands still."""
MAX_FLOW_PX = 0.5
"""px: by what most corners move where it does: sensors that move see two things, as no clock is perfect."""
SYSTEMATIC = np.diag(np.square([2e-3] * 3 + [5e-4] * 3))
"""m and rad: covariance of what all edges have in common, such as by the angles of a LiDAR's own beams."""


@dataclass(frozen=True, eq=False)
class CameraAndLidar:
    """Images and scans of the same K moments, in which the sensors stood still."""

    camera_name: str
    lidar_name: str
    images: Sequence[Image]
    scans: Sequence[Array]
    """Points (N, 3) of each, m, in the LiDAR's frame."""
    camera: Camera
    """With the accepted lens."""
    lens_sigmas: Array
    """(3,): standard deviations of the relative focal length, and of the principal point in focal lengths."""
    T_camera_lidar: Array
    """(4, 4): accepted."""
    covariance: Array
    """(6, 6): of it, as a twist of the camera in its frame; m and rad."""
    times: Array
    """(K,): s, rising."""


def stands_still(image: Image, after: Image) -> bool:
    """Whether most of what a camera sees stays where it is from one grey image to the next (Lucas and Kanade, 1981)."""
    corners: Any = cv2.goodFeaturesToTrack(image, MAX_CORNERS, 0.01, 10)
    if corners is None:
        return False
    there, found, _ = cv2.calcOpticalFlowPyrLK(image, after, corners, corners.copy())
    flow = np.linalg.norm(there - corners, axis=-1)[found.astype(bool)]
    return len(flow) >= MIN_CORNERS and bool(np.median(flow) < MAX_FLOW_PX)


def check_by_edges(seen: CameraAndLidar) -> SensorCheck:
    """Return whether a camera is where it was accepted relative to a LiDAR."""
    answer = WitnessAnswer(seen.camera_name, f"the edges that {seen.lidar_name} sees too", seen.times)
    if len(seen.images) < MIN_IMAGES:
        return answer.cannot_tell(
            f"found {len(seen.images)} moments with an image and a scan at which nothing moved, expected {MIN_IMAGES}"
        )
    candidates = edge_candidates(seen.images, seen.scans, seen.camera, seen.T_camera_lidar)
    lens_sigmas = _beam_and_centre(seen)
    evidence = edge_evidence(candidates, lens_sigmas)
    edges = 0 if evidence is None else len(evidence.candidates.edges)
    if evidence is None or edges < MIN_EDGES:
        return answer.cannot_tell(f"found {edges} edges that both see, expected {MIN_EDGES}")
    if evidence.agreement < MIN_AGREEMENT:
        return answer.cannot_tell(
            f"{evidence.agreement:.1f} times as many edges of the depth are on edges of the image as by chance, "
            f"expected {MIN_AGREEMENT:g}: too much texture, too few edges, or turned far"
        )
    found = _displaced(evidence, seen)
    if found.p < MAX_FALSE_ALARM:
        parts = candidates.clusters // BANDS_OF_PART
        rest = [edge_evidence(candidates.kept(parts != part), lens_sigmas) for part in np.unique(parts)]
        if any(each is None or _displaced(each, seen).p > MAX_FALSE_ALARM for each in rest):
            return answer.cannot_tell("edges in one part of the image say that it has moved, the others do not")
    return answer.by(found)


def _displaced(evidence: EdgeEvidence, seen: CameraAndLidar) -> Displacement:
    still, lens_sigmas = np.zeros((len(seen.images), 6)), _beam_and_centre(seen)
    return displacement_of(evidence, still, RIGID_NOISE, lens_sigmas, seen.covariance + SYSTEMATIC)


def _beam_and_centre(seen: CameraAndLidar) -> Array:
    """Return the standard deviations (3,) of the beam's width, rad, and of the principal point, in focal lengths."""
    return np.array([BEAM_SIGMA, *seen.lens_sigmas[1:]])
