"""Where the frames of a recording were, by its frames and joints and the accepted calibration."""

from dataclasses import dataclass

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array, IntArray
from calibration.engine.baseline.calibration_document import CalibratedPose, CalibrationDocument
from calibration.engine.geometry.frames import FrameTree, Step
from calibration.engine.geometry.transforms import inverse, inverse_adjoint, local
from calibration.robot.importing.bags.bag import NS_PER_S
from calibration.robot.importing.bags.motion import MotionLog

MAX_MOMENTS = 80
"""Images or scans of a sensor that are looked at, evenly chosen."""
MOMENT_STEP = 0.5
"""s: least time between them."""
MIN_DRIVEN_M = 0.01
"""m, and rad: motion of a frame in its parent that counts."""
HALF_STEP = 0.01
"""s: a velocity is taken over twice this time."""


@dataclass(frozen=True, eq=False)
class Carriage:
    """How a sensor was carried, at K moments."""

    stamps: IntArray
    """(K,): ns, rising; those at which the link's pose is known."""
    T_link_sensor: Array
    """(4, 4): accepted, of the frame of the sensor's data."""
    covariance: Array
    """(6, 6): of it, as a twist in its frame; m and rad."""
    T_root_link: Array
    """(K, 4, 4)."""
    velocities: Array
    """(K, 6): twists of the link in its own frame, m/s and rad/s."""
    drives: bool = False
    """Whether odometry says where it is, whose errors add up, and not joints alone."""


class RecordedFrames:
    """Frames of a recording: those that stand as accepted, the others as recorded."""

    def __init__(self, log: MotionLog, accepted: CalibrationDocument, without: str = "") -> None:
        """Take the frames of a recording, but for what hangs on a frame from another source."""
        self._log = log
        self._fixed = {each.edge: each.matrix for each in accepted.poses if not log.moves(each.edge)}
        recorded = {child: parent for parent, child in reversed(log.edges) if parent != without}
        self._parent = recorded | {child: parent for parent, child in self._fixed}
        self._tree = FrameTree((parent, child) for child, parent in self._parent.items())

    def carriage(self, pose: CalibratedPose, data_frame: str, stamps: IntArray, topic: str) -> Carriage:
        """Return how a sensor was carried.

        Args:
            pose: accepted, of the sensor.
            data_frame: frame of its data, that of the pose if nothing is known of it.
            stamps: ns, of its data.
            topic: of its data, for errors.

        Raises:
            InputError: the link's pose was recorded at none of the stamps.
        """
        root, link = self.root(pose.parent), pose.parent
        moves = self.moves(root, link)
        if moves:
            stamps = np.array([stamp for stamp in stamps.tolist() if self._is_known(link, stamp)], int)
        if not len(stamps):
            raise InputError(f"{topic}: found no pose of '{link}' near its stamps, expected /tf or joints with it")
        T = np.stack([self.transform(root, link, stamp) for stamp in stamps.tolist()])
        step = HALF_STEP * NS_PER_S if moves else 0.0
        ends = [[self.transform(root, link, stamp + side * step) for stamp in stamps.tolist()] for side in (-1, 1)]
        velocities = local(np.stack(ends[0]), np.stack(ends[1])) / (2 * HALF_STEP)
        drives = moves and any(self._is_odometry(step, stamps) for step in self._path(root, link))
        return Carriage(stamps, *self.mount(pose, data_frame, float(stamps[0])), T, velocities, drives)

    def mount(self, pose: CalibratedPose, data_frame: str, time: float) -> tuple[Array, Array]:
        """Return ``T_link_sensor`` (4, 4) of the frame of a sensor's data, and its covariance (6, 6), see `Carriage`.

        Args:
            pose: accepted, of the sensor.
            data_frame: frame of its data, that of the pose if nothing is known of it.
            time: ns.

        Raises:
            InputError: a frame was not recorded around that time.
        """
        frame = data_frame if data_frame in self._tree else pose.child
        T_child_sensor = self.transform(pose.child, frame, time)
        to_sensor = inverse_adjoint(T_child_sensor)
        C = np.zeros((6, 6)) if pose.covariance is None else pose.covariance
        return pose.matrix @ T_child_sensor, to_sensor @ C @ to_sensor.T

    def root(self, frame: str) -> str:
        """Return the frame on which a frame hangs in the end."""
        while frame in self._parent:
            frame = self._parent[frame]
        return frame

    def moves(self, start: str, end: str) -> bool:
        """Whether two frames may move relative to each other."""
        edges = [(step.parent, step.child) for step in self._path(start, end)]
        return any(edge not in self._fixed and self._log.moves(edge) for edge in edges)

    def transform(self, start: str, end: str, time: float) -> Array:
        """Return ``T_start_end`` (4, 4) at a time, ns.

        Raises:
            InputError: a frame was not recorded around that time.
        """
        T = np.eye(4)
        for step in self._path(start, end):
            edge = (step.parent, step.child)
            own = self._fixed[edge] if edge in self._fixed else self._log.transform(edge, time)
            T = T @ (inverse(own) if step.inverted else own)
        return T

    def _path(self, start: str, end: str) -> tuple[Step, ...]:
        return self._tree.path(start, end) if start != end else ()

    def _is_odometry(self, step: Step, stamps: IntArray) -> bool:
        """Whether a frame drives in its parent: it is named so (REP 105), or moves in a plane as no joint does."""
        T = np.stack([self.transform(step.parent, step.child, stamp) for stamp in stamps.tolist()])
        driven, height, tilt = (
            float(np.ptp(T[:, :3, 3], axis=0).max()),
            np.ptp(T[:, 2, 3]),
            np.ptp(T[:, :3, 2], axis=0),
        )
        is_planar = height < MIN_DRIVEN_M and tilt.max() < MIN_DRIVEN_M
        return driven > MIN_DRIVEN_M and (is_planar or "odom" in step.parent + step.child)

    def _is_known(self, link: str, stamp: int) -> bool:
        """Whether the pose of a link was recorded around a time, ns."""
        try:
            for side in (-1, 1):
                self.transform(self.root(link), link, stamp + side * HALF_STEP * NS_PER_S)
        except InputError:
            return False
        return True


def evenly_chosen(stamps: IntArray) -> IntArray:
    """Return some of the stamps, ns, of images or scans, evenly over the recording."""
    number = min(MAX_MOMENTS, int((stamps[-1] - stamps[0]) / (MOMENT_STEP * NS_PER_S)) + 1)
    wanted = np.linspace(stamps[0], stamps[-1], number)
    return np.unique(stamps[np.abs(stamps[:, None] - wanted).argmin(0)])
