"""A camera and a LiDAR against each other by edges that both see: where a cloud's depth jumps, an image has an edge.

As Levinson and Thrun (2013) have it, edges of the depth must lie on edges of the image. Here each is found in the image
along a line across it, as in the tracking of known shapes (Harris and Stennett, 1990; Drummond and Cipolla, 2002), and
of several image edges the nearest one counts, as the fit goes on (Vacchetti, Lepetit and Fua, 2004). The true edge is
between two neighbouring rays, which is its error. Edges that fit none lose their weight by graduated non-convexity
(Geman and McClure's kernel; Black and Rangarajan, 1996).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from calibration.addons.guard.outcome import MAX_FALSE_ALARM, SensorCheck
from calibration.addons.guard.witness.bundle import LENS_COLUMNS, WIDTH, sums_of_groups, unknown_prior
from calibration.addons.guard.witness.checks import MIN_IMAGES, RIGID_NOISE, WitnessAnswer
from calibration.addons.guard.witness.displacement import Displacement, displacement_of
from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import apply
from calibration.robot.labelling.detection import Image

CELL_RAD = 0.0044
"""rad: height of the rows, and width of the columns, in which rays are neighbours."""
MAX_STEP_RAD = 0.02
"""rad: limit of the angle between neighbouring rays."""
MIN_JUMP_SHARE, MIN_JUMP_M = 0.1, 0.1
"""Least jump of the range, relative to the nearer one, and in m."""
MIN_JUMP_TO_SLOPE = 3.0
"""Least ratio of the jump to the steps on both sides of it: a floor that is seen at a slant has large steps too."""
MIN_RANGE_M, MAX_RANGE_M = 0.2, 100.0
MAX_EDGES = 400
"""Edges of a scan, evenly chosen."""
SEARCH_PX = 20
"""px: how far from its expected place an edge is looked for."""
CANDIDATES = 5
"""Edges of the image that may be one of the depth, the strongest."""
MIN_GRADIENT_TO_NOISE, MIN_GRADIENT = 2.5, 3.0
"""Least gradient, relative to the image's median one, and in grey levels a pixel."""
MIN_ACROSS = 0.5
"""Least cosine between the search line and the gradient."""
BLUR_PX = 1.0
IMAGE_EDGE_PX = 0.7
"""px: standard deviation of an edge of an image."""
BANDS = (48, 36)
"""Columns and rows of the image: edges along one of these are one cluster, as they may be of one thing."""
WIDEST_SIGMAS, LAST_SIGMAS = (3.0, 8.0), 3.0
"""Scales of the first kernel, of which the one counts that makes more edges fit, and of the last, in standard
deviations: what has not moved is found by the narrow one, where the wide one may be led astray by what repeats."""
KERNELS = 8
BEAM_SIGMA = 1.5e-3
"""rad: by which a LiDAR's beams may make all things broader."""
AWAY_RAD = 0.04
"""rad: by so much turned, edges coincide by chance only."""
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
class DepthEdges:
    """Edges of the depth in a scan, in the LiDAR's frame."""

    at: Array
    """(E, 3) m: on the nearer thing, in the middle of the two rays."""
    step: Array
    """(E, 3) m: from the nearer thing's ray to the farther one's, at the nearer distance."""


@dataclass(frozen=True, eq=False)
class EdgeCandidates:
    """Edges of images that may be those of the depth, M, of E edges of the depth in K moments."""

    moments: IntArray
    """(E,): moment of each edge of the depth."""
    number: int
    """K."""
    edges: IntArray
    """(M,): edge of the depth of each candidate."""
    residuals: Array
    """(M,) px: from the expected place to the candidate, along its normal."""
    by_unknowns: Array
    """(M, WIDTH): derivatives of the expected place by the twist of the camera, the beam's width, the centre."""
    sigmas: Array
    """(M,) px: standard deviations of the residuals."""
    clusters: IntArray
    """(M,): columns of the image, for upright edges, and rows."""

    @property
    def columns(self) -> IntArray:
        """Columns (M, WIDTH) of the unknowns on which each candidate depends."""
        return self.columns_of(self.moments[self.edges])

    def columns_of(self, moments: IntArray) -> IntArray:
        """Return the columns (N, WIDTH) of the unknowns of moments."""
        shared = np.broadcast_to(6 * self.number + np.arange(LENS_COLUMNS), (len(moments), LENS_COLUMNS))
        return np.concatenate([6 * moments[:, None] + np.arange(6), shared], 1)

    def scores(self, x: Array) -> Array:
        """Return the residuals (M,) in standard deviations, if x (n,) are the unknowns."""
        return np.asarray((self.residuals - (self.by_unknowns * x[self.columns]).sum(1)) / self.sigmas)

    def kept(self, mask: BoolArray) -> "EdgeCandidates":
        """Return some of them."""
        return replace(
            self, edges=self.edges[mask], residuals=self.residuals[mask], by_unknowns=self.by_unknowns[mask],
            sigmas=self.sigmas[mask], clusters=self.clusters[mask],
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class EdgeEvidence:
    """What edges say of the unknowns (n,): twists of the camera in its frame, moment by moment, beam and centre."""

    S: Array
    """(n, n): ``b = S x + noise`` with ``noise ~ (0, S)`` for the true unknowns x."""
    b: Array
    """(n,)."""
    candidates: EdgeCandidates
    """Those that fit, one an edge, with the standard deviations that they show."""
    agreement: float
    """Share of the edges that have one where they are expected, relative to that by chance."""

    def scores(self, x: Array, B: Array) -> Array:
        """Return ``B^T noise`` (C, p) of each cluster, if x (n,) are the true unknowns; B is (n, p)."""
        c = self.candidates
        each = (c.scores(x) / c.sigmas)[:, None] * c.by_unknowns
        return sums_of_groups(np.einsum("mi,mip->mp", each, B[c.columns]), c.clusters)


def depth_edges(points: Array) -> DepthEdges:
    """Return where the depth of a scan jumps: points (N, 3) in the LiDAR's frame, not finite where nothing returned."""
    away = abs(points).max(-1, initial=0.0)  # not a number, and so left out, where nothing returned
    points = points[(away > MIN_RANGE_M) & (away < MAX_RANGE_M)]
    ranges = np.linalg.norm(points, axis=-1)
    rays = points / ranges[:, None]
    azimuth, elevation = np.arctan2(rays[:, 1], rays[:, 0]), np.arcsin(np.clip(rays[:, 2], -1, 1))
    near, far = [], []
    for across, along in ((elevation, azimuth), (azimuth, elevation)):
        order = np.lexsort((along, np.floor(across / CELL_RAD)))
        r, apart = ranges[order], np.linalg.norm(np.diff(rays[order], axis=0), axis=-1)
        jump, close = np.diff(r), apart < MAX_STEP_RAD
        least = np.maximum(MIN_JUMP_M, MIN_JUMP_SHARE * np.minimum(r[:-1], r[1:]))
        is_edge = close & (abs(jump) > least)
        slope = np.maximum(abs(jump[:-2]), abs(jump[2:]))
        is_edge[1:-1] &= close[:-2] & close[2:] & (abs(jump[1:-1]) > MIN_JUMP_TO_SLOPE * slope)
        at = np.flatnonzero(is_edge[1:-1]) + 1
        at = at[:: len(at) // MAX_EDGES + 1]
        is_rising = jump[at] > 0
        near.append(order[np.where(is_rising, at, at + 1)])
        far.append(order[np.where(is_rising, at + 1, at)])
    one, other = np.concatenate(near), np.concatenate(far)
    middle = rays[one] + rays[other]
    middle /= np.linalg.norm(middle, axis=-1, keepdims=True)
    return DepthEdges(ranges[one, None] * middle, ranges[one, None] * (rays[other] - rays[one]))


def edge_candidates(
    images: Sequence[Image], scans: Sequence[Array], camera: Camera, T_camera_lidar: Array
) -> EdgeCandidates:
    """Return the edges of images that may be those of the depth.

    Args:
        images: grey, of each of K moments.
        scans: points (N, 3) of the LiDAR at each.
        camera: with the accepted lens.
        T_camera_lidar: (4, 4) accepted.
    """
    found = [
        _candidates_of_image(image, depth_edges(scan), camera, T_camera_lidar)
        for image, scan in zip(images, scans, strict=True)
    ]
    counts = [int(edges.max(initial=-1)) + 1 for edges, *_ in found]
    first = np.concatenate([[0], np.cumsum(counts)])
    edges, residuals, by_unknowns, sigmas, clusters = (np.concatenate(each) for each in zip(*found, strict=True))
    edges = edges + np.repeat(first[:-1], [len(each[0]) for each in found])
    moments = np.repeat(np.arange(len(counts)), counts)
    return EdgeCandidates(moments, len(counts), edges, residuals, by_unknowns, sigmas, clusters)


def _candidates_of_image(
    image: Image, edges: DepthEdges, camera: Camera, T: Array
) -> tuple[IntArray, Array, Array, Array, IntArray]:
    """Return edge, residual, derivatives, standard deviation and cluster of each candidate in one image."""
    points = apply(T, edges.at)
    centre = camera.project(points)
    step = camera.project(apply(T, edges.at + 0.5 * edges.step)) - camera.project(apply(T, edges.at - 0.5 * edges.step))
    gap = np.linalg.norm(step, axis=-1)
    inside = (
        abs(centre - [camera.width / 2, camera.height / 2])
        < np.array([camera.width, camera.height]) / 2 - SEARCH_PX - 2
    )
    seen = inside.all(-1) & (gap > 1e-6) & (gap < 2 * SEARCH_PX) & (points[:, 2] > 0)
    points, centre, gap, step = points[seen], centre[seen], gap[seen], step[seen]
    along = step / gap[:, None]
    if not len(centre):
        return np.zeros(0, int), np.zeros(0), np.zeros((0, WIDTH)), np.zeros(0), np.zeros(0, int)
    edge, at, gradients = _image_edges_along(image, centre, along)
    normal = gradients / np.linalg.norm(gradients, axis=-1, keepdims=True)
    across = (normal * along[edge]).sum(-1)
    good = abs(across) > MIN_ACROSS
    edge, at, normal, across = edge[good], at[good], normal[good], across[good]
    by_point = np.einsum("mi,mij->mj", normal, np.moveaxis(camera.slopes(points.T), -1, 0)[edge])
    by_unknowns = np.zeros((len(edge), WIDTH))
    by_unknowns[:, :3] = -by_point
    by_unknowns[:, 3:6] = np.einsum("mi,mij->mj", by_point, rotations.hat(points[edge]))
    by_unknowns[:, 6] = across * camera.fx
    by_unknowns[:, 7:] = normal * [camera.fx, camera.fy]
    sigmas = np.hypot(IMAGE_EDGE_PX, across * gap[edge] / np.sqrt(12))
    band = (centre[edge] / [camera.width, camera.height] * BANDS).astype(int)
    is_upright = abs(normal[:, 0]) > abs(normal[:, 1])
    clusters = np.where(is_upright, band[:, 0], BANDS[0] + band[:, 1])
    edge = np.unique(edge, return_inverse=True)[1]
    return edge, at * across, by_unknowns, sigmas, clusters


def _image_edges_along(image: Image, centre: Array, along: Array) -> tuple[IntArray, Array, Array]:
    """Find the strongest edges of an image on lines across expected ones, to `SEARCH_PX` on both sides.

    Args:
        image: grey.
        centre: (L, 2) px, middle of each line.
        along: (L, 2) its unit direction.

    Returns:
        The line (M,) of each edge, its place on it (M,) px from the middle, and the gradient (M, 2) there.
    """
    smooth = cv2.GaussianBlur(image, (0, 0), BLUR_PX).astype(np.float32)
    slopes = [cv2.Scharr(smooth, cv2.CV_32F, *axis) / 32 for axis in ((1, 0), (0, 1))]
    t = np.arange(-SEARCH_PX, SEARCH_PX + 1, dtype=float)
    places = (centre[:, None] + t[:, None] * along[:, None]).astype(np.float32)
    u, v = places[..., 0], places[..., 1]
    g = np.stack([cv2.remap(each, u, v, cv2.INTER_LINEAR) for each in slopes], -1)
    size = abs((g * along[:, None]).sum(-1))
    noise = float(np.median(np.hypot(*slopes)))
    peak = np.zeros(size.shape, bool)
    peak[:, 1:-1] = (size[:, 1:-1] > size[:, :-2]) & (size[:, 1:-1] >= size[:, 2:])
    peak &= size > max(MIN_GRADIENT, MIN_GRADIENT_TO_NOISE * noise)
    ranked = np.where(peak, size, 0.0)
    peak &= ranked >= np.sort(ranked, 1)[:, -CANDIDATES, None]
    edge, index = np.nonzero(peak)
    a, b, c = (size[edge, index + i] for i in (-1, 0, 1))
    at = t[index] + 0.5 * (a - c) / np.minimum(a - 2 * b + c, -1e-6)
    return edge.astype(np.int64), np.asarray(at, float), np.asarray(g[edge, index], float)


def edge_evidence(candidates: EdgeCandidates, lens_sigmas: Array) -> EdgeEvidence | None:
    """Return what edges say; None if too few fit.

    Args:
        candidates: of images.
        lens_sigmas: (LENS_COLUMNS,) standard deviations of the beam's width, rad, and of the principal point, in focal
            lengths.
    """
    c, K = candidates, candidates.number
    n = 6 * K + LENS_COLUMNS
    if len(c.edges) < n:
        return None
    x = max((_fitted(c, lens_sigmas, n, widest) for widest in WIDEST_SIGMAS), key=lambda x: _share_at(c, x))
    r = c.scores(x)
    by_chance = np.mean(
        [_share_at(c, x + np.concatenate([np.tile(each, K), np.zeros(LENS_COLUMNS)])) for each in _turns_away()]
    )
    agreement = _share_at(c, x) / max(float(by_chance), 1e-9)
    c = c.kept(_is_nearest(c.edges, r) & (abs(r) < LAST_SIGMAS))
    if len(c.edges) < n:
        return None
    sigma = float(np.sqrt((c.scores(x) ** 2).sum() / (len(c.edges) - 6 * K)))
    c = replace(c, sigmas=c.sigmas * max(sigma, 1.0), clusters=np.unique(c.clusters, return_inverse=True)[1])
    S, b = _normal_equations(c, np.ones(len(c.edges)), n)
    return EdgeEvidence(S, b, c, agreement)


def _fitted(c: EdgeCandidates, lens_sigmas: Array, n: int, widest: float) -> Array:
    """Return the unknowns (n,) at which most edges fit, by kernels that narrow from a widest one."""
    prior = unknown_prior(c.number, lens_sigmas, 1.0)
    x: Array = np.zeros(n)
    for scale in np.geomspace(widest, LAST_SIGMAS, KERNELS).tolist():
        r = c.scores(x)
        weights = _is_nearest(c.edges, r) * (1 + (r / scale) ** 2) ** -2
        S, g = _normal_equations(c, weights, n)
        x = np.asarray(np.linalg.solve(S + prior, g), float)
    return x


def _turns_away() -> Array:
    """Return twists (8, 6) of a camera that is turned so far that edges coincide by chance."""
    angle = np.arange(8) * np.pi / 4
    return np.stack([*np.zeros((3, 8)), AWAY_RAD * np.cos(angle), AWAY_RAD * np.sin(angle), np.zeros(8)], -1)


def _share_at(c: EdgeCandidates, x: Array) -> float:
    """Return the share of edges that fit an edge of the image."""
    return len(np.unique(c.edges[abs(c.scores(x)) < 1.5])) / max(len(c.moments), 1)


def _is_nearest(edges: IntArray, r: Array) -> BoolArray:
    """Whether each candidate is the nearest of its edge."""
    order = np.lexsort((abs(r), edges))
    nearest = np.zeros(len(edges), bool)
    nearest[order[np.unique(edges[order], return_index=True)[1]]] = True
    return nearest


def _normal_equations(c: EdgeCandidates, weights: Array, n: int) -> tuple[Array, Array]:
    """Return the weighted normal equations (n, n), (n,), summed moment by moment."""
    used = weights > 0
    J, moments = c.by_unknowns[used], c.moments[c.edges[used]]
    scaled = (weights[used] / c.sigmas[used] ** 2)[:, None] * J
    blocks = sums_of_groups(scaled[:, :, None] * J[:, None], moments)
    at, S, g = c.columns_of(np.arange(len(blocks))), np.zeros((n, n)), np.zeros(n)
    np.add.at(S, (at[:, :, None], at[:, None, :]), blocks)
    np.add.at(g, at, sums_of_groups(scaled * c.residuals[used, None], moments))
    return S, g


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
