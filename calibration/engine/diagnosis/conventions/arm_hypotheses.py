"""Hypotheses on the poses of an arm, and of a pattern as it was measured: directions, rotations, units, joints."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import permutations

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.model import Dataset
from calibration.engine.diagnosis.conventions.changed import (
    scaled_translations,
    with_joint_positions,
    with_later_motion,
    with_measured,
    with_scaled_patterns,
)
from calibration.engine.diagnosis.conventions.hypotheses import Hypothesis, Misfit, Recording, SeenPoses
from calibration.engine.diagnosis.units import square
from calibration.engine.estimation.start.ambiguous_views import disagreement_of_each, rotations_that_agree
from calibration.engine.estimation.start.linear_solvers import RobotWorld, solve_robot_world, solve_robot_world_robustly
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import distance, inverse, transform

TURNED_TWICE = np.pi + 1e-6
"""rad: limit of an angle that a file holds."""
MOST_DEGREES = 180.0
"""Limit of the length of a rotation vector in degrees."""
RADIANS_PER_DEGREE = np.pi / 180
Axes = tuple[int, int, int]
"""0, 1, 2: x, y, z, in the order of the angles."""

QUATERNION_ORDERS = (("wxyz", "xyzw"), ("xyzw", "wxyz"))
"""Orders as they may be written, and as they are read then."""


@dataclass(frozen=True, eq=False)
class Reading:
    """A convention for the numbers of a rotation."""

    name: str
    """As in "rotations written as NAME"."""
    key: str
    """``rotation`` in import.yml."""
    rotation: Callable[[Array], Array]
    """From numbers (..., k) to rotations (..., 3, 3)."""
    numbers: Callable[[Array], Array]
    """From rotations (N, 3, 3) to the numbers (N, b, k) that may have been read, in b branches; NaN where there are
    fewer."""


@dataclass(frozen=True, eq=False)
class Rereading:
    """Rotations that were written by one convention and read by another."""

    written: str
    read: str
    keys: str
    """The keys of import.yml by which they are read as they were written."""
    branches: Array
    """(N, b, 3, 3): the rotations that may have been meant; NaN where there are fewer."""


def rereadings(R: Array) -> Iterator[Rereading]:
    """Yield what rotations (N, 3, 3) may have been before they were read wrongly; the usual mistakes first."""
    x, y, z, w = np.moveaxis(rotations.to_quaternion(R), -1, 0)
    for (written, read), q in zip(QUATERNION_ORDERS, ((y, z, w, x), (w, x, y, z)), strict=True):
        branches = rotations.from_quaternion(np.stack(q, -1))[:, None]
        yield Rereading(f"quaternions {written}", f"quaternions {read}", f"rotation: quaternion-{written}", branches)
    vector = rotations.log(R)
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    turns = np.arange(-int(MOST_DEGREES // (2 * np.pi)) - 1, int(MOST_DEGREES // (2 * np.pi)) + 1)
    degrees = length + 2 * np.pi * turns
    direction = vector / np.maximum(length, 1e-12)
    meant = rotations.exp(direction[:, None] * (RADIANS_PER_DEGREE * degrees)[..., None])
    meant = _keep_branches(meant, abs(degrees) <= MOST_DEGREES)
    yield Rereading("rotation vectors in degrees", "radians", "rotation: rotvec, degrees: true", meant)
    small = THREE_NUMBER_READINGS if bool((length < np.sqrt(3) * np.pi * RADIANS_PER_DEGREE).all()) else ()
    for one in small:
        keys = f"rotation: {one.key}, degrees: false"
        yield Rereading(f"{one.name} in radians", "degrees", keys, one.rotation(one.numbers(R) / RADIANS_PER_DEGREE))
    for one in THREE_NUMBER_READINGS:
        numbers = one.numbers(R)
        for other in THREE_NUMBER_READINGS:
            if other is not one:
                yield Rereading(other.name, one.name, f"rotation: {other.key}", other.rotation(numbers))


def _keep_branches(branches: Array, there: Array) -> Array:
    return np.where(there[..., None, None], branches, np.nan)


def _numbers_of_vector(R: Array) -> Array:
    """Return rotation vectors (N, 2, 3): the shortest, and that of the other direction, of up to 2 pi."""
    vector = rotations.log(R)
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    other = vector * (1 - 2 * np.pi / np.maximum(length, 1e-12))
    return np.stack([vector, np.where(abs(other) <= TURNED_TWICE, other, np.nan)], 1)


def euler(axes: Axes, angles: Array) -> Array:
    """Return the rotations (..., 3, 3) of angles (..., 3) about moving axes, one after the other."""
    parts = [rotations.exp(angles[..., k, None] * np.eye(3)[axis]) for k, axis in enumerate(axes)]
    R: Array = parts[0] @ parts[1] @ parts[2]
    return R


def euler_angles(axes: Axes, R: Array) -> Array:
    """Return the angles (N, 2, 3) of `euler`, of both branches, each in [-pi, pi]."""
    i, j, last = axes
    k = 3 - i - j
    parity = 1.0 if (j - i) % 3 == 1 else -1.0
    if last == i:
        a = np.arctan2(R[:, j, i], -parity * R[:, k, i])
        b = np.arccos(np.clip(R[:, i, i], -1, 1))
        c = np.arctan2(R[:, i, j], parity * R[:, i, k])
        other = (a + np.pi, -b, c + np.pi)
    else:
        a = np.arctan2(-parity * R[:, j, k], R[:, k, k])
        b = np.arcsin(np.clip(parity * R[:, i, k], -1, 1))
        c = np.arctan2(-parity * R[:, i, j], R[:, i, i])
        other = (a + np.pi, np.pi - b, c + np.pi)
    both = np.stack([np.stack([a, b, c], -1), np.stack(other, -1)], 1)
    return np.asarray((both + np.pi) % (2 * np.pi) - np.pi)


def _about_fixed_axes(axes: Axes, angles: Array) -> Array:
    return euler(axes[::-1], angles[..., ::-1])


def _angles_about_fixed_axes(axes: Axes, R: Array) -> Array:
    return np.asarray(euler_angles(axes[::-1], R)[..., ::-1])


def _euler_readings() -> Iterator[Reading]:
    usual: list[Axes] = [(0, 1, 2), (2, 1, 0), (2, 1, 2), (2, 0, 2)]
    every: list[Axes] = [*usual, *((i, j, 3 - i - j) for i, j in permutations(range(3), 2))]
    every += [(i, j, i) for i, j in permutations(range(3), 2)]
    for axes in dict.fromkeys(every):
        letters = ["xyz"[axis] for axis in axes]
        named, key = ", ".join(letters), f"euler-{''.join(letters)}"
        fixed = partial(_about_fixed_axes, axes), partial(_angles_about_fixed_axes, axes)
        moving = partial(euler, axes), partial(euler_angles, axes)
        yield Reading(f"Euler angles about the fixed axes {named}", f"{key}-extrinsic", *fixed)
        yield Reading(f"Euler angles about the moving axes {named}", f"{key}-intrinsic", *moving)


THREE_NUMBER_READINGS = (Reading("rotation vectors", "rotvec", rotations.exp, _numbers_of_vector), *_euler_readings())
"""Conventions of three numbers, the usual ones first."""


FEWEST_POSES = 4
"""Number of poses below which rotations are not read again: any reading would fit."""
MAX_COMPARED_COLLECTIONS = 12
"""Number of collections by whose rotations other readings are compared."""
MAX_TRACE_DIFFERENCE = 0.1
"""Difference of the rotations' traces below which they agree."""
MOST_READINGS = 6
"""Number of other readings of rotations that are tried."""
NAME_OF_UNIT = {0.001: "mm", 0.01: "cm", 0.0254: "inches"}
UNIT_OFF = 0.1
"""Relative tolerance of a unit."""
LEAST_OFF, MOST_OFF = math.log(1.01), math.log(4)
"""Logarithms of the factors of a size between which another one is tried."""
REWEIGHTING_ROUNDS = 5
"""Number of times that a scale is solved again with less weight on views that do not fit."""
QUARTER_TURN = np.pi / 2
ALONG_AXES = 0.02
"""Tolerance of the elements of a rotation that maps axes to axes."""


def robot_poses(recording: Recording) -> Iterator[Hypothesis]:
    """Yield inverse poses, and a mounting the other way round, which has the same equations."""
    arm = recording.arm
    if arm is None or recording.view is None:
        return
    base, tool = arm
    dataset = recording.dataset
    yield Hypothesis(
        "the robot's poses inverted",
        _inverted_in_import("robot's", f"those of {tool} in the frame of {base}"),
        partial(dataset.with_transforms, {arm: inverse(dataset.transforms[arm])}),
        told_apart=partial(_which_is_inverse, recording),
    )


def _section_of_poses(whose: str) -> str:
    """Return where import.yml says how poses are written."""
    return "'samples'" if whose == "robot's" else "'samples: pattern'"


def _inverted_in_import(whose: str, direction: str) -> str:
    where = f"{_section_of_poses(whose)} of import.yml"
    return f"write 'inverse: true' into {where}, or take it out where it is, so that they are {direction}"


def _which_is_inverse(recording: Recording, found: Misfit) -> tuple[str, str]:
    """Return the names of the conventions with the equations of inverse poses, the likeliest first.

    What is on the tool is nearer to it than the other one to the base; of a measured pose of the pattern, the pattern
    is nearer to the optical axis than the camera to the board's normal.
    """
    arm, view = recording.arm, recording.view
    if arm is None or view is None or found.setup is None:
        raise AssertionError("inverse poses of an arm that is there")
    dataset, (base, tool) = recording.dataset, arm
    sensor, pattern = dataset.sensors[view.sensor], dataset.patterns[view.pattern]
    poses = found.setup.problem.transforms(found.values)
    edges = (sensor.edge, found.setup.pattern_edge(pattern.name))
    of_sensor, of_pattern = (float(np.linalg.norm(poses[found.setup.block(each)][:3, 3])) for each in edges)
    on_tool, on_base = (of_sensor, of_pattern) if recording.in_hand else (of_pattern, of_sensor)
    now, other = (base, tool) if not recording.in_hand else (tool, base)
    robot = ("the robot's poses inverted", _inverted_in_import("robot's", f"those of {tool} in the frame of {base}"))
    mounted = (
        f"'{view.sensor}' and '{view.pattern}' mounted the other way round",
        f"write 'parent: {other}' for '{view.sensor}' and 'parent: {now}' for '{view.pattern}' in import.yml",
    )
    measured = (
        "the pattern's poses inverted",
        _inverted_in_import("pattern's", "those of the pattern in the camera's frame"),
    )
    alike = [robot, mounted]
    if recording.has_measured_poses:
        alike.append(measured)
        first = measured if _off_axis(inverse(view.seen)) < _off_axis(view.seen) else mounted
    else:
        first = mounted
    first = robot if on_tool <= on_base else first
    ordered = [first, *(each for each in alike if each is not first)]
    return f"{first[0]} (or {', or '.join(name for name, _ in ordered[1:])}: the same equations)", first[1]


def _off_axis(T: Array) -> float:
    """Return the median angle between the translations (N, 4, 4) and the z axis, rad."""
    t = T[:, :3, 3]
    return float(np.median(np.arctan2(np.hypot(t[:, 0], t[:, 1]), t[:, 2])))


def other_rotations(recording: Recording) -> Iterator[Hypothesis]:
    """Yield rotations that were written by another convention: quaternions, Euler angles, rotation vectors."""
    arm, view = recording.arm, recording.view
    if arm is None or view is None or len(view.collections) < FEWEST_POSES:
        return
    dataset, T = recording.dataset, recording.dataset.transforms[arm]
    T_seen, at = T[view.collections], view.collections

    def with_arm(poses: Array) -> Dataset:
        """Return the dataset with other poses of the arm (V, 4, 4) where the pattern is seen."""
        changed = T.copy()
        changed[at] = poses
        return dataset.with_transforms({arm: changed})

    def with_seen(poses: Array) -> Dataset:
        return with_measured(dataset, view.sensor, view.pattern, dict(zip(at.tolist(), poses, strict=True)))

    yield from _read_again("robot's", T_seen, view.seen, recording.in_hand, with_arm)
    if recording.has_measured_poses:
        yield from _read_again("pattern's", view.seen, T_seen, recording.in_hand, with_seen)


def _read_again(
    whose: str, T: Array, known: Array, in_hand: bool, dataset: Callable[[Array], Dataset]
) -> Iterator[Hypothesis]:
    """Yield other readings of the rotations of poses T (V, 4, 4) that agree with known ones, and their inverse."""
    R, t = T[:, :3, :3], T[:, :3, 3]
    yield Hypothesis(
        f"the rotations of the {whose} poses transposed",
        "transpose the rotation matrices in the file of poses, or negate w of its quaternions",
        partial(dataset, transform(np.swapaxes(R, 1, 2), t)),
    )
    likely = [((chosen.written, chosen.read), inverted) for chosen, inverted in _that_agree(T, known, in_hand)]
    wanted = {names for names, _ in likely}
    every = {names: each for each in rereadings(R) if (names := (each.written, each.read)) in wanted}
    for (written, read), inverted in likely:
        again = every[written, read]
        poses = transform(rotations_that_agree(again.branches, known[:, :3, :3])[0], t)
        name = f"the rotations of the {whose} poses as {written}"
        remedy = f"they were read as {read}: write '{again.keys}' into {_section_of_poses(whose)} of import.yml"
        if inverted:
            name, poses = f"{name}, and the poses inverted", inverse(poses)
            remedy = f"{remedy}, and 'inverse: true', or take it out where it is"
        yield Hypothesis(name, remedy, partial(dataset, poses))


def _that_agree(T: Array, known: Array, in_hand: bool) -> list[tuple[Rereading, bool]]:
    """Return the readings of the rotations of poses (V, 4, 4) by which they agree best with known ones.

    Traces find those that may agree; they cannot tell rotations from their mirror image or from transposed ones, which
    the robot-world problem does, with the translations.

    Returns:
        The readings, and whether the poses are inverse then.
    """
    some = np.unique(np.linspace(0, len(T) - 1, MAX_COMPARED_COLLECTIONS).round().astype(int))
    A, t = known[some], T[some, :3, 3]
    tried: list[tuple[float, int, int, Rereading]] = []
    known_misses: dict[bytes, tuple[float, float] | None] = {}
    for i, each in enumerate(rereadings(T[some, :3, :3])):
        # About fixed axes is about moving ones in reverse: half of the readings are the same rotations.
        rotations_read = each.branches.tobytes()
        if rotations_read not in known_misses:
            known_misses[rotations_read] = _misses_of_reading(each.branches, A, t, in_hand)
        if (misses := known_misses[rotations_read]) is not None:
            tried += [(miss, i, inverted, each) for inverted, miss in enumerate(misses)]
    best = sorted(tried, key=lambda one: one[:3])[:MOST_READINGS]
    return [(each, bool(inverted)) for _, _, inverted, each in best]


def _misses_of_reading(branches: Array, A: Array, t: Array, in_hand: bool) -> tuple[float, float] | None:
    """Return how far poses with rotations of these branches miss known ones, as they are and inverse; None if far."""
    chosen, apart = rotations_that_agree(branches, A[:, :3, :3])
    if apart > MAX_TRACE_DIFFERENCE:
        return None
    agreeing = disagreement_of_each(chosen, A[:, :3, :3]) < MAX_TRACE_DIFFERENCE
    poses = transform(chosen, t)
    as_they_are, inverted = (inverse(poses), poses) if in_hand else (poses, inverse(poses))
    first, second = (
        round(_median_distances(A, B, solve_robot_world(A[agreeing], B[agreeing])), 3) for B in (as_they_are, inverted)
    )
    return first, second


def _median_distances(A: Array, B: Array, found: RobotWorld) -> float:
    """Return the median distance of poses A (V, 4, 4) from ``X B Y``: rad, and relative to the size of A."""
    translation, rotation = distance(A, found.X @ B @ found.Y)
    return float(np.median(translation / np.median(np.linalg.norm(A[:, :3, 3], axis=-1)) + rotation))


def scales(recording: Recording) -> Iterator[Hypothesis]:
    """Yield other units of lengths, of an arm or of its pattern, and another size of the pattern."""
    view, dataset = recording.view, recording.dataset
    if view is None or not recording.moving or len(view.collections) < FEWEST_POSES:
        return
    scale = _scale_of_view(recording, view)
    if scale is None:
        return
    for size, unit in NAME_OF_UNIT.items():
        if recording.arm and abs(scale / size - 1) < UNIT_OFF:
            poses = scaled_translations(dataset.transforms[recording.arm], size)
            yield Hypothesis(
                f"the robot's poses in {unit}",
                _units_in_import("robot's", unit),
                partial(dataset.with_transforms, {recording.arm: poses}),
            )
        if recording.has_measured_poses and abs(scale * size - 1) < UNIT_OFF:
            yield Hypothesis(
                f"the pattern's poses in {unit}",
                _units_in_import("pattern's", unit),
                partial(with_scaled_patterns, dataset, size),
            )
    if not LEAST_OFF < abs(math.log(scale)) < MOST_OFF:
        return
    pattern = dataset.patterns[view.pattern]
    if recording.has_measured_poses:
        off = f"{100 * abs(scale - 1):.2g} %"
        name = f"the pattern's poses, which are too {'long' if scale > 1 else 'short'} by {off}, corrected"
        remedy = "measure the tag or the squares: the size that the poses were computed with is off by as much"
    else:
        name = f"squares of {1e3 * square(pattern) / scale:.3g} mm for {1e3 * square(pattern):.3g} mm"
        remedy = f"measure the printed squares over many of them, and correct the size of '{view.pattern}'"
    yield Hypothesis(name, remedy, partial(with_scaled_patterns, dataset, 1 / scale), (view.sensor,))


def _units_in_import(whose: str, unit: str) -> str:
    key = {"inches": "in"}.get(unit, unit)
    return f"write 'units: {key}' into {_section_of_poses(whose)} of import.yml, or metres into the file of poses"


def _scale_of_view(recording: Recording, view: SeenPoses) -> float | None:
    """Return the scale of what a sensor sees, relative to the arm's lengths; None if their rotations do not agree.

    In ``t_A = s R_X t_B + t_X + R_A R_Y^T t_Y`` (`start.robot_world`) by least squares, with less
    weight on views that do not fit.
    """
    pattern = recording.dataset.patterns[view.pattern]
    frame = recording.dataset.sensors[view.sensor].frame
    B = recording.dataset.transform(frame, pattern.parent_link, view.collections)
    A = view.seen
    if rotations_that_agree(B[:, None, :3, :3], A[:, :3, :3])[1] > MAX_TRACE_DIFFERENCE:
        return None
    size = float(np.median(np.linalg.norm(A[:, :3, 3], axis=-1)))
    found = solve_robot_world_robustly(scaled_translations(A, 1e-3), scaled_translations(B, 1e-3))
    R_X, R_Y = found.X[:3, :3], found.Y[:3, :3]
    system = np.concatenate(
        [
            (B[:, :3, 3] @ R_X.T)[..., None],
            np.broadcast_to(np.eye(3), (len(A), 3, 3)),
            A[:, :3, :3] @ R_Y.T,
        ],
        -1,
    )
    miss: Array = np.full(len(A), size)
    scale = 0.0
    for _ in range(REWEIGHTING_ROUNDS):
        weight = 1 / np.maximum(miss, 0.5 * float(np.median(miss)) + 1e-9 * size)[:, None]
        rows, right = (system * weight[..., None]).reshape(-1, 7), (A[:, :3, 3] * weight).ravel()
        solution = np.linalg.lstsq(rows, right, rcond=None)[0]
        miss = np.linalg.norm(system @ solution - A[:, :3, 3], axis=-1)
        scale = float(solution[0])
    return scale if scale > 0 else None


def joints(recording: Recording) -> Iterator[Hypothesis]:
    """Yield single joints with an axis flipped, in degrees, or of the collection before or after."""
    dataset = recording.dataset
    for name, joint in dataset.joints.items():
        degrees = np.pi / 180
        for what, remedy, positions in (
            ("in the other direction", "negate its axis in the robot's description", -joint.positions),
            ("in degrees", "publish its position in radians", joint.positions * degrees),
        ):
            if what == "in degrees" and joint.model.prismatic:
                continue
            yield Hypothesis(
                f"joint '{name}' {what}",
                remedy,
                partial(with_joint_positions, dataset, name, positions),
            )
        for by in (1, -1):
            positions = np.roll(joint.positions, -by)
            yield Hypothesis(
                f"joint '{name}' as it is in the collection {'after' if by > 0 else 'before'}",
                f"its states are one collection {'late' if by > 0 else 'early'}: look at their time stamps",
                partial(with_joint_positions, dataset, name, positions),
            )
    if recording.arm is not None:
        return
    for edge in recording.moving:
        if edge in recording.joints:
            continue
        named = "-".join(edge)
        for by in (1, -1):
            yield Hypothesis(
                f"'{named}' as it is in the collection {'after' if by > 0 else 'before'}",
                f"its states are one collection {'late' if by > 0 else 'early'}: look at their time stamps",
                partial(with_later_motion, dataset, edge, by),
            )
        for turned in _the_other_way(dataset.transforms[edge]):
            yield Hypothesis(
                f"'{named}' moved the other way",
                "negate the axis of this joint in the robot's description",
                partial(dataset.with_transforms, {edge: turned}),
            )


def _the_other_way(T: Array) -> Iterator[Array]:
    """Yield a joint's transforms (N, 4, 4) with its positions negated; several, as its zero is not known.

    It is where the rotation maps axes to axes, as the origins in descriptions of robots usually do.
    """
    moved = inverse(T[:1]) @ T
    vectors = rotations.log(moved[:, :3, :3])
    far = int(np.linalg.norm(vectors, axis=-1).argmax())
    angle = float(np.linalg.norm(vectors[far]))
    if angle < 1e-3:
        yield T[:1] @ inverse(moved) if np.ptp(T[:, :3, 3], axis=0).max() > 0 else T
        return
    axis = vectors[far] / angle
    along = vectors @ axis
    if np.abs(vectors - along[:, None] * axis).max() > 1e-6 or np.abs(moved[:, :3, 3]).max() > 1e-6:
        return
    back = np.linspace(0, 2 * np.pi, 361)[:-1]
    origins = T[0, :3, :3] @ rotations.exp(-back[:, None] * axis)
    square_on = np.abs(np.sort(np.abs(origins), -1) - (0, 0, 1)).max((-1, -2))
    nearest = int(square_on.argmin())
    if square_on[nearest] > ALONG_AXES:
        return
    beyond = rotations.log(np.round(origins[nearest]).T @ origins[nearest]) @ axis
    zero = float(back[nearest] + beyond)
    for quarter in range(4):
        position = zero + quarter * QUARTER_TURN
        yield T[:1] @ transform(rotations.exp((-2 * position - along)[:, None] * axis), np.zeros(3))
