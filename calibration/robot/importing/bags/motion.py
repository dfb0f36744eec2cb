"""Motion in a recording: of frames and joints over time, and of boards that a hand moves, by the images around them.

The pose of a board is smooth over a fifth of a second: a cubic in time through its poses before and after a moment has
the velocity, the acceleration and the jerk there as its derivatives. Of a camera that stands relative to the board's
parent, this needs no mount.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.configuration import Configuration, PatternConfiguration
from calibration.engine.dataset.model import Edge
from calibration.engine.estimation.start.single_views import corner_term, fitted_poses, refined_poses
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.frames import FrameTree
from calibration.engine.geometry.transforms import distance, local, retract, translation
from calibration.robot.importing.bags.bag import NS_PER_S
from calibration.robot.importing.bags.stillness import BagImage, BagMoment
from calibration.robot.importing.results import LeftOutCounts
from calibration.robot.urdf import Joint, Robot, parse_robot

MAX_SECONDS_TO_RECORD = 0.5
"""s: limit of the time between a pose's record and a moment that uses it."""
MAX_UNEVENNESS = 2
"""Limit of the gaps beside the one with a moment, in such gaps: within it a cubic through four records is taken."""
SECONDS_AROUND_STILL = 0.15
"""s: time before and after a moment at standstill in which nothing moves more than `STILL_M` or `STILL_RAD`."""
STILL_M, STILL_RAD = 1e-3, 2e-3
"""m and rad: largest motion at standstill."""
MOTION_OVER = 0.3
"""s: time over which a motion is taken, a cubic in time through the records of an arm in it."""
MOTION_RECORDS, MIN_MOTION_RECORDS = 9, 5
"""Limits of how many records a cubic is taken from."""
VELOCITY_OVER = 0.06
"""s: time over which a velocity alone is taken where fewer were recorded."""
DERIVATIVE_FACTORS = np.array([[1.0], [2.0], [6.0]])
MIN_STEP, MAX_STEP = 0.03, 0.12
"""s: limits of the time between the images that a velocity is taken from: nearer ones have more noise than motion."""
OFF_STEP = 0.4
"""Limit of how far an image may be from where a step ends, in steps."""
MAX_RMS = 1.5
"""px: limit of the error of a pose that a velocity is taken from."""
IMAGE_STEPS = np.array([-2, -1, 1, 2])
"""Images around that of a moment, in steps."""


@dataclass
class Track:
    """Values over time; of equal consecutive values the first and the last are kept."""

    times: list[int] = field(default_factory=list)
    """ns, ascending."""
    values: list[Array] = field(default_factory=list)

    def add(self, time: int, value: Array) -> None:
        """Add a value; one that is older than the last is ignored."""
        if self.times and time <= self.times[-1]:
            return
        if len(self.values) > 1 and np.array_equal(value, self.values[-1]) and np.array_equal(value, self.values[-2]):
            self.times[-1] = time
            return
        self.times.append(time)
        self.values.append(value)

    def at(self, time: float) -> Array | None:
        """Return the value at a time, ns: interpolated between two records that are near each other.

        Else that of the nearest record; None if none is near and it has changed since.
        """
        after = int(np.searchsorted(self.times, time))
        before = max(after - 1, 0)
        after = min(after, len(self.times) - 1)
        nearest = min(before, after, key=lambda i: abs(self.times[i] - time))
        between = self.times[before] <= time <= self.times[after]
        near = abs(self.times[nearest] - time) <= MAX_SECONDS_TO_RECORD * NS_PER_S
        unchanged = np.array_equal(self.values[before], self.values[after])
        if not near and not (between and unchanged):
            return None
        apart = self.times[after] - self.times[before]
        if not between or unchanged or apart > 2 * MAX_SECONDS_TO_RECORD * NS_PER_S:
            return self.values[nearest]
        around = slice(before - 1, after + 2)
        if before == 0 or after + 1 == len(self.times) or np.diff(self.times[around]).max() > MAX_UNEVENNESS * apart:
            around = slice(before, after + 1)
        return _interpolate_value(self.times[around], self.values[around], time)


def _interpolate_value(times: Sequence[int], values: Sequence[Array], time: float) -> Array:
    """Return what is between transforms (4, 4) or joint positions (1,) of some times, by Lagrange's polynomial.

    Between two a position moves in a straight line, an orientation about a fixed axis at constant speed.
    """
    weights = [np.prod([(time - other) / (own - other) for other in times if other != own]) for own in times]
    first = values[0]
    if first.shape != (4, 4):
        return np.asarray(first + weights @ _shortest_way(np.stack(values) - first), float)
    return retract(first, weights @ local(first, np.stack(values)))


def _shortest_way(step: Array) -> Array:
    """Return the step of a joint's position without whole turns, which drivers leave out of continuous joints."""
    return np.where(abs(step) > np.pi, step - 2 * np.pi * np.round(step / (2 * np.pi)), step)


def polynomial_derivatives(times: Array, twists: Array, orders: IntArray) -> Array:
    """Return the first derivatives (3, 6) at time 0 of a polynomial of twists (n, 6) at times (n,), s.

    Its terms are of some orders, 3 at most: a polynomial without that of order 0 is 0 at 0.
    """
    coefficients = np.zeros((4, 6))
    coefficients[orders] = np.linalg.lstsq(times[:, None] ** orders, twists, rcond=None)[0]
    return np.asarray(coefficients[1:] * DERIVATIVE_FACTORS)


def frames_of(edge: Edge) -> str:
    """Return the name of an edge in the table of what is left out."""
    return f"{edge[0]} -> {edge[1]}"


@dataclass
class MotionLog:
    """Transforms and joints of a recording."""

    static: dict[Edge, Array] = field(default_factory=dict)
    """``T_parent_child`` (4, 4)."""
    moving: dict[Edge, Track] = field(default_factory=dict)
    joints: dict[str, Track] = field(default_factory=dict)
    """Positions, rad or m, by the joint's name."""
    robot: Robot | None = None
    robot_fault: str = ""
    """Why the recorded robot description cannot be read."""
    left_out: LeftOutCounts = field(default_factory=LeftOutCounts)

    def add_transform(self, edge: Edge, time: int, T: Array) -> None:
        """Add ``T_parent_child`` (4, 4) at a time, ns."""
        self.moving.setdefault(edge, Track()).add(time, T)

    def add_joint_position(self, name: str, time: int, position: float) -> None:
        """Add a joint's position at a time, ns."""
        self.joints.setdefault(name, Track()).add(time, np.array([position]))

    def add_robot(self, urdf: bytes, path: Path) -> None:
        """Add a robot's links; transforms of the recording take precedence.

        Raises:
            InputError: it is not a URDF.
        """
        self.robot = parse_robot(urdf, path)

    @property
    def _joints_without_transforms(self) -> Mapping[Edge, Joint]:
        """The robot's joints whose child has no transform in the recording."""
        if self.robot is None:
            return {}
        known = {child for _, child in (*self.static, *self.moving)}
        return {joint.edge: joint for joint in self.robot.joints if joint.child not in known}

    @property
    def edges(self) -> list[Edge]:
        """All known edges; a frame may have several parents."""
        return list(dict.fromkeys([*self.static, *self.moving, *self._joints_without_transforms]))

    def tree_edges(self, parents: Mapping[str, str]) -> tuple[list[Edge], Mapping[str, list[str]]]:
        """Return the edges of a tree, and the frames with several parents, of which nobody has chosen one.

        Args:
            parents: the chosen parent of such frames.

        Raises:
            InputError: a chosen parent was not recorded, or the frames form a loop.
        """
        recorded: dict[str, list[str]] = {}
        for parent, child in self.edges:
            recorded.setdefault(child, []).append(parent)
        for child, parent in parents.items():
            if parent not in recorded.get(child, []):
                known = ", ".join(f"'{each}'" for each in recorded.get(child, [])) or "none"
                raise InputError(f"parents: found '{parent}' of '{child}', expected one that was recorded: {known}")
        chosen = [(parents.get(child, above[0]), child) for child, above in recorded.items()]
        FrameTree(chosen)
        several = {child: above for child, above in recorded.items() if len(above) > 1 and child not in parents}
        return chosen, several

    def moves(self, edge: Edge) -> bool:
        """Whether an edge may differ between moments."""
        if (joint := self._joints_without_transforms.get(edge)) is not None:
            return joint.kind != "fixed"
        return edge in self.moving

    def transform(self, edge: Edge, time: float) -> Array:
        """Return ``T_parent_child`` (4, 4) at a time, ns.

        Raises:
            InputError: there is no record near that time.
        """
        if edge in self.static:
            return self.static[edge]
        T: Array | None
        if edge in self.moving:
            T = self.moving[edge].at(time)
            what = f"no transform from '{edge[0]}' to '{edge[1]}'"
        else:
            joint = self._joints_without_transforms[edge]
            if joint.kind == "fixed":
                return joint.T_parent_joint
            if joint.without_position:
                raise InputError(
                    f"joint '{joint.name}' {joint.without_position}: it needs a transform from '{edge[0]}' to "
                    f"'{edge[1]}' in /tf, and none was recorded{self._why_not(edge)}"
                )
            position = self._position_at(joint, time)
            T = None if position is None else joint.transform(position)[0]
            what = f"no position of joint '{joint.driver}' and no transform from '{edge[0]}' to '{edge[1]}'"
        if T is None:
            raise InputError(
                f"{what} was recorded within {MAX_SECONDS_TO_RECORD:g} s of {time / NS_PER_S:.3f}{self._why_not(edge)}"
            )
        return T

    def motion(self, edge: Edge, time: float) -> Array:
        """Return velocity, acceleration and jerk (3, 6) of the child at a time, ns, as twists in its own frame.

        Zero where it stands still, or nothing was recorded around that time.
        """
        if not self.moves(edge):
            return np.zeros((3, 6))
        around = self._recorded_around(edge, time)
        times, orders = (around, 4) if len(around) else (time + NS_PER_S * VELOCITY_OVER * np.array([-0.5, 0.5]), 2)
        try:
            now, *others = (self.transform(edge, each) for each in (time, *times))
        except InputError:
            return np.zeros((3, 6))
        twists = local(now, np.stack(others))
        found = polynomial_derivatives((times - time) / NS_PER_S, twists, np.arange(orders))
        speed, turning = np.linalg.norm(found[0].reshape(2, 3), axis=-1)
        stands = speed < STILL_M / SECONDS_AROUND_STILL and turning < STILL_RAD / SECONDS_AROUND_STILL
        return np.zeros((3, 6)) if stands else found

    def _recorded_around(self, edge: Edge, time: float) -> Array:
        """Return times of records, ns, from both sides of a time; none if there are too few for a cubic."""
        joint = self._joints_without_transforms.get(edge)
        track = self.moving.get(edge) if joint is None else self.joints.get(joint.name) or self.joints.get(joint.driver)
        recorded = np.array(track.times if track else [], float)
        wanted = time + NS_PER_S * MOTION_OVER * np.linspace(-0.5, 0.5, MOTION_RECORDS)
        within = recorded[abs(recorded - time) <= NS_PER_S * MOTION_OVER / 2]
        if len(within) < MIN_MOTION_RECORDS or min((within < time).sum(), (within > time).sum()) < 2:
            return np.zeros(0)
        return np.asarray(within[np.unique(abs(within - wanted[:, None]).argmin(-1))])

    def _position_at(self, joint: Joint, time: float) -> Array | None:
        """Return the position (1,) of a joint at a time, ns; of one that follows another, from that one's."""
        own = self.joints.get(joint.name)
        if own is not None or joint.mimic is None:
            return None if own is None else own.at(time)
        followed = self.joints.get(joint.mimic.joint)
        position = None if followed is None else followed.at(time)
        return None if position is None else joint.mimic.positions(position)

    def _why_not(self, edge: Edge) -> str:
        """Return what of an edge was recorded and left out, to be appended to an error."""
        joint = self._joints_without_transforms.get(edge)
        left_out = [*self.left_out.of(frames_of(edge)), *(self.left_out.of(joint.name) if joint else ())]
        return f" ({'; '.join(left_out)})" if left_out else ""

    def is_still(self, edges: list[Edge], time: float) -> bool:
        """Whether none of the edges moves around a time, ns."""
        for edge in edges:
            if self.moves(edge):
                T = [
                    self.transform(edge, time + offset * NS_PER_S)
                    for offset in (-SECONDS_AROUND_STILL, 0.0, SECONDS_AROUND_STILL)
                ]
                for other in (T[0], T[2]):
                    m, rad = distance(T[1], other)
                    if m > STILL_M or rad > STILL_RAD:
                        return False
        return True


@dataclass(frozen=True, eq=False)
class MovingBoards:
    """Images of cameras before which boards may move."""

    images: Mapping[str, Sequence[BagImage]]
    """All images of each camera, sorted by stamp."""
    moments: Sequence[BagMoment]
    """The moments at which velocities are wanted."""
    edges: Collection[Edge] = ()
    """Recorded edges from the world to cameras and patterns' parents."""
    moving: Collection[Edge] = ()
    """Those of them that move, such as an arm's."""

    def motions(self, configuration: Configuration, cameras: Mapping[str, Camera]) -> dict[Edge, Array]:
        """Return velocity, acceleration, jerk (N, 3, 6) of each pattern, as `calibration.engine.dataset.frames`.

        Of several cameras the anchored one, else the first, gives the motion: it is the clock. Zero at a moment
        without images before and after it.
        """
        names = [name for name in configuration.sensors if name in cameras and name in self.images]
        names.sort(key=lambda name: name != configuration.anchored_sensor)
        found: dict[Edge, Array] = {}
        for pattern in configuration.patterns.values():
            total = np.zeros((len(self.moments), 3, 6))
            for name in names if not pattern.fixed else ():
                if self._is_still(configuration.sensors[name].parent_link, pattern.parent_link):
                    missing = np.flatnonzero(~total.any((1, 2)))
                    moments = [self.moments[i] for i in missing.tolist()]
                    total[missing] = _pattern_motions(self.images[name], moments, name, cameras[name], pattern)
            if total.any():
                found[pattern.parent_link, pattern.link] = total
        return found

    def _is_still(self, one: str, other: str) -> bool:
        """Whether nothing moves between two frames."""
        tree = FrameTree(self.edges)
        if one == other or one not in tree or other not in tree:
            return one == other
        return all((step.parent, step.child) not in self.moving for step in tree.path(one, other))


def _pattern_motions(
    images: Sequence[BagImage], moments: Sequence[BagMoment], name: str, camera: Camera, pattern: PatternConfiguration
) -> Array:
    """Return the motions (N, 3, 6) of a pattern at some moments by the images of one camera; zero if there is none."""
    found = np.zeros((len(moments), 3, 6))
    seen = [(image, labels) for image in images if (labels := image.view.found[pattern.name].labels) is not None]
    index = {id(image): i for i, (image, _) in enumerate(seen)}
    stamps = np.array([image.stamp - images[0].stamp for image, _ in seen]) / NS_PER_S
    rows = [i for i, moment in enumerate(moments) if id(moment.images.get(name)) in index]
    at = np.array([index[id(moments[i].images[name])] for i in rows], int)
    around = [_neighbouring_images(stamps, i) for i in at]
    if not any(len(each) for each in around):
        return found
    geometry = pattern.pattern()
    term = corner_term(camera, geometry, [labels for _, labels in seen])
    middles, rms = fitted_poses(term.take(at))
    of = np.repeat(np.arange(len(at)), [len(each) for each in around])
    others, others_rms = refined_poses(term.take(np.concatenate(around)), middles[of])
    twists = local(middles[of] @ translation(-geometry.centre), others @ translation(-geometry.centre))
    for i, (row, own) in enumerate(zip(rows, around, strict=True)):
        if len(own) and max(rms[i], others_rms[of == i].max()) <= MAX_RMS:  # not if one is NaN
            orders = np.arange(1, min(len(own), 3) + 1)
            found[row] = polynomial_derivatives(stamps[own] - stamps[at[i]], twists[of == i], orders)
    return found


def _neighbouring_images(stamps: Array, at: int) -> IntArray:
    """Return the images before and after one, by their stamps (n,), s; none if they are too far away."""
    gaps = np.diff(stamps[max(at - 1, 0) : at + 2])
    step = max(MIN_STEP, gaps.min(initial=np.inf))
    if step > MAX_STEP:
        return np.zeros(0, int)
    ends = stamps[at] + step * IMAGE_STEPS
    nearest = abs(stamps - ends[:, None]).argmin(-1)
    around = np.unique(nearest[abs(stamps[nearest] - ends) <= OFF_STEP * step])
    both_sides = (around < at).any() and (around > at).any()
    return around if both_sides else np.zeros(0, int)
