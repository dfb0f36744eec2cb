"""What the hypotheses of conventions need of a dataset: the arm's transforms, and what its sensors saw."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.model import CornerLabels, Dataset, Edge, PoseLabels
from calibration.engine.estimation.problem.fixing import RIGID_TOLERANCE
from calibration.engine.estimation.residuals.corner_residuals import CornerTerm
from calibration.engine.estimation.start.single_views import corner_term
from calibration.engine.geometry.transforms import inverse, translation


@dataclass(frozen=True, eq=False)
class SeenPoses:
    """A sensor's views of a pattern, each with its own pose."""

    sensor: str
    pattern: str
    collections: IntArray
    """(V,)."""
    seen: Array
    """``T_sensor_pattern`` (V, 4, 4), by each view alone, or as it was measured."""


@dataclass(frozen=True, eq=False)
class Recording:
    """A dataset, with what its hypotheses have in common."""

    dataset: Dataset

    @cached_property
    def moving(self) -> tuple[Edge, ...]:
        """The known transforms that differ between collections: an arm's."""
        calibrated = {sensor.edge for sensor in self.dataset.sensors.values()}
        calibrated |= {(pattern.parent_link, pattern.link) for pattern in self.dataset.patterns.values()}
        calibrated |= {*self.dataset.additional_transforms}
        return tuple(
            edge
            for edge, T in self.dataset.transforms.items()
            if edge not in calibrated and np.isfinite(T).all() and np.abs(T - T[:1]).max() > RIGID_TOLERANCE
        )

    @property
    def arm(self) -> Edge | None:
        """The only transform of the arm, as hand-eye samples have it; None if it has several, or there is no arm."""
        return self.moving[0] if len(self.moving) == 1 and self.moving[0] not in self.joints else None

    @property
    def joints(self) -> set[Edge]:
        """The edges of joints with calibrated parameters."""
        return {joint.edge for joint in self.dataset.joints.values()}

    @property
    def in_hand(self) -> bool:
        """Whether the arm carries a sensor, not a pattern."""
        sensor, pattern = next(iter(self.dataset.sensors.values())), next(iter(self.dataset.patterns.values()))
        path = self.dataset.tree.path(sensor.frame, pattern.parent_link)
        return any((step.parent, step.child) == self.arm and step.inverted for step in path)

    @cached_property
    def view(self) -> SeenPoses | None:
        """The views of the camera or tracker with most of them; None without a fixed pattern."""
        fixed = [name for name, pattern in self.dataset.patterns.items() if pattern.fixed]
        found = [each for p in fixed for s in self.dataset.sensors if (each := self.seen_poses(s, p))]
        return max(found, key=lambda each: len(each.collections), default=None)

    def seen_poses(self, sensor: str, pattern: str) -> SeenPoses | None:
        """Return the views of a camera or tracker of a pattern; None without any."""
        board, camera = self.dataset.patterns[pattern], self.dataset.sensors[sensor].camera
        labels = self.dataset.detections(pattern, sensor)
        if not labels:
            return None
        at = np.array([i for i, _ in labels])
        poses = [label.T for _, label in labels if isinstance(label, PoseLabels)]
        if poses:
            return SeenPoses(sensor, pattern, at, np.stack(poses))
        corners = [label for _, label in labels if isinstance(label, CornerLabels)]
        if camera is None or len(corners) < len(labels):
            return None
        term: CornerTerm = corner_term(camera, board, corners)
        seen = term.linear_poses @ inverse(translation(board.centre))
        usable = np.isfinite(seen[:, 0, 0])
        return SeenPoses(sensor, pattern, at[usable], seen[usable])

    @property
    def cameras(self) -> list[str]:
        """Sensors with corner labels."""
        return [sensor.name for sensor in self.dataset.sensors.values() if sensor.modality.has_corners]

    @property
    def has_measured_poses(self) -> bool:
        """Whether the labels are poses of the pattern."""
        return any(sensor.modality.has_poses for sensor in self.dataset.sensors.values())
