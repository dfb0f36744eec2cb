"""LiDARs against the motion of what carries them, by the crispness of the map that their scans make.

Where poses and mount are right, what several scans see of a plane coincides, and the map is crisp. As in BALM (Liu and
Zhang, 2021) the planes are those of voxels, a patch of a plane in a scan is the sums of its points' products, which is
all that least squares needs, and the planes are eliminated. Patches that fit no plane lose their weight by graduated
non-convexity (Geman and McClure's kernel; Black and Rangarajan, 1996).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calibration.addons.guard.outcome import SensorCheck
from calibration.addons.guard.witness.bundle import LENS_COLUMNS, WIDTH, sums_of_groups, unknown_prior
from calibration.addons.guard.witness.checks import MIN_IMAGES, POSE_NOISE, WitnessAnswer, standstill_of
from calibration.addons.guard.witness.displacement import displacement_of, drift_of_poses
from calibration.addons.guard.witness.recorded_frames import Carriage, RecordedFrames, evenly_chosen
from calibration.base import InputError
from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.baseline.calibration_document import CalibratedPose, CalibrationDocument
from calibration.engine.dataset.modalities import LIDAR3D
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import apply, inverse_adjoint, retract
from calibration.robot.importing.bags.bag import LIVOX_TYPES, NS_PER_S, Bag, open_bag
from calibration.robot.importing.bags.messages import frame_of
from calibration.robot.importing.bags.motion import MotionLog
from calibration.robot.importing.bags.range_views import cloud_of, livox_points
from calibration.robot.importing.bags.survey import MODALITY_OF_MESSAGE, add_motion, motion_topics

RANGE_SIGMAS = np.array([0.01, 1e-3, 0.0])
"""What a LiDAR's ranges may have in common: an offset, m, and a relative error. The third column is not used."""
VOXEL_SHARE, MIN_VOXEL, MAX_VOXEL = 0.2, 0.05, 1.0
"""Edge of a voxel in median ranges, and its limits, m."""
MIN_POINTS_OF_PATCH = 12
MAX_THICKNESS, MIN_BREADTH = 0.2, 0.08
"""Standard deviations of a patch across it, relative to its breadth, and along that, relative to the voxel."""
MAX_SIGMAS_OF_PATCH = 3.0
"""By how much thicker than most a patch may be: others are edges between two surfaces, or leaves."""
MIN_FACING = 0.3
"""Least cosine of the incidence: what ranges err in shows across a plane by it, as far as the beam is thin."""
MAX_NORMAL_RAD, MAX_APART = 0.2, 0.25
"""rad, and relative to the voxel: limits between the patches of one plane, as the accepted mount has them."""
MIN_SCANS_OF_PLANE = 3
MIN_RANGE_M, MAX_RANGE_M = 0.01, 500.0
MAX_POINTS_OF_SCAN = 50_000
"""That are looked at, evenly chosen."""
MIN_SIGMA_M = 5e-4
"""m: no LiDAR measures better."""
WIDEST_SIGMAS, LAST_SIGMAS = 60.0, 3.5
"""Scales of the first and of the last kernel, in standard deviations of a patch."""
KERNELS = 8
MOMENTS = 7
"""Of a point: x, y, z, 1, and the direction of its ray."""
UNKNOWNS = WIDTH + 3
"""What a residual depends on: pose, range, and plane (two slopes and the distance)."""
METHOD = "the map's crispness, by the motion of what carries it"
MIN_PLANES = 40
"""Parts of planes that fit."""
SCAN_TIME = 0.1
"""s: time that a scan takes."""
MAX_CANDIDATES = 2000
"""Scans of which the motion is looked at, evenly over the recording."""
LOCALISED_IN = "map"
"""Frame in which a robot is localised (REP 105), mostly by its LiDAR, which is no witness against itself."""
NO_WITNESS_OF_LIDAR = (
    f"nothing that moves carries it: found no pose by joints or odometry in the recording, and one in '{LOCALISED_IN}' "
    "may come from the LiDAR itself"
)
MAX_SKEW_M, MAX_SKEW_RAD = 0.01, 0.003
"""m and rad: limits of the motion during a scan, which bends its planes."""


@dataclass(frozen=True, eq=False)
class PlanePatches:
    """Patches of J planes in K scans."""

    poses: Array
    """(K, 4, 4): ``T_root_sensor`` by the accepted mount."""
    scans: IntArray
    """(M,): scan of each patch."""
    planes: IntArray
    """(M,): plane of each patch, 0 .. J - 1."""
    products: Array
    """(M, MOMENTS, MOMENTS): sums over its points p of ``u u^T``, ``u = (p, 1, p / |p|)`` in the sensor's frame."""
    sigmas: Array
    """(M,) m: standard deviation of a point across each patch."""

    def kept(self, mask: BoolArray) -> "PlanePatches":
        """Return some patches: of planes that enough scans see."""
        mask = (
            mask
            & (np.bincount(self.planes[mask], minlength=self.planes.max(initial=0) + 1) >= MIN_SCANS_OF_PLANE)[
                self.planes
            ]
        )
        _, planes = np.unique(self.planes[mask], return_inverse=True)
        return PlanePatches(self.poses, self.scans[mask], planes, self.products[mask], self.sigmas[mask])


def patches_of_scans(scans: Sequence[Array], poses: Array) -> PlanePatches:
    """Return the planes that scans see again.

    Args:
        scans: points (N, 3) of each of K, m, in the sensor's frame; not finite where nothing returned.
        poses: (K, 4, 4) ``T_root_sensor`` by the accepted mount.
    """
    scans = [_returned_points(scan) for scan in scans]
    lengths = np.concatenate([np.ones(1), *(np.linalg.norm(scan, axis=-1) for scan in scans)])
    voxel = float(np.clip(VOXEL_SHARE * np.median(lengths), MIN_VOXEL, MAX_VOXEL))
    found = [_patches_of_scan(scan, T, voxel) for scan, T in zip(scans, poses, strict=True)]
    k = np.repeat(np.arange(len(scans)), [len(cells) for cells, _ in found])
    cells, products = (np.concatenate(each) for each in zip(*found, strict=True))
    counts = products[:, 3, 3]
    means = products[:, :3, 3] / counts[:, None]
    variances, axes = np.linalg.eigh(_scatter(products))
    variances = np.maximum(variances, 0)
    flat = (variances[:, 0] < MAX_THICKNESS**2 * variances[:, 1]) & (variances[:, 1] > (MIN_BREADTH * voxel) ** 2)
    normals = axes[:, :, 0]
    normals = normals * -np.sign((normals * means).sum(-1, keepdims=True))  # to the sensor: walls have two sides
    facing = np.maximum(-(normals * means).sum(-1) / np.linalg.norm(means, axis=-1), MIN_FACING)
    thickness = np.sqrt(variances[:, 0] * counts / (counts - 3)) / facing
    sigma = max(float(np.median(thickness[flat])) if flat.any() else 0.0, MIN_SIGMA_M)
    flat &= thickness < MAX_SIGMAS_OF_PATCH * sigma
    normals, means = np.einsum("mab,mb->ma", poses[k, :3, :3], normals), apply(poses[k], means[:, None])[:, 0]
    to_face = abs(means - voxel * np.round(means / voxel)) / np.maximum(abs(normals), 1e-9)
    flat &= ((to_face > MAX_SIGMAS_OF_PATCH * sigma) | (abs(normals) < 0.7)).all(-1)  # else noise decides the voxel
    k, cells, products, counts, facing = k[flat], cells[flat], products[flat], counts[flat], facing[flat]
    normals, means = normals[flat], means[flat]
    planes = np.unique(cells, axis=0, return_inverse=True)[1].ravel()
    order = np.lexsort((-counts, planes))
    best = order[np.unique(planes[order], return_index=True)[1]][planes]
    same = (normals * normals[best]).sum(-1) > np.cos(MAX_NORMAL_RAD)
    same &= abs(((means - means[best]) * normals[best]).sum(-1)) < MAX_APART * voxel
    return PlanePatches(poses, k, planes, products, sigma * facing).kept(same)


def _returned_points(scan: Array) -> Array:
    """Return the points of a scan that are some; of a large one, evenly, a part."""
    away = abs(scan).max(-1, initial=0.0)  # not a number, and so left out, where nothing returned
    scan = scan[(away > MIN_RANGE_M) & (away < MAX_RANGE_M)]
    return scan[:: len(scan) // MAX_POINTS_OF_SCAN + 1]


def _patches_of_scan(scan: Array, T: Array, voxel: float) -> tuple[IntArray, Array]:
    """Return voxels (M, 3) with enough points of a scan, and the sums of their products."""
    cells = np.floor(apply(T, scan) / voxel).astype(np.int64)
    keys, groups = np.unique(cells, axis=0, return_inverse=True)
    u = np.concatenate([scan, np.ones((len(scan), 1)), scan / np.linalg.norm(scan, axis=-1, keepdims=True)], 1)
    products = sums_of_groups(u[:, :, None] * u[:, None, :], groups.ravel())
    enough = products[:, 3, 3] >= MIN_POINTS_OF_PATCH
    return keys[enough], products[enough]


def _scatter(products: Array) -> Array:
    """Return the covariances (M, 3, 3) of points by the sums of their products."""
    means = products[:, :3, 3] / products[:, 3, 3, None]
    return np.asarray(products[:, :3, :3] / products[:, 3, 3, None, None] - means[:, :, None] * means[:, None, :])


class _NormalEquations(NamedTuple):
    """Sums of one patch each, of residuals r and derivatives J by UNKNOWNS, in standard deviations of a point."""

    H: Array
    """(M, UNKNOWNS, UNKNOWNS): of ``J J^T``."""
    g: Array
    """(M, UNKNOWNS): of ``J r``."""
    cost: Array
    """(M,): of ``r^2``."""


@dataclass(frozen=True, eq=False)
class PlaneEvidence:
    """What planes say of the unknowns (n,): twists of the poses in the sensor's frame, scan by scan, and its ranges.

    ``b = S x + noise`` with ``noise ~ (0, S)`` for the true unknowns x, all planes eliminated (Schur).
    """

    S: Array
    """(n, n)."""
    b: Array
    """(n,)."""
    patches: PlanePatches
    """Those that fit."""
    found: Array
    """(n,): the unknowns at which it is linearised."""
    equations: _NormalEquations

    def scores(self, x: Array, B: Array) -> Array:
        """Return ``B^T noise`` (J, p) of each plane, if x (n,) are the true unknowns; B is (n, p)."""
        at, planes = _columns_of_patches(self.patches), self.patches.planes
        H, g, _ = self.equations
        g = g - np.einsum("mij,mj->mi", H[:, :, :WIDTH], (x - self.found)[at])
        step = np.einsum("jab,jb->ja", _inverses_of(H, planes), sums_of_groups(g[:, WIDTH:], planes))
        g = g - np.einsum("mij,mj->mi", H[:, :, WIDTH:], step[planes])
        return sums_of_groups(np.einsum("mi,mip->mp", g[:, :WIDTH], B[at]), planes)


def plane_evidence(patches: PlanePatches) -> PlaneEvidence | None:
    """Return what planes say of the poses; None without any."""
    if not len(patches.planes):
        return None
    n = 6 * len(patches.poses) + LENS_COLUMNS
    x, planes = np.zeros(n), _fitted_planes(patches, np.ones(len(patches.planes)), np.zeros(n))
    for step in range(KERNELS):
        scale = WIDEST_SIGMAS * (LAST_SIGMAS / WIDEST_SIGMAS) ** (step / (KERNELS - 1))
        equations = _linearised_planes(patches, x, planes)
        weights = (1 + equations.cost / patches.products[:, 3, 3] / scale**2) ** -2
        S, g = _without_planes(patches, equations, weights)
        prior = unknown_prior(len(patches.poses), np.zeros(LENS_COLUMNS), 1.0)  # what ranges err in comes later
        x = x + np.linalg.solve(S + prior, g - prior @ x)
        planes = _fitted_planes(patches, weights, x)
    patches = patches.kept(equations.cost / patches.products[:, 3, 3] < LAST_SIGMAS**2)
    if not len(patches.planes):
        return None
    # All poses at one mount, as in `evidence_of`.
    x = np.concatenate([np.tile(x[:-LENS_COLUMNS].reshape(-1, 6).mean(0), len(patches.poses)), np.zeros(LENS_COLUMNS)])
    weights = np.ones(len(patches.planes))
    equations = _linearised_planes(patches, x, _fitted_planes(patches, weights, x))
    S, g = _without_planes(patches, equations, weights)
    return PlaneEvidence(S, S @ x + g, patches, x, equations)


def _columns_of_patches(patches: PlanePatches) -> IntArray:
    """Return the columns (M, WIDTH) of the unknowns on which each patch depends."""
    lens = np.broadcast_to(6 * len(patches.poses) + np.arange(LENS_COLUMNS), (len(patches.scans), LENS_COLUMNS))
    return np.concatenate([6 * patches.scans[:, None] + np.arange(6), lens], 1)


def _fitted_planes(patches: PlanePatches, weights: Array, x: Array) -> Array:
    """Return the planes (J, 4), a normal and a distance, through weighted patches from poses that are off by x."""
    T = retract(patches.poses, x[:-LENS_COLUMNS].reshape(-1, 6))[patches.scans]
    weights = weights / patches.sigmas**2
    sums = sums_of_groups(
        weights[:, None, None] * (T @ patches.products[:, :4, :4] @ T.transpose(0, 2, 1)), patches.planes
    )
    means = sums[:, :3, 3] / sums[:, 3, 3, None]
    normals = np.linalg.eigh(_scatter(sums))[1][:, :, 0]
    return np.concatenate([normals, -(normals * means).sum(-1, keepdims=True)], 1)


def _linearised_planes(patches: PlanePatches, x: Array, planes: Array) -> _NormalEquations:
    """Return the sums of each patch; every residual and derivative is linear in a point's moments u."""
    T = retract(patches.poses, x[:-LENS_COLUMNS].reshape(-1, 6))[patches.scans]
    own = planes[patches.planes]
    m = np.einsum("mba,mb->ma", T[:, :3, :3], own[:, :3])
    of = np.zeros((len(m), UNKNOWNS, MOMENTS))
    residual = np.zeros((len(m), MOMENTS))
    residual[:, :3], residual[:, 3] = m, (own[:, :3] * T[:, :3, 3]).sum(-1) + own[:, 3]
    of[:, :3, 3] = m
    of[:, 3:6, :3] = -rotations.hat(m)
    of[:, 6, 4:] = m
    of[:, 7, 3] = -residual[:, 3]  # m p on the plane: with the measured p the noise would be in its own derivative
    slopes = np.linalg.svd(own[:, None, :3])[2][:, 1:]
    of[:, WIDTH : WIDTH + 2, :3] = slopes @ T[:, :3, :3]
    of[:, WIDTH : WIDTH + 2, 3] = np.einsum("mab,mb->ma", slopes, T[:, :3, 3])
    of[:, -1, 3] = 1
    scaled = patches.products / patches.sigmas[:, None, None] ** 2
    g = -np.einsum("mij,mjk,mk->mi", of, scaled, residual)
    cost = np.einsum("mi,mij,mj->m", residual, scaled, residual)
    return _NormalEquations(of @ scaled @ of.transpose(0, 2, 1), g, cost)


def _inverses_of(H: Array, planes: IntArray) -> Array:
    """Return the inverses (J, 3, 3) of the planes' own normal equations."""
    V = sums_of_groups(H[:, WIDTH:, WIDTH:], planes)
    return np.asarray(np.linalg.inv(V + 1e-9 * np.einsum("jaa->j", V)[:, None, None] * np.eye(3)))


def _without_planes(patches: PlanePatches, equations: _NormalEquations, weights: Array) -> tuple[Array, Array]:
    """Return the normal equations (n, n), (n,) of the unknowns, the planes eliminated."""
    n, at, planes = 6 * len(patches.poses) + LENS_COLUMNS, _columns_of_patches(patches), patches.planes
    H, g = weights[:, None, None] * equations.H, weights[:, None] * equations.g
    S, b = np.zeros((n, n)), np.zeros(n)
    np.add.at(S, (at[:, :, None], at[:, None, :]), H[:, :WIDTH, :WIDTH])
    np.add.at(b, at, g[:, :WIDTH])
    mixed = np.zeros((n, planes.max() + 1, 3))
    np.add.at(mixed, (at, planes[:, None]), H[:, :WIDTH, WIDTH:])
    back = np.einsum("nja,jab->njb", mixed, _inverses_of(H, planes))
    S -= back.reshape(n, -1) @ mixed.reshape(n, -1).T
    b -= back.reshape(n, -1) @ sums_of_groups(g[:, WIDTH:], planes).ravel()
    return 0.5 * (S + S.T), b


@dataclass(frozen=True, eq=False)
class MovingLidar:
    """A LiDAR with its scans, and where the link that carries it was."""

    name: str
    carriage: Carriage
    scans: Sequence[Array]
    """Points (N, 3) of each of the K scans, m, in the frame of its data."""


def check_by_map(seen: MovingLidar) -> SensorCheck:
    """Return whether a LiDAR is where it was accepted: what several scans see of a plane must coincide."""
    way, stamps = seen.carriage, seen.carriage.stamps
    answer = WitnessAnswer(seen.name, METHOD, (stamps - stamps[0]) / NS_PER_S, is_camera=False)
    if len(stamps) < MIN_IMAGES:
        return answer.cannot_tell(
            f"found {len(stamps)} scans with a known pose and less motion during them than {1e3 * MAX_SKEW_M:g} mm and "
            f"{np.degrees(MAX_SKEW_RAD):.1f} degrees, expected {MIN_IMAGES}: stop now and then"
        )
    if fault := standstill_of(way.T_root_link):
        return answer.cannot_tell(fault)
    poses = way.T_root_link @ way.T_link_sensor
    evidence = plane_evidence(patches_of_scans(seen.scans, poses))
    planes = 0 if evidence is None else len(np.unique(evidence.patches.planes))
    if evidence is None or planes < MIN_PLANES:
        return answer.cannot_tell(f"found {planes} parts of planes that several scans see, expected {MIN_PLANES}")
    velocities = way.velocities @ inverse_adjoint(way.T_link_sensor).T
    drift = drift_of_poses(poses) if way.drives else None
    found = displacement_of(evidence, velocities, POSE_NOISE, RANGE_SIGMAS, way.covariance, drift)
    return answer.by(found)


def map_checks_of_bag(path: Path, accepted: CalibrationDocument) -> Iterator[SensorCheck]:
    """Check the accepted LiDARs of a bag by the motion that carries them.

    Args:
        path: the bag.
        accepted: the calibration.

    Raises:
        InputError: the bag cannot be read.
    """
    with open_bag([path]) as bag:
        if not (clouds := cloud_topics(bag)):
            return
        log, moving = MotionLog(), motion_topics(bag)
        stamps: dict[str, dict[int, int]] = {topic: {} for topic in clouds}
        frame: dict[str, str] = {}
        for message in bag.messages({*clouds, *moving}):
            if message.topic in moving:
                add_motion(bag, message, log)
            else:
                stamps[message.topic][bag.stamp(message)] = message.recorded
                if message.topic not in frame:
                    frame[message.topic] = frame_of(bag.decode(message))
        frames = RecordedFrames(log, accepted, LOCALISED_IN)
        for pose in accepted.poses:
            own = [topic for topic, name in frame.items() if pose.sensor and is_of(pose, topic, name)]
            if own:
                try:
                    if not frames.moves(frames.root(pose.parent), pose.parent):
                        raise InputError(NO_WITNESS_OF_LIDAR)
                    found = check_by_map(_moving_lidar(bag, pose, frames, own[0], frame[own[0]], stamps[own[0]]))
                except InputError as error:
                    found = SensorCheck(sensor=pose.name, method=METHOD, outcome="cannot-tell", reason=str(error))
                yield found


def cloud_topics(bag: Bag) -> list[str]:
    """Return the topics of clouds."""
    return [topic for topic, kind in bag.topics.items() if MODALITY_OF_MESSAGE.get(kind) == LIDAR3D]


def cloud_at(bag: Bag, topic: str, recorded: Mapping[int, int], stamp: int) -> Array:
    """Return the points (N, 3) of the scan of a stamp, ns.

    Args:
        bag: the bag.
        topic: of clouds.
        recorded: recording time, ns, by stamp.
        stamp: ns.

    Raises:
        InputError: it cannot be decoded.
    """
    message = next(iter(bag.messages({topic}, recorded[stamp], recorded[stamp] + 1)))
    where, content = f"{bag.path}: {topic} at {stamp / NS_PER_S:.3f}", bag.decode(message)
    return (livox_points if bag.topics[topic] in LIVOX_TYPES else cloud_of)(content, where)


def is_of(pose: CalibratedPose, topic: str, frame: str) -> bool:
    """Whether a topic is a sensor's, by its first part or by the frame of its data."""
    return topic.strip("/").split("/")[0] == pose.sensor or frame == pose.child


def _moving_lidar(
    bag: Bag, pose: CalibratedPose, frames: RecordedFrames, topic: str, frame: str, recorded: dict[int, int]
) -> MovingLidar:
    """Return the scans of a topic that took little motion, and where the link was.

    Raises:
        InputError: a scan cannot be decoded, or no pose of the link was recorded near any.
    """
    stamps = np.array(sorted(recorded))
    every = frames.carriage(pose, frame, stamps[:: len(stamps) // MAX_CANDIDATES + 1], topic)
    skew = np.linalg.norm(SCAN_TIME * every.velocities.reshape(-1, 2, 3), axis=-1)
    slow = every.stamps[(skew < [MAX_SKEW_M, MAX_SKEW_RAD]).all(-1)]
    if not len(slow):
        slow = every.stamps[:1]
    carriage = frames.carriage(pose, frame, evenly_chosen(slow), topic)
    scans = [cloud_at(bag, topic, recorded, stamp) for stamp in carriage.stamps.tolist()]
    return MovingLidar(pose.name, carriage, scans)
