"""Points of a static scene, found again from image to image of a camera that moves, or in those of two cameras.

Matches of a pair of images must agree with one essential matrix (MAGSAC++: Barath, Noskova, Ivashechkin and Matas,
2020, as OpenCV has it), and chains of matches are tracks, as in structure from motion (Snavely, Seitz and Szeliski,
2006).
"""

from collections.abc import Sequence

import cv2
import numpy as np

from calibration.addons.guard.features import Features, cells_of, match
from calibration.addons.guard.witness.bundle import Observations
from calibration.base.arrays import Array, IntArray
from calibration.engine.geometry.cameras import Camera

MIN_MATCHES = 15
"""Least number of matches of a pair of images that agree."""
MAX_EPIPOLAR_PX = 1.5
NEXT_IMAGES = (1, 2, 4)
"""Which of the following images each is matched with."""
SIMILAR_VIEWS = 2
"""Images taken from much the same pose at another time with which each is matched besides."""
VIEW_M, VIEW_RAD = 0.3, 0.4
"""m and rad: distance of poses from which much the same is seen."""
CARRIED_PX, TURNED_PX = 2.0, 8.0
"""px: what moves less in the image where the camera's turn moves what is far by more is carried by the camera."""
MIN_LENGTH = 3
"""Images in which a point is seen at least."""
MAX_TRACKS = 1500
"""Points, those that are seen most often: the work grows with them, the result hardly."""


def tracked_scene(features: Sequence[Features], camera: Camera, poses: Array) -> Observations:
    """Return the points of a scene that a moving camera sees, and where; every pose is an unknown.

    Args:
        features: of each of K images.
        camera: with the accepted lens.
        poses: (K, 4, 4) ``T_root_camera`` by the accepted mount.
    """
    rays = [camera.normalise(each.pixels) for each in features]
    links = []
    for i, j in _pairs(poses):
        a, b = _agreeing(features[i], features[j], rays[i], rays[j], camera.fx)
        turned = np.c_[rays[i][a], np.ones(len(a))] @ poses[i, :3, :3].T @ poses[j, :3, :3]
        far = camera.fx * (turned[:, :2] / np.maximum(turned[:, 2:], 0.1) - rays[i][a])
        flow = camera.fx * (rays[j][b] - rays[i][a])
        carried = (np.linalg.norm(flow, axis=-1) < CARRIED_PX) & (np.linalg.norm(far, axis=-1) > TURNED_PX)
        links.append(np.stack([np.full(len(a), i), a, np.full(len(a), j), b], -1)[~carried])
    views, points, index = _chained(np.concatenate([np.zeros((0, 4), int), *links]), [len(each) for each in features])
    at = np.array([rays[v][n] for v, n in zip(views, index, strict=True)]).reshape(-1, 2)
    clusters = np.arange(int(points.max(initial=-1)) + 1)
    return Observations(poses, np.arange(len(poses)), views, points, at, clusters, camera.fx, MIN_LENGTH)


def matched_pairs(
    left: Sequence[Features], right: Sequence[Features], cameras: tuple[Camera, Camera], T_left_right: Array
) -> Observations:
    """Return the points that two cameras see at the same moments; the right one's pose is an unknown of each moment.

    Every moment is a scene of its own, which may move. What is seen in one cell of the left image is one cluster, as it
    may be one thing, and the lens errs alike there.

    Args:
        left: features of each of K images.
        right: features of those of the other camera.
        cameras: both, with the accepted lenses.
        T_left_right: (4, 4) accepted.
    """
    K, size = len(left), np.array([cameras[0].width, cameras[0].height])
    views, at, clusters = [], [], []
    for k in range(K):
        rays = cameras[0].normalise(left[k].pixels), cameras[1].normalise(right[k].pixels)
        a, b = _agreeing(left[k], right[k], *rays, cameras[0].fx)
        views.append(np.repeat([[k, K + k]], len(a), 0))
        at.append(np.stack([rays[0][a], rays[1][b]], 1))
        clusters.append(cells_of(left[k].pixels[a], size))
    poses = np.concatenate([np.tile(np.eye(4), (K, 1, 1)), np.tile(T_left_right, (K, 1, 1))])
    slots = np.concatenate([np.full(K, -1), np.arange(K)])
    seen = np.concatenate(views)
    _, cells = np.unique(np.concatenate(clusters), return_inverse=True)
    return Observations(
        poses, slots, seen.ravel(), np.repeat(np.arange(len(seen)), 2), np.concatenate(at).reshape(-1, 2), cells,
        cameras[0].fx,
    )  # fmt: skip


def _pairs(poses: Array) -> list[tuple[int, int]]:
    """Return the pairs of images to be matched: near in time, and from similar poses."""
    K = len(poses)
    near = {(i, i + step) for i in range(K) for step in NEXT_IMAGES if i + step < K}
    apart = np.linalg.norm(poses[:, None, :3, 3] - poses[None, :, :3, 3], axis=-1) / VIEW_M
    cosine = 0.5 * (np.einsum("iab,jab->ij", poses[:, :3, :3], poses[:, :3, :3]) - 1)
    apart = apart + np.arccos(np.clip(cosine, -1, 1)) / VIEW_RAD
    apart[abs(np.subtract.outer(np.arange(K), np.arange(K))) <= max(NEXT_IMAGES)] = np.inf
    for i in range(K):
        for j in np.argsort(apart[i])[:SIMILAR_VIEWS].tolist():
            if apart[i, j] < 1:
                near.add((min(i, j), max(i, j)))
    return sorted(near)


def _agreeing(a: Features, b: Features, rays_a: Array, rays_b: Array, focal_px: float) -> tuple[IntArray, IntArray]:
    """Return the matches of two images that agree with one essential matrix."""
    at, other = match(a, b)
    valid = np.isfinite(rays_a[at]).all(-1) & np.isfinite(rays_b[other]).all(-1)
    at, other = at[valid], other[valid]
    if len(at) < MIN_MATCHES:
        return at[:0], other[:0]
    settings = cv2.UsacParams()
    settings.threshold, settings.confidence, settings.maxIterations = MAX_EPIPOLAR_PX / focal_px, 0.999, 500
    settings.score, settings.loMethod, settings.loIterations = cv2.SCORE_METHOD_MAGSAC, cv2.LOCAL_OPTIM_SIGMA, 5
    one = np.eye(3)
    E, mask = cv2.findEssentialMat(rays_a[at], rays_b[other], one, one, np.zeros(5), np.zeros(5), settings)
    if E is None or mask is None or mask.sum() < MIN_MATCHES:
        return at[:0], other[:0]
    kept = mask.ravel() > 0
    return at[kept], other[kept]


def _chained(links: IntArray, counts: Sequence[int]) -> tuple[IntArray, IntArray, IntArray]:
    """Return image, point and feature (M,) of the observations of each track.

    A chain that would have two features of one image is left out: some link of it is wrong.

    Args:
        links: (L, 4) image and feature, and the other image and feature.
        counts: features of each image.
    """
    first = np.concatenate([[0], np.cumsum(counts)])
    parent = np.arange(first[-1])

    def root(node: int) -> int:
        while parent[node] != node:
            parent[node] = parent[parent[node]]
            node = int(parent[node])
        return node

    for i, a, j, b in links.tolist():
        parent[root(int(first[i]) + a)] = root(int(first[j]) + b)
    roots = np.array([root(node) for node in range(first[-1])], int)
    images = np.repeat(np.arange(len(counts)), counts)
    length = np.bincount(roots, minlength=len(roots))
    distinct = np.zeros(len(roots), int)
    np.add.at(distinct, np.unique(np.stack([roots, images], -1), axis=0)[:, 0], 1)
    good = np.flatnonzero((length >= MIN_LENGTH) & (length == distinct))
    longest = np.sort(good[np.argsort(-length[good], kind="stable")[:MAX_TRACKS]])
    chosen = np.flatnonzero(np.isin(roots, longest))
    points = np.searchsorted(longest, roots[chosen])
    return images[chosen], points, chosen - first[images[chosen]]
