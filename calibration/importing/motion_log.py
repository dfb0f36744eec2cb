"""Motion of frames and joints in a recording, over time."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from calibration.dataset.model import Edge
from calibration.errors import InputError
from calibration.geometry.frames import FrameTree
from calibration.geometry.transforms import distance
from calibration.geometry.types import Array
from calibration.simulation.robot import Joint, Robot, parse_robot

NEAR = 0.5
"""s: limit of the time between a pose's record and a moment that uses it."""
AROUND = 0.15
"""s: time before and after a moment at standstill in which nothing moves more than `STILL_M` or `STILL_RAD`."""
STILL_M, STILL_RAD = 1e-3, 2e-3
"""m and rad: largest motion at standstill."""
SECOND = 1e9


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
        """Return the value at a time, ns: that of the nearest record; None if none is near and it has changed since."""
        after = int(np.searchsorted(self.times, time))
        before = max(after - 1, 0)
        after = min(after, len(self.times) - 1)
        nearest = min(before, after, key=lambda i: abs(self.times[i] - time))
        between = self.times[before] <= time <= self.times[after]
        if abs(self.times[nearest] - time) > NEAR * SECOND and not (
            between and np.array_equal(self.values[before], self.values[after])
        ):
            return None
        return self.values[nearest]


@dataclass
class MotionLog:
    """Transforms and joints of a recording."""

    static: dict[Edge, Array] = field(default_factory=dict)
    """``T_parent_child`` (4, 4)."""
    moving: dict[Edge, Track] = field(default_factory=dict)
    joints: dict[str, Track] = field(default_factory=dict)
    """Positions, rad or m, by the joint's name."""
    robot: Robot | None = None

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
    def _driven(self) -> Mapping[Edge, Joint]:
        """The robot's joints whose child has no transform in the recording."""
        if self.robot is None:
            return {}
        known = {child for _, child in (*self.static, *self.moving)}
        return {joint.edge: joint for joint in self.robot.joints if joint.child not in known}

    @property
    def edges(self) -> list[Edge]:
        """Return all known edges.

        Raises:
            InputError: a frame has two parents.
        """
        found = list(dict.fromkeys([*self.static, *self.moving, *self._driven]))
        FrameTree(found)
        return found

    def moves(self, edge: Edge) -> bool:
        """Whether an edge may differ between moments."""
        if (joint := self._driven.get(edge)) is not None:
            return joint.is_movable
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
            joint = self._driven[edge]
            if not joint.is_movable:
                return joint.T_parent_joint
            track = self.joints.get(joint.name)
            position = None if track is None else track.at(time)
            T = None if position is None else joint.transform(position)[0]
            what = f"no position of joint '{joint.name}' and no transform from '{edge[0]}' to '{edge[1]}'"
        if T is None:
            raise InputError(f"{what} was recorded within {NEAR:g} s of {time / SECOND:.3f}")
        return T

    def is_still(self, edges: list[Edge], time: float) -> bool:
        """Whether none of the edges moves around a time, ns."""
        for edge in edges:
            if self.moves(edge):
                T = [self.transform(edge, time + offset * SECOND) for offset in (-AROUND, 0.0, AROUND)]
                for other in (T[0], T[2]):
                    m, rad = distance(T[1], other)
                    if m > STILL_M or rad > STILL_RAD:
                        return False
        return True
