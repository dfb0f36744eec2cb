"""Candidates for the next pose: within the reach of what has moved in a recording, seen by its sensors.

- A board that was held by hand: in front of each camera, at the distances at which it was seen, anywhere in the image
  and tilted anyhow.
- Joints: anywhere between their limits in the robot's description; without one, a little beyond where they were.
- A transform of six degrees of freedom, such as that of an arm whose joints are not known: where it was, turned and
  moved a little. One that stayed in a plane, as a rig's that drives, stays in it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.model import Collection, Dataset, Edge, Labels, Sensor
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.estimation.covariance.fixed_inputs import STILL_TOLERANCE, joint_axis
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.geometry.frames import JointModel
from calibration.engine.geometry.transforms import local, retract
from calibration.robot.next_pose.expected_labels import distances, expected_labels
from calibration.robot.simulation.kinematics import joints_between, reach
from calibration.robot.simulation.motion_generation import draw_poses
from calibration.robot.simulation.system import MotionRanges
from calibration.robot.urdf import Robot

CANDIDATES = 48
"""Poses that are looked at, if so many can be had."""
DRAWN = 10
"""Poses that are drawn for each of them."""
BEYOND_TURN, BEYOND_SHIFT = np.radians(30), 0.15
"""rad, m: how far beyond where it was a joint or a transform without known limits goes."""
INSIDE_LIMITS = 0.001
"""rad, m: distance that is kept from a joint's limits."""
MAX_ROLL_BY_HAND = np.radians(45)
"""rad: a person holds a board about upright."""
REACHES_ANY_POSE = 6
"""Joints between a camera and a board with which it is held in any pose before it."""
MAX_FREE_TURN = np.radians(35)
"""rad: limit of a turn from where a transform was."""
MIN_OF_PLANE = 1e-3
"""Motion off a plane, relative to that in it, from which a transform does not stay in it."""


@dataclass(frozen=True, eq=False)
class PoseCandidates:
    """M poses that can be had."""

    dataset: Dataset
    """One collection for each, with the labels that are expected there."""
    sources: IntArray
    """(M,): the collection of the recording that each starts from."""
    joints: Mapping[str, Array]
    """Positions (M,) of the joints of a robot description, rad or m."""
    moved: tuple[Edge, ...]
    """The transforms that differ from pose to pose."""
    by_hand: bool
    """Whether a board is held by hand."""
    without_limits: tuple[Edge, ...]
    """Joints whose limits are not known."""

    def __len__(self) -> int:
        return len(self.sources)

    def take(self, index: IntArray) -> "PoseCandidates":
        """Return those of these indices."""
        return replace(
            self,
            dataset=self.dataset.with_collections(index.tolist()),
            sources=self.sources[index],
            joints={name: each[index] for name, each in self.joints.items()},
        )


def candidates_of(
    calibration: Calibration, robot: Robot | None = None, seed: int = 1, count: int = CANDIDATES
) -> PoseCandidates:
    """Return candidates for the next pose of a calibrated recording; none where nothing moves.

    Args:
        calibration: a calibration that has converged.
        robot: its description, with the limits of the joints; None if there is none.
        seed: of the draws.
        count: how many at most.
    """
    random = np.random.default_rng(seed)
    dataset = calibration.solution.dataset
    seen = {name for collection in dataset.collections for name, _ in collection.labels}
    boards = [pattern for pattern in dataset.patterns.values() if not pattern.fixed and pattern.name in seen]
    if boards:
        drawn, sources = _by_hand(dataset, boards, DRAWN * count, random)
        found = PoseCandidates(drawn, sources, {}, tuple(board.edge for board in boards), True, ())
    else:
        found = _by_robot(dataset, robot, DRAWN * count, random)
    return _seen(dataset, found, count)


def _copies(dataset: Dataset, sources: IntArray) -> Dataset:
    """Return collections without labels and motion, with the transforms of those of these indices."""
    still = replace(dataset, velocities={}, accelerations={})
    copies = still.with_collections(sources.tolist())
    return replace(copies, collections=tuple(Collection(str(k), {}) for k in range(len(sources))))


def _by_hand(
    dataset: Dataset, boards: Sequence[Pattern], count: int, random: np.random.Generator
) -> tuple[Dataset, IntArray]:
    """Draw poses of boards in front of the cameras; where none sees them, near where they were."""
    cameras = [sensor for sensor in dataset.sensors.values() if sensor.camera is not None]
    views = [(board, sensor) for board in boards for sensor in cameras if dataset.detections(board.name, sensor.name)]
    if not views:
        sources = random.integers(len(dataset.collections), size=count)
        near = {board.edge: _near(dataset.transforms[board.edge], sources, random) for board in boards}
        return _copies(dataset, sources).with_transforms(near), sources
    each = -(-count // len(views))
    sources = random.integers(len(dataset.collections), size=each * len(views))
    drawn = _copies(dataset, sources)
    transforms = {board.edge: np.tile(np.eye(4), (len(sources), 1, 1)) for board in boards}
    for k, (board, sensor) in enumerate(views):
        own = np.arange(k * each, (k + 1) * each)
        if sensor.camera is None:
            continue
        ranges = MotionRanges(distance=distances(dataset, sensor, board), roll=MAX_ROLL_BY_HAND)
        T_camera_board = draw_poses(sensor.camera, board, ranges, each, random)
        transforms[board.edge][own] = drawn.transform(board.parent_link, sensor.frame, own) @ T_camera_board
    return drawn.with_transforms(transforms), sources


def _by_robot(dataset: Dataset, robot: Robot | None, count: int, random: np.random.Generator) -> PoseCandidates:
    """Draw poses of what moves between the sensors and fixed patterns."""
    sources = random.integers(len(dataset.collections), size=count)
    edges: dict[Edge, None] = {}
    for pattern in dataset.patterns.values():
        for sensor in dataset.sensors.values():
            path = dataset.tree.path(sensor.frame, pattern.parent_link)
            edges |= dict.fromkeys((step.parent, step.child) for step in path)
    described = robot.by_edge if robot else {}
    sources, reached = (sources, {}) if robot is None else _reached(dataset, robot, sources, random)
    drawn = _copies(dataset, sources)
    transforms, joints, moved, free, positions = {}, {}, [], [], {}
    of_joint = {joint.edge: joint for joint in dataset.joints.values()}
    for edge in edges:
        T = dataset.transforms[edge]
        known = described.get(edge)
        is_joint = known is not None and known.is_movable
        if not is_joint and np.nanmax(np.abs(T - T[0])) <= STILL_TOLERANCE:
            continue
        moved.append(edge)
        if known is not None and is_joint:
            own = of_joint[edge].positions if edge in of_joint else local(known.T_parent_joint, T) @ known.twist
            low, high = max(known.lower, -np.pi) + INSIDE_LIMITS, min(known.upper, np.pi) - INSIDE_LIMITS
            if not np.isfinite(known.upper - known.lower):
                low, high = max(low, own.min() - BEYOND_TURN), min(high, own.max() + BEYOND_TURN)
            drawn_at = reached.get(known.name)
            at = _drawn_between(own[sources], low, high, random) if drawn_at is None else drawn_at
            twist, joints[known.name] = known.twist, np.clip(at, low, high)
            change = joints[known.name] - own[sources]
        elif (axis := joint_axis(T)) is not None:
            twist, own, prismatic = axis
            beyond = BEYOND_SHIFT if prismatic else BEYOND_TURN
            change = _drawn_between(own[sources], own.min() - beyond, own.max() + beyond, random) - own[sources]
            free.append(edge)
        else:
            free.append(edge)
            transforms[edge] = _near(T, sources, random)
            continue
        transforms[edge] = retract(T[sources], change[:, None] * twist)
        if edge in of_joint:
            sign = np.sign(float(twist @ _twist_of(of_joint[edge].model))) or 1.0
            positions[of_joint[edge].name] = of_joint[edge].positions[sources] + sign * change
    moved_joints = {
        name: replace(joint, positions=positions[name]) for name, joint in drawn.joints.items() if name in positions
    }
    drawn = replace(drawn, joints={**drawn.joints, **moved_joints}).with_transforms(transforms)
    if not moved:
        sources, drawn = sources[:0], drawn.with_collections([])
    return PoseCandidates(drawn, sources, joints, tuple(moved), False, tuple(free))


def _reached(
    dataset: Dataset, robot: Robot, sources: IntArray, random: np.random.Generator
) -> tuple[IntArray, dict[str, Array]]:
    """Return joint positions at which an arm of six joints or more holds a board anywhere before a camera.

    And the collections that they start from. Nothing of an arm with fewer, which reaches hardly any such pose.
    """
    views = [
        (sensor, pattern)
        for sensor in dataset.sensors.values()
        for pattern in dataset.patterns.values()
        if sensor.camera is not None
        and dataset.detections(pattern.name, sensor.name)
        and {sensor.frame, pattern.link} <= set(robot.tree.frames)
        and len(joints_between(robot, sensor.frame, pattern.link)) >= REACHES_ANY_POSE
    ]
    kept, found = [], dict[str, list[Array]]()
    for k, (sensor, pattern) in enumerate(views):
        if sensor.camera is None:
            continue
        own = sources[k :: len(views)]
        ranges = MotionRanges(distance=distances(dataset, sensor, pattern), roll=np.pi)
        T = draw_poses(sensor.camera, pattern, ranges, len(own), random)
        positions, good = reach(robot, sensor.frame, pattern.link, T, random)
        kept.append(own[good])
        for name, at in positions.items():
            found.setdefault(name, []).append(at[good])
    if not views:
        return sources, {}
    joints = {name: np.concatenate(each) for name, each in found.items() if len(each) == len(views)}
    return np.concatenate(kept), joints


def _twist_of(model: JointModel) -> Array:
    axis = np.array(model.axis, float)
    return np.concatenate([axis, np.zeros(3)] if model.prismatic else [np.zeros(3), axis])


def _drawn_between(own: Array, low: float, high: float, random: np.random.Generator) -> Array:
    """Return positions between limits, half of them near where the joint was."""
    anywhere = random.uniform(low, high, len(own))
    near = np.clip(own + random.normal(0, 0.15 * (high - low), len(own)), low, high)
    return np.where(random.random(len(own)) < 0.3, anywhere, near)


def _near(T: Array, sources: IntArray, random: np.random.Generator) -> Array:
    """Return transforms (M, 4, 4) near those of some collections; where one is not known, near the first that is."""
    known = np.isfinite(T[:, 0, 0])
    at = np.where(known[sources], sources, int(known.argmax()))
    return retract(T[at], _free_twists(T, len(sources), random))


def _free_twists(T: Array, count: int, random: np.random.Generator) -> Array:
    """Return twists (count, 6) by which a transform (N, 4, 4) may move from where it was, in its child's frame."""
    known = T[np.isfinite(T[:, 0, 0])]
    moved = local(known[0], known)
    shift = max(BEYOND_SHIFT, 0.5 * float(np.ptp(moved[:, :3], axis=0).max()))
    twists = np.concatenate(
        [random.normal(0, shift / 2, (count, 3)), random.normal(0, MAX_FREE_TURN / 2, (count, 3))], 1
    )
    normal = _normal_of_plane(moved)
    if normal is not None:
        twists[:, :3] -= (twists[:, :3] @ normal)[:, None] * normal
        twists[:, 3:] = (twists[:, 3:] @ normal)[:, None] * normal
    return twists


def _normal_of_plane(moved: Array) -> Array | None:
    """Return the normal (3,) of the plane that motions (N, 6) stay in, turning about it only; None if they do not."""
    _, sizes, axes = np.linalg.svd(moved[:, 3:], full_matrices=True)
    if sizes[0] <= STILL_TOLERANCE or sizes[1] > MIN_OF_PLANE * sizes[0]:
        return None
    off = np.abs(moved[:, :3] @ axes[0]).max()
    return np.asarray(axes[0]) if off <= max(MIN_OF_PLANE * np.abs(moved[:, :3]).max(), STILL_TOLERANCE) else None


def _seen(recorded: Dataset, found: PoseCandidates, count: int) -> PoseCandidates:
    """Return those that sensors see, with the labels that are expected. Cameras are looked at first: it is faster."""
    poses = found.dataset
    cameras, others = list[Sensor](), list[Sensor]()
    for sensor in poses.sensors.values():
        if any(name == sensor.name for collection in recorded.collections for _, name in collection.labels):
            (cameras if sensor.modality.has_corners else others).append(sensor)
    wanted = 2 if found.by_hand and len(cameras) + len(others) > 1 else 1
    labels: dict[int, dict[tuple[str, str], Labels]] = {k: {} for k in range(len(found))}
    for sensors, least in ((cameras, wanted - bool(others)), (others, wanted)):
        chosen = list(labels)
        some = poses.with_collections(chosen)
        for pattern in poses.patterns.values() if chosen else ():
            for sensor in sensors:
                for k, label in expected_labels(recorded, some, sensor, pattern).items():
                    labels[chosen[k]][pattern.name, sensor.name] = label
        enough = [k for k, own in labels.items() if len({name for _, name in own}) >= least]
        labels = {k: labels[k] for k in enough[: 2 * count if sensors is cameras else count]}
    kept = list(labels)
    seen = found.take(np.array(kept, int))
    collections = tuple(Collection(str(n), labels[k]) for n, k in enumerate(kept))
    return replace(seen, dataset=replace(seen.dataset, collections=collections))
