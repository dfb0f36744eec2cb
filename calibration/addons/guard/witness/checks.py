"""What a recording says of cameras that move: by the motion that carries them, and by each other.

Points of a static scene are found again from image to image. Matches of a pair of images must agree with one essential
matrix (MAGSAC++: Barath, Noskova, Ivashechkin and Matas, 2020, as OpenCV has it), and chains of matches are tracks, as
in structure from motion (Snavely, Seitz and Szeliski, 2006).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from calibration.addons.guard.features import Features, cells_of, match
from calibration.addons.guard.outcome import (
    MAX_FALSE_ALARM,
    SCORE_OF_POWER,
    SensorCheck,
    direction_in_words,
    smallest_seen,
)
from calibration.addons.guard.witness.bundle import Observations, evidence_of
from calibration.addons.guard.witness.displacement import Displacement, displacement_of, drift_of_poses
from calibration.base.arrays import Array, IntArray
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import distance, inverse, inverse_adjoint

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
MIN_IMAGES = 8
"""Images of a camera, or of two at the same moments."""
MIN_FEATURES = 40
"""Features of the middle one of the images."""
MIN_POINTS = 40
"""Scene points that fit."""
MIN_MOTION_M, MIN_MOTION_RAD = 0.02, 0.03
"""m and rad: from the first pose to the farthest; a camera that moves less stood still."""
MAX_UNSEEN_DEG, MAX_UNSEEN_MM = 1.0, 30.0
"""Smallest displacements from which on a recording says nothing of the rotation or the translation."""
MAX_POSE_NOISE_M, MAX_POSE_NOISE_RAD = 0.01, 0.01
"""m and rad: by what most poses may err, as the images say, for these to be a witness."""
MIN_SCORE = 3.0
"""Standard deviations from which on a rotation or a translation is named."""
POSE_NOISE = (5e-5, 1e-4)
"""m and rad: least standard deviations of the poses of what carries a sensor, as of an arm's link in a calibration."""
RIGID_NOISE = (1e-5, 1e-5)
"""m and rad: least standard deviations of the pose of a camera on a body."""


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


@dataclass(frozen=True, eq=False)
class MovingCamera:
    """A camera with what it saw, and where the link that carries it was."""

    name: str
    camera: Camera
    """With the accepted lens."""
    lens_sigmas: Array
    """(3,): standard deviations of the relative focal length, and of the principal point in focal lengths."""
    T_link_camera: Array
    """(4, 4): accepted."""
    covariance: Array
    """(6, 6): of it, as a twist in its frame; m and rad."""
    times: Array
    """(K,): s, rising."""
    features: Sequence[Features]
    """Of the K images."""
    T_root_link: Array
    """(K, 4, 4): all the same of a link that stands."""
    velocities: Array
    """(K, 6): twists of the link in its own frame, m/s and rad/s."""
    drives: bool = False
    """Whether odometry says where the link is."""


def check_by_motion(seen: MovingCamera, pose_noise: tuple[float, float]) -> SensorCheck:
    """Return whether a camera is where it was accepted, by the motion of the link that carries it.

    Args:
        seen: the camera.
        pose_noise: m and rad, least standard deviations of the link's poses.
    """
    answer = WitnessAnswer(seen.name, "the motion of what carries it", seen.times)
    if fault := _fault_of_images(seen):
        return answer.cannot_tell(fault)
    if fault := standstill_of(seen.T_root_link):
        return answer.cannot_tell(fault)
    observations = tracked_scene(seen.features, seen.camera, seen.T_root_link @ seen.T_link_camera)
    return answer.of(observations, seen, seen.covariance, pose_noise)


def check_by_each_other(one: MovingCamera, other: MovingCamera) -> SensorCheck:
    """Return whether the second of two cameras is where it was accepted relative to the first.

    Both have images of the same K moments, and links that do not move relative to each other. Without the distance of
    anything, a translation along the line between them cannot be told.
    """
    answer = WitnessAnswer(other.name, f"what {one.name} sees too", other.times)
    if fault := _fault_of_images(one) or _fault_of_images(other):
        return answer.cannot_tell(fault)
    T = inverse(one.T_root_link[0] @ one.T_link_camera) @ other.T_root_link[0] @ other.T_link_camera
    observations = matched_pairs(one.features, other.features, (one.camera, other.camera), T)
    to_other = inverse_adjoint(T)
    return answer.of(observations, other, other.covariance + to_other @ one.covariance @ to_other.T, RIGID_NOISE)


def standstill_of(T_root_link: Array) -> str:
    """Return that a link (K, 4, 4) stood still, and so says nothing; empty if it moved."""
    m, rad = distance(T_root_link[0], T_root_link)
    if m.max() < MIN_MOTION_M and rad.max() < MIN_MOTION_RAD:
        return f"it moved by {1e3 * m.max():.1f} mm and {np.degrees(rad.max()):.1f} degrees only"
    return ""


def _fault_of_images(seen: MovingCamera) -> str:
    """Return why images say nothing; empty if they may."""
    if len(seen.features) < MIN_IMAGES:
        return f"found {len(seen.features)} usable images of {seen.name}, expected {MIN_IMAGES}"
    middle = int(np.median([len(each) for each in seen.features]))
    if middle < MIN_FEATURES:
        return f"{seen.name} sees too little texture: found {middle} features in an image, expected {MIN_FEATURES}"
    return ""


@dataclass(frozen=True, eq=False)
class WitnessAnswer:
    """Answer about one sensor."""

    sensor: str
    method: str
    times: Array
    """(K,): s, of its images or scans."""
    is_camera: bool = True

    def cannot_tell(self, reason: str) -> SensorCheck:
        """Return that the recording does not tell, and why."""
        return SensorCheck(
            sensor=self.sensor, method=self.method, outcome="cannot-tell", reason=reason, images=len(self.times)
        )

    def of(
        self, observations: Observations, seen: MovingCamera, accepted: Array, pose_noise: tuple[float, float]
    ) -> SensorCheck:
        """Return what scene points say, once those that move are left out."""
        evidence = evidence_of(observations, seen.lens_sigmas) if len(observations.views) else None
        points = 0 if evidence is None else len(evidence.observations.clusters)
        if evidence is None or len(np.unique(evidence.observations.points)) < MIN_POINTS:
            return self.cannot_tell(f"found {points} points that stand still in a scene, expected {MIN_POINTS}")
        velocities = seen.velocities @ inverse_adjoint(seen.T_link_camera).T
        drift = drift_of_poses(observations.poses) if seen.drives else None
        return self.by(displacement_of(evidence, velocities, pose_noise, seen.lens_sigmas, accepted, drift))

    def by(self, found: Displacement) -> SensorCheck:
        """Return what a displacement says, whether significant or not."""
        m, rad = found.pose_noise
        if m > MAX_POSE_NOISE_M or rad > MAX_POSE_NOISE_RAD:
            off = f"{1e3 * m:.0f} mm and {np.degrees(rad):.1f} degrees"
            return self.cannot_tell(
                f"what is seen and the poses differ by {off} from moment to moment: does the scene move, or a clock?"
            )
        C = found.covariance
        unseen = [
            scale * smallest_seen(C, part, found.limit) for scale, part in ((1e3, slice(3)), (180 / np.pi, slice(3, 6)))
        ]
        sigmas = np.sqrt(np.diag(C))
        tells_rotation, tells_translation = unseen[1] <= MAX_UNSEEN_DEG, unseen[0] <= MAX_UNSEEN_MM
        moved = found.p < MAX_FALSE_ALARM
        outcome: Literal["moved", "unmoved", "cannot-tell"] = "moved" if moved else "unmoved"
        if not moved and not tells_rotation:
            outcome = "cannot-tell"
        since = None
        if moved and found.begin:
            since = float(self.times[found.begin - 1 : found.begin + 1].mean() - self.times[0])
        shown = tells_translation or (moved and (abs(found.twist[:3]) > MIN_SCORE * sigmas[:3]).any())
        return SensorCheck(
            sensor=self.sensor,
            method=self.method,
            outcome=outcome,
            reason=_reason(outcome, found, unseen, since, is_camera=self.is_camera),
            since=since,
            rotation_deg=tuple(np.degrees(found.twist[3:]).round(4).tolist()),
            rotation_sigma_deg=tuple(np.degrees(sigmas[3:]).round(4).tolist()),
            translation_mm=tuple((1e3 * found.twist[:3]).round(3).tolist()) if shown else None,
            translation_sigma_mm=tuple((1e3 * sigmas[:3]).round(3).tolist()) if shown else None,
            p=found.p,
            unseen_deg=round(unseen[1], 4) if tells_rotation else None,
            unseen_mm=round(unseen[0], 3) if tells_translation else None,
            images=len(self.times),
        )


def _reason(outcome: str, found: Displacement, unseen: list[float], since: float | None, *, is_camera: bool) -> str:
    """Return in one sentence what was found, or what cannot be."""
    sigmas, deg = np.sqrt(np.diag(found.covariance)), unseen[1]
    score = math.sqrt(found.limit) + SCORE_OF_POWER
    variances, axes = np.linalg.eigh(found.covariance[:3, :3])
    deviations, along = np.sqrt(np.maximum(variances, 0)), found.twist[:3] @ axes
    told = (score * deviations <= 1e-3 * MAX_UNSEEN_MM) | (abs(along) > MIN_SCORE * deviations)
    turns = _axes_in_words(np.flatnonzero(score * sigmas[3:] > math.radians(MAX_UNSEEN_DEG)))
    if outcome == "cannot-tell":
        return (
            f"a turn about {turns} of less than {deg:.1f} degrees would go unseen: too little motion, or too few points"
        )
    unknown = ""
    if not told.all():
        shifts = _axes_in_words(np.unique(np.argmax(abs(axes[:, ~told]), 0)))
        unknown = f"; a shift along {shifts} cannot be told here"
    if outcome == "unmoved":
        mm = 1e3 * score * float(deviations[told].max(initial=0.0))
        shift = f" or a shift of {mm:.1f} mm" if told.any() else ""
        when = ", if it is there all along" if found.may_slip else ""
        return f"a turn of {deg:.2f} degrees{shift} would be seen in 99 %{when}{unknown}"
    shifted, turned = axes[:, told] @ along[told], found.twist[3:]
    parts = []
    if (abs(turned) > MIN_SCORE * sigmas[3:]).any():
        words = direction_in_words(np.degrees(turned).tolist(), is_camera=is_camera)
        parts.append(f"turned by {np.degrees(np.linalg.norm(turned)):.2f} degrees {words}")
    if (abs(along) > MIN_SCORE * deviations).any():
        axis = "xyz"[int(np.argmax(abs(shifted)))]
        parts.append(f"shifted by {1e3 * np.linalg.norm(shifted):.1f} mm, most along {axis}")
    when = "all along" if since is None else f"from {since:.1f} s on"
    return f"it is {' and '.join(parts) or 'elsewhere, in a direction that is not told'}, {when}{unknown}"


def _axes_in_words(axes: IntArray) -> str:
    return " and ".join("xyz"[axis] for axis in axes.tolist()) or "some line"
